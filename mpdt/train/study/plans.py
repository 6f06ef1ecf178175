"""Studies: lists of cells = data x method x seed, with the settings that are studied. Data only.

    fifty         ml45 and mt50, one block, longer: what the paper shows its ablations on
    one-block     every method on every family but mt10, the language model cut to its first block;
                  three seeds for the main ones, five on cheetah_vel; there one thing changed at a
                  time as well
    first-pass    what was run before with four blocks, at four times the cost (0018)
    depth         MPDT-ones with 4, 12 and all 30 blocks, GPT-2's shape, longer windows
    trials        the weights of one-block's and fifty's MPDT-ones again, after own episodes (0033);
                  a copy of a run's folder under the cell's name saves training it anew

Sizes were chosen by cost, not by returns (docs/decisions/0011).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mpdt.errors import unknown_name
from mpdt.train.run.methods import has_language_model, merge


@dataclass(frozen=True)
class Cell:
    """One run of a study.

    Attributes:
        data: name of an entry, and of its file DATA.h5.
        label: what stands in the name and the table; the method unless settings differ.
        changes: settings over preset and method, nested as in `TrainConfig`.
    """

    data: str
    method: str
    seed: int = 0
    label: str = ""
    preset: str = "base"
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.data}.{self.label or self.method}.s{self.seed}"


# Of dozens of tasks a few are enough for an update: more updates beat larger ones here. One
# episode of each training task for its table.
_MANY: Mapping[str, Any] = {
    "sampler": {"tasks_per_update": 8, "per_task": 4},
    "optimiser": {"warmup_steps": 50},
    "teacher": {"steps": 400},
    "multitask": {"steps": 1200},
    "evaluation": {"train_episodes": 1},
}
_FEW: Mapping[str, Any] = {"teacher": {"steps": 200}, "multitask": {"steps": 400}}
_TEN: Mapping[str, Any] = {"teacher": {"steps": 200}, "multitask": {"steps": 600}}
# What all sizes start from.
_COMMON: Mapping[str, Any] = {
    "sampler": {"per_task": 16},
    "optimiser": {"warmup_steps": 100},
    "multitask": {"checkpoint_every": 100},
}
# What training longer brings: smaller updates, five times as many.
_LONG: Mapping[str, Any] = {
    "sampler": {"per_task": 6},
    "optimiser": {"warmup_steps": 50},
    "multitask": {"steps": 3000},
}
_SMALLER: Mapping[str, Any] = {"sampler": {"per_task": 4}}
_INFER = {"adapt": {"starts": ["infer"]}}
_STARTS = {"adapt": {"starts": ["cross", "infer", "infer_aligned"]}}
_EVERY_START = {"adapt": {"starts": ["cross", "cross_mean", "cross_one", "cross_random", "infer",
                                     "infer_aligned"]}}  # fmt: skip
_EXPERT = {"few_shot": {"qualities": ["expert"]}}
_LEVELS = {"few_shot": {"qualities": ["expert", "medium", "random", "mixed"]}}
_TWO = {"adapt": {"infer": {"tasks": 2}}}
_TEST = {"evaluation": {"blocks": ["test"]}}
_ALL_TUNED = {"few_shot": {"qualities": ["expert"], "tuned": "all", "updates": 300},
              "adapt": {"starts": ["none"]}}  # fmt: skip

_PLAIN = "MPDT-no-distillation"
_VEL = "cheetah_vel"


def _laid(data: str, method: str, seed: int, label: str, *changes: Mapping[str, Any]) -> Cell:
    size = {"cheetah_dir": _FEW, "ml10": _TEN, "mt10": _TEN}.get(data, _MANY)
    laid: dict[str, Any] = {}
    for each in (_COMMON, size, *changes):
        laid = merge(laid, each)
    return Cell(data, method, seed, label, changes=laid)


def _blocks(method: str, depth: int) -> Mapping[str, Any]:
    return {"backbone": {"depth": depth}} if has_language_model(method) else {}


_META_WORLD = ("ml10", "mt10", "ml45", "mt50")
# Cheetah, ant and the first pass: shown, as published (0018 for what Meta-World says of it).
_SHOWN = {"inputs": {"previous_action": True}}
_HIDDEN = {"inputs": {"previous_action": False}}
_ANT_LONG: Mapping[str, Any] = {"multitask": {"steps": 4800}, **_HIDDEN}


def _four(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    """Judged with the mean of two tasks' prompts; since then held-out training tasks have chosen
    the nearest one's (0010)."""
    return _laid(data, method, seed, label, _blocks(method, 4), _TWO, _SHOWN, *changes)


