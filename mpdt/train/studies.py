"""Studies: lists of cells = data x method x seed, with the settings that are studied. Data only.

    one-block     every method on every family with one block of the language model, three seeds
                  for the main ones; on cheetah_vel one thing changed at a time as well
    first-pass    the same with four blocks, begun first: it costs four times as much, was run in
                  part, and shows what the depth does

Sizes were chosen by cost, not by returns (docs/decisions/0011).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mpdt.errors import unknown_name
from mpdt.train.methods import has_language_model, merge


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
_STARTS = {"adapt": {"starts": ["cross", "infer", "infer_aligned"]}}
_INFER = {"adapt": {"starts": ["infer"]}}
# What most of these cells were judged with; held-out training tasks have since chosen one (0010).
_TWO = {"adapt": {"infer": {"tasks": 2}}}
_NEAREST = {
    "adapt": {"starts": ["infer", "infer_aligned"], "infer": {"tasks": 1}},
    "evaluation": {"blocks": ["test"]},
}
_ALL_STARTS = ["cross", "cross_mean", "cross_one", "cross_random", "infer", "infer_aligned"]
_EXPERT = {"few_shot": {"qualities": ["expert"]}}
_LEVELS = {"few_shot": {"qualities": ["expert", "medium", "random", "mixed"]}}


def _size(data: str) -> Mapping[str, Any]:
    return _FEW if data == "cheetah_dir" else {} if data in ("ml10", "mt10") else _MANY


def _cell(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    return _laid(data, method, seed, label, _blocks(method, 4), _TWO, *changes)


def _laid(data: str, method: str, seed: int, label: str, *changes: Mapping[str, Any]) -> Cell:
    laid: dict[str, Any] = {}
    for each in (_size(data), *changes):
        laid = merge(laid, each)
    return Cell(data, method, seed, label, changes=laid)


def _blocks(method: str, depth: int) -> Mapping[str, Any]:
    return {"backbone": {"depth": depth}} if has_language_model(method) else {}


def _family(data: str) -> tuple[Cell, ...]:
    """Every method on one family, the ones that matter most first."""
    return (
        _cell(data, "MPDT-no-distillation", _STARTS, _EXPERT),
        _cell(data, "MPDT-mixed", _STARTS, _EXPERT),
        _cell(data, "Prompt-DT", _INFER),
        _cell(data, "MT-BC-FT"),
        _cell(data, "MPDT-E", _STARTS, _EXPERT),
        _cell(data, "MPDT", _STARTS, _EXPERT),
        _cell(data, "Soft-Prompt-TTA", _EXPERT),
        _cell(data, "MPDT-WP-frozen", _STARTS),
        _cell(data, "MPDT-WP", _STARTS),
        _cell(data, "MT-ORL-FT"),
        _cell(data, "LaMo"),
        _cell(data, "HDT"),
        _cell(data, "Full-FT"),
        _cell(data, "MPDT+sparse", _STARTS),
        _cell(data, "Prompt-DT-TTA"),
        *(
            _cell(data, method, _STARTS if method.startswith("MPDT") else _INFER, seed=seed)
            for seed in (1, 2)
            for method in ("MPDT-E", "Prompt-DT", "MPDT-WP", "MPDT-no-distillation")
        ),
    )


_VEL = "cheetah_vel"

# What training longer brings, past the ten minutes of the other cells: smaller updates, five
# times as many.
_LONG: Mapping[str, Any] = {
    "sampler": {"per_task": 6},
    "optimiser": {"warmup_steps": 50},
    "multitask": {"steps": 3000},
}

_ABLATIONS: tuple[Cell, ...] = (
        _cell(_VEL, "MPDT-teacher-parts", _STARTS),
        _cell(_VEL, "MPDT-E", {"adapt": {"starts": _ALL_STARTS}}, _LEVELS, label="starts"),
        _cell(_VEL, "MPDT-E", {"teacher": {"distillation": "prompt"}}, label="distil-prompt"),
        *(_cell(_VEL, "MPDT-no-distillation", {"prompts": {"rank": rank}}, _STARTS,
                label=f"rank-{rank}") for rank in (4, 10)),
        *(_cell(_VEL, "MPDT-no-distillation", {"prompts": {"length": length}}, _STARTS,
                label=f"length-{length}") for length in (3, 9, 60, 90)),
        *(_cell(_VEL, "MPDT-no-distillation", {"backbone": {"depth": depth}}, _STARTS,
                label=f"depth-{depth}") for depth in (1, 2, 8)),
        *(_cell(data, "MPDT-ones", _STARTS, _EXPERT, seed=seed, label="ones")
          for data, seed in ((_VEL, 0), (_VEL, 1), (_VEL, 2), ("ant_dir", 0), ("cheetah_dir", 0),
                             ("ml10", 0), ("mt10", 0))),
)  # fmt: skip


def _one(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    """With one block, judged by default: `infer` as the method has it."""
    return _laid(data, method, seed, label, _blocks(method, 1), *changes)


_EVERY_START = {"adapt": {"starts": _ALL_STARTS}}
# What each method is judged with.
_OWN: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "MPDT-E": (_EVERY_START, _LEVELS),
    "MPDT": (_STARTS, _EXPERT),
    "MPDT-no-distillation": (_STARTS, _EXPERT),
    "MPDT-ones": (_STARTS, _EXPERT),
    "MPDT-mixed": (_STARTS, _EXPERT),
    "MPDT-WP": (_STARTS,),
    "MPDT-WP-frozen": (_STARTS,),
    "MPDT-teacher-parts": (_STARTS,),
    "MPDT+sparse": (_STARTS,),
    "Soft-Prompt-TTA": (_EXPERT,),
    "Prompt-DT": (_INFER,),
}


def _method(data: str, method: str, seed: int = 0) -> Cell:
    return _one(data, method, *_OWN.get(method, ()), seed=seed)


_FEW_BASELINES = ("Prompt-DT-TTA", "MT-BC-FT", "MT-ORL-FT", "HDT", "LaMo", "Full-FT")
_THRICE = ("MPDT-ones", "MPDT-E", "Prompt-DT", "MPDT-WP", "MPDT-no-distillation")
_ONCE = ("MPDT", "Soft-Prompt-TTA", "MPDT-WP-frozen", "MPDT-mixed", *_FEW_BASELINES, "MPDT+sparse")
# Claims are judged on cheetah_vel: three seeds for both sides of each.
_ON_VEL = (*_THRICE, "MPDT", "Soft-Prompt-TTA", "MPDT-WP-frozen", "MPDT-teacher-parts")
_PLAIN = "MPDT-no-distillation"

_ONE_BLOCK_CELLS: tuple[Cell, ...] = (
    *(_method(_VEL, method, seed) for seed in (0, 1, 2) for method in _ON_VEL),
    *(_one(_VEL, _PLAIN, {"prompts": changed}, _STARTS, seed=seed, label=label)
      for seed in (0, 1, 2)
      for label, changed in (("rank-10", {"rank": 10}), ("length-3", {"length": 3}))),
    # The weights of MPDT-no-distillation again, acting with the mean of two tasks' prompts.
    *(_one(_VEL, _PLAIN, _INFER, _TWO, {"evaluation": {"blocks": ["test"]}}, seed=seed,
           label="mixture") for seed in (0, 1, 2)),
    *(_method(_VEL, method) for method in _ONCE if method not in _ON_VEL),
    *(_one(_VEL, _PLAIN, {"prompts": changed}, _STARTS, label=label)
      for label, changed in (("rank-4", {"rank": 4}), ("length-9", {"length": 9}),
                             ("length-60", {"length": 60}), ("length-90", {"length": 90}))),
    _one(_VEL, "MPDT-E", {"teacher": {"distillation": "prompt"}}, _STARTS, label="distil-prompt"),
    # Is anything left of a language model? Trained from scratch, with prompts that can be averaged.
    *(_one(_VEL, "MPDT-WP", {"prompts": {"task_init": "ones"}}, _TWO, _STARTS, seed=seed,
           label="WP-ones") for seed in (0, 1, 2)),
    *(_method(data, method) for data in ("cheetah_dir", "ant_dir", "ml10")
      for method in (*_THRICE, *_ONCE)),
    *(_method("mt10", method) for method in ("MPDT-ones", "MPDT-E", "Prompt-DT")),
    *(_method(data, method, seed) for data in ("cheetah_dir", "ant_dir", "ml10")
      for seed in (1, 2) for method in _THRICE),
    *(_one(data, "MPDT-ones", _LONG, {"multitask": {"steps": 8000}}, _STARTS, _EXPERT, seed=seed,
           label="ones-long") for seed in (0, 1, 2) for data in ("mt10", "ml10")),
)  # fmt: skip

STUDIES: Mapping[str, tuple[Cell, ...]] = {
    "one-block": _ONE_BLOCK_CELLS,
    "first-pass": (
        *(cell for data in (_VEL, "cheetah_dir", "ant_dir", "ml10", "mt10")
          for cell in _family(data)),
        *_ABLATIONS,
        *(_cell(_VEL, "Prompt-DT", {"multitask": {"steps": 5000}}, _INFER, seed=seed,
                label="Prompt-DT-long") for seed in (0, 1, 2)),
        _cell(_VEL, "MPDT-mixed", {"multitask": {"steps": 3000}}, _STARTS, _EXPERT,
              label="mixed-long"),
        _cell("mt10", "Prompt-DT", {"sampler": {"per_task": 4}, "multitask": {"steps": 6000}},
              _INFER, label="Prompt-DT-long"),
        _cell("mt10", "Prompt-DT", {"sampler": {"per_task": 4}, "multitask": {"steps": 16000}},
              _INFER, label="Prompt-DT-longest"),
        # Neither return-to-go nor time: goals at other distances shift both.
        _cell("mt10", "Prompt-DT", {"sampler": {"per_task": 4}, "multitask": {"steps": 8000},
                                    "inputs": {"return_to_go": "none", "time_table": 0}},
              _INFER, label="Prompt-DT-reactive"),
        _cell("mt10", "MPDT-no-distillation", _LONG, _INFER,
              label="long"),
        _cell("ml10", "MPDT-no-distillation", _LONG, {"adapt": {"starts": ["cross"]}}, _EXPERT,
              label="long"),
        *(_cell(_VEL, "MPDT-mixed", _STARTS, seed=seed) for seed in (1, 2)),
        # Other judgements of the weights of MPDT-no-distillation (of mt10: of `long`): the nearest
        # task's prompt alone, and few-shot that tunes the map and the head as well.
        *(_cell(_VEL, "MPDT-no-distillation", _NEAREST, seed=seed, label="nearest")
          for seed in (0, 1, 2)),
        _cell("ant_dir", "MPDT-no-distillation", _NEAREST, label="nearest"),
        _cell("mt10", "MPDT-no-distillation", _LONG, _NEAREST, label="long-nearest"),
        _cell("ml10", "MPDT-no-distillation",
              {"few_shot": {"qualities": ["expert"], "tuned": "all", "updates": 300},
               "adapt": {"starts": ["none"]}, "evaluation": {"blocks": ["test"]}},
              label="few-shot-all"),
    ),
}  # fmt: skip


def get_study(name: str) -> tuple[Cell, ...]:
    """Raises: UsageError naming the nearest study."""
    if name not in STUDIES:
        raise unknown_name("study", name, STUDIES, where=f"study {name}")
    return STUDIES[name]