def _one(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    """Judged by default: `infer` as the method has it."""
    shown = {} if data in _META_WORLD else _SHOWN
    return _laid(data, method, seed, label, _blocks(method, 1), shown, *changes)


# What each method is judged with.
_OWN: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "MPDT-E": (_EVERY_START, _LEVELS),
    **dict.fromkeys(("MPDT", _PLAIN, "MPDT-ones", "MPDT-mixed"), (_STARTS, _EXPERT)),
    **dict.fromkeys(("MPDT-WP", "MPDT-WP-frozen", "MPDT-teacher-parts", "MPDT+sparse"), (_STARTS,)),
    "Soft-Prompt-TTA": (_EXPERT,),
    "Prompt-DT": (_INFER,),
}


def _method(
    data: str, method: str, seed: int = 0, *changes: Mapping[str, Any], label: str = ""
) -> Cell:
    return _one(data, method, *_OWN.get(method, ()), *changes, seed=seed, label=label)


_THRICE = ("MPDT-ones", "MPDT-E", "Prompt-DT", "MPDT-WP", _PLAIN)
_ONCE = ("MPDT", "Soft-Prompt-TTA", "MPDT-WP-frozen", "MPDT-mixed", "Prompt-DT-TTA", "MT-BC-FT",
         "MT-ORL-FT", "HDT", "LaMo", "Full-FT", "MPDT+sparse")  # fmt: skip
# Claims are judged on cheetah_vel: three seeds for both sides of each.
_ON_VEL = (*_THRICE, "MPDT", "Soft-Prompt-TTA", "MPDT-WP-frozen", "MPDT-teacher-parts")
_FIVE_TIMES = ("MPDT-ones", "MPDT-E", "MPDT", "Prompt-DT", "Soft-Prompt-TTA")

_ONE_BLOCK: tuple[Cell, ...] = (
    *(_method(_VEL, method, seed) for seed in (0, 1, 2) for method in _ON_VEL),
    *(_method(_VEL, method, seed) for seed in (3, 4) for method in _FIVE_TIMES),
    *(_one(_VEL, _PLAIN, {"prompts": changed}, _STARTS, seed=seed, label=label)
      for seed in (0, 1, 2)
      for label, changed in (("rank-10", {"rank": 10}), ("length-3", {"length": 3}))),
    # The weights of MPDT-no-distillation again, acting with the mean of two tasks' prompts.
    *(_one(_VEL, _PLAIN, _INFER, _TWO, _TEST, seed=seed, label="mixture") for seed in (0, 1, 2)),
    *(_method(_VEL, method) for method in _ONCE if method not in _ON_VEL),
    *(_one(_VEL, _PLAIN, {"prompts": changed}, _STARTS, label=label)
      for label, changed in (("rank-4", {"rank": 4}), ("length-9", {"length": 9}),
                             ("length-60", {"length": 60}), ("length-90", {"length": 90}))),
    _one(_VEL, "MPDT-E", {"teacher": {"distillation": "prompt"}}, _STARTS, label="distil-prompt"),
    # Is anything left of a language model? Trained from scratch, with prompts that can be averaged.
    *(_one(_VEL, "MPDT-WP", {"prompts": {"task_init": "ones"}, "teacher": {"distillation": "none"}},
           _TWO, _STARTS, seed=seed, label="WP-ones") for seed in (0, 1, 2)),
    *(_method(data, method) for data in ("cheetah_dir", "ant_dir", "ml10")
      for method in (*_THRICE, *_ONCE)),
    *(_method("mt10", method) for method in ("MPDT-ones", "Prompt-DT")),
    _one("mt10", "MPDT-E", _STARTS),
    *(_method(data, method, seed) for data in ("cheetah_dir", "ant_dir", "ml10")
      for seed in (1, 2) for method in _THRICE),
    *(_one(data, "MPDT-ones", _LONG, _STARTS, _EXPERT, seed=seed, label="ones-long")
      for seed in (0, 1, 2) for data in ("mt10", "ml10")),
    *(_one("ml10", "MPDT-ones", _LONG, _STARTS, _EXPERT, seed=seed, label="ones-long")
      for seed in (3, 4)),
    _one("mt10", "MPDT-ones", _LONG, {"multitask": {"steps": 9000}}, _STARTS, label="ones-longer"),
    # Its weights again: few-shot that tunes the map and the head as well.
    *(_one("ml10", "MPDT-ones", _LONG, _ALL_TUNED, _TEST, seed=seed, label="few-shot-all")
      for seed in (0, 1, 2, 3, 4)),
    # What the previous action does to it; Prompt-DT longer, and with no action in its windows and
    # demonstrations.
    *(_one(data, "MPDT-ones", _LONG, _SHOWN, _STARTS, label="ones-long-shown")
      for data in ("mt10", "ml10")),
    *(_one(data, "Prompt-DT", {"multitask": {"steps": steps}}, size, _INFER, changes, label=label)
      for data, steps, size in ((_VEL, 5000, {}), ("mt10", 6000, _SMALLER))
      for changes, label in (({}, "Prompt-DT-long"), (_HIDDEN, "Prompt-DT-long-no-actions"))),
    *(_method(_VEL, "MPDT-ones", seed, _HIDDEN, label="ones-hidden") for seed in (0, 1, 2)),
    # As long as four blocks took; as on ml10 and mt10 without the previous action.
    *(_method("ant_dir", "MPDT-ones", seed, _ANT_LONG, label="ones-long") for seed in (0, 1, 2)),
)  # fmt: skip

_NEAREST = ({"adapt": {"starts": ["infer", "infer_aligned"], "infer": {"tasks": 1}}}, _TEST)
_FIRST_PASS: tuple[Cell, ...] = (
    *(_four(_VEL, method, _STARTS, _EXPERT)
      for method in (_PLAIN, "MPDT-E", "MPDT", "MPDT-mixed")),
    *(_four(_VEL, method, _STARTS, seed=seed) for seed in (1, 2) for method in (_PLAIN, "MPDT-E")),
    *(_four(_VEL, method, _STARTS) for method in ("MPDT-WP", "MPDT-WP-frozen")),
    *(_four(_VEL, "MPDT-ones", _STARTS, _EXPERT, seed=seed, label="ones") for seed in (0, 1, 2)),
    _four(_VEL, "Soft-Prompt-TTA", _EXPERT),
    *(_four(_VEL, method) for method in ("MT-BC-FT", "MT-ORL-FT")),
    *(_four(_VEL, "Prompt-DT", _INFER, seed=seed) for seed in (0, 1, 2)),
    _four(_VEL, "Prompt-DT", {"multitask": {"steps": 5000}}, _INFER, label="Prompt-DT-long"),
    _four(_VEL, "MPDT-E", _EVERY_START, _LEVELS, label="starts"),
    _four(_VEL, _PLAIN, {"prompts": {"rank": 10}}, _STARTS, label="rank-10"),
    _four(_VEL, _PLAIN, {"prompts": {"length": 3}}, _STARTS, label="length-3"),
    *(_four(_VEL, _PLAIN, {"backbone": {"depth": depth}}, _STARTS, label=f"depth-{depth}")
      for depth in (1, 2)),
    _four("cheetah_dir", "MPDT-E", _STARTS, _EXPERT),
    _four("cheetah_dir", "MPDT-ones", _STARTS, _EXPERT, label="ones"),
    _four("ant_dir", _PLAIN, _STARTS, _EXPERT),
    _four("ant_dir", "MPDT-ones", _STARTS, _EXPERT, label="ones"),
    *(_four(data, "Prompt-DT", _INFER) for data in ("cheetah_dir", "ant_dir", "ml10")),
    *(_four(data, _PLAIN, _STARTS, _EXPERT) for data in ("ml10", "mt10")),
    _four("ml10", _PLAIN, _LONG, {"adapt": {"starts": ["cross"]}}, _EXPERT, label="long"),
    _four("mt10", _PLAIN, _LONG, _INFER, label="long"),
    *(_four("mt10", "Prompt-DT", _SMALLER, {"multitask": {"steps": steps}}, _INFER, label=label)
      for label, steps in (("Prompt-DT-long", 6000), ("Prompt-DT-longest", 16000))),
    # Neither return-to-go nor time: goals at other distances shift both.
    _four("mt10", "Prompt-DT", _SMALLER, {"multitask": {"steps": 8000}}, _INFER,
          {"inputs": {"return_to_go": "none", "time_table": 0}}, label="Prompt-DT-reactive"),
    # Other judgements of the weights of MPDT-no-distillation (of mt10: of `long`): the nearest
    # task's prompt alone, and few-shot that tunes the map and the head as well.
    *(_four(_VEL, _PLAIN, *_NEAREST, seed=seed, label="nearest") for seed in (1, 2)),
    _four("ant_dir", _PLAIN, *_NEAREST, label="nearest"),
    _four("mt10", _PLAIN, _LONG, *_NEAREST, label="long-nearest"),
    _four("ml10", _PLAIN, _ALL_TUNED, _TEST, label="few-shot-all"),
)  # fmt: skip

# Ten tasks of the fifty make an update, as on ml10. Test classes are five and judged longer.
_FIFTY_SIZE: Mapping[str, Any] = {
    "sampler": {"per_task": 6},
    "optimiser": {"warmup_steps": 50},
    "teacher": {"steps": 400},
    "multitask": {"steps": 5500},
}
_LONGER: Mapping[str, Mapping[str, Any]] = {
    "ml45": {"evaluation": {"episodes": 20, "train_episodes": 5}},
    "mt50": {"evaluation": {"episodes": 5}},
}
_NOTHING_OR_X = {"adapt": {"starts": ["cross", "cross_mean", "infer"]}}
_COMPARED: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "MPDT-ones": (_NOTHING_OR_X, _EXPERT),
    "MPDT-E": (_NOTHING_OR_X, _EXPERT),
    "MPDT": (_NOTHING_OR_X,),
    "Prompt-DT": (_INFER,),
    "Soft-Prompt-TTA": (_EXPERT,),
}


def _fifty(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    return _one(data, method, _FIFTY_SIZE, _LONGER[data], *changes, seed=seed, label=label)


_FIFTY: tuple[Cell, ...] = (
    *(_fifty(data, method, *_COMPARED[method], seed=seed)
      for seed in (0, 1, 2) for method in _COMPARED for data in ("ml45", "mt50")),
    # The weights of MPDT-ones again: few-shot that tunes the map and the head as well.
    *(_fifty("ml45", "MPDT-ones", _ALL_TUNED, _TEST, seed=seed, label="few-shot-all")
      for seed in (0, 1, 2)),
    *(_fifty(data, _PLAIN, {"prompts": changed}, _NOTHING_OR_X, label=label)
      for data in ("ml45", "mt50")
      for label, changed in (("rank-1", {}), ("rank-4", {"rank": 4}), ("rank-10", {"rank": 10}),
                             ("length-3", {"length": 3}), ("length-9", {"length": 9}))),
    *(_fifty(data, method, _NOTHING_OR_X)
      for data in ("ml45", "mt50") for method in ("MPDT-WP", "MPDT-WP-frozen")),
    # As others train on less than expert episodes; judged against the same expert.
    _fifty("mt50", "MPDT-ones", {"quality": "medium"}, _NOTHING_OR_X, label="ones-medium"),
    # Three times the updates.
    *(_fifty(data, "MPDT-ones", {"multitask": {"steps": 16500}}, _NOTHING_OR_X, label="ones-longer")
      for data in ("mt50", "ml45")),
)  # fmt: skip


def _trials(data: str, row: str, counts: list[int], seed: int, trial_seed: int) -> Cell:
    """One row of the protocol alone; fresh goals are judged 20 times a task."""
    adapt = {"starts": ["trials"],
             "trials": {"episodes": counts, "rows": [row], "seed": trial_seed}}  # fmt: skip
    judged = {"evaluation": {"blocks": ["test"], "episodes": 20}}
    size = {_VEL: {}, "ml45": _FIFTY_SIZE, "ant_dir_endless": _ANT_LONG}.get(data, _LONG)
    return _one(data, "MPDT-ones", size, {"adapt": adapt}, judged, seed=seed,
                label=f"ones-{row.replace('_', '-')}-t{trial_seed}")  # fmt: skip


_TRIALS: tuple[Cell, ...] = (
    *(_trials("ml10", row, [1, 3, 10], seed, trial_seed)
      for trial_seed in (0, 1, 2) for row in ("with_x", "alone") for seed in (0, 1, 2)),
    *(_trials("cheetah_vel", "alone", [1, 3, 10], seed, 0) for seed in (0, 1, 2)),
    _trials("ml10", "race", [1, 3, 10], 0, 0),
    *(_trials("ml45", row, [1, 3, 10], 0, 0) for row in ("with_x", "alone")),
    _trials("ant_dir_endless", "alone", [1, 3, 10], 0, 0),
)  # fmt: skip


def _deep(data: str, depth: int, changes: Mapping[str, Any] | None = None) -> Cell:
    size = {} if data == _VEL else _LONG
    return _one(data, "MPDT-ones", size, {"backbone": {"depth": depth}}, _STARTS, changes or {},
                label=f"ones-depth-{depth}")  # fmt: skip


# SmolLM2-135M has 30 blocks. GPT-2's shape needs its own weights, which no cache here has: its 12
# blocks are drawn at random.
_DEPTH: tuple[Cell, ...] = (
    *(_deep(data, depth) for depth in (4, 12, 30) for data in (_VEL, "ml10")),
    *(_one(data, "MPDT-ones", {} if data == _VEL else _LONG, _STARTS,
           {"backbone": {"name": "random:gpt2", "depth": 12}}, label="ones-gpt2-12")
      for data in (_VEL, "ml10")),
    *(_one("ml10", "MPDT-ones", _LONG, _STARTS, {"sampler": {"window": window}},
           label=f"ones-window-{window}") for window in (50, 500)),
)  # fmt: skip

STUDIES: Mapping[str, tuple[Cell, ...]] = {
    "one-block": _ONE_BLOCK,
    "fifty": _FIFTY,
    "depth": _DEPTH,
    "trials": _TRIALS,
    "first-pass": _FIRST_PASS,
}


def get_study(name: str) -> tuple[Cell, ...]:
    """Raises: UsageError naming the nearest study."""
    if name not in STUDIES:
        raise unknown_name("study", name, STUDIES, where=f"study {name}")
    return STUDIES[name]
