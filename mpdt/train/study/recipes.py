"""What cells are made of: settings by what they change, and how they are laid over each other.

    size of the data -> blocks of the language model -> the previous action -> what is asked

Sizes were chosen by cost, not by returns (docs/decisions/0011).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

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
MANY: Mapping[str, Any] = {
    "sampler": {"tasks_per_update": 8, "per_task": 4},
    "optimiser": {"warmup_steps": 50},
    "teacher": {"steps": 400},
    "multitask": {"steps": 1200},
    "evaluation": {"train_episodes": 1},
}
FEW: Mapping[str, Any] = {"teacher": {"steps": 200}, "multitask": {"steps": 400}}
TEN: Mapping[str, Any] = {"teacher": {"steps": 200}, "multitask": {"steps": 600}}
# What all sizes start from.
COMMON: Mapping[str, Any] = {
    "sampler": {"per_task": 16},
    "optimiser": {"warmup_steps": 100},
    "multitask": {"checkpoint_every": 100},
}
# What training longer brings: smaller updates, five times as many.
LONG: Mapping[str, Any] = {
    "sampler": {"per_task": 6},
    "optimiser": {"warmup_steps": 50},
    "multitask": {"steps": 3000},
}
SMALLER: Mapping[str, Any] = {"sampler": {"per_task": 4}}
INFER = {"adapt": {"starts": ["infer"]}}
STARTS = {"adapt": {"starts": ["cross", "infer", "infer_aligned"]}}
EVERY_START = {"adapt": {"starts": ["cross", "cross_mean", "cross_one", "cross_random", "infer",
                                     "infer_aligned"]}}  # fmt: skip
EXPERT = {"few_shot": {"qualities": ["expert"]}}
LEVELS = {"few_shot": {"qualities": ["expert", "medium", "random", "mixed"]}}
TWO = {"adapt": {"infer": {"tasks": 2}}}
BY_STEPS = {"adapt": {"infer": {"by": "steps"}}}
TEST = {"evaluation": {"blocks": ["test"]}}
ALL_TUNED = {"few_shot": {"qualities": ["expert"], "tuned": "all", "updates": 300},
              "adapt": {"starts": ["none"]}}  # fmt: skip
# Classes left out of ml45's training preferred it to 1e-3 and 1e-4 (decision 0011).
SLOWER: Mapping[str, Any] = {"few_shot": {"lr": 3e-4}}
# MPDT-ones, when the method is MPDT-WP.
SCRATCH_ONES: Mapping[str, Any] = {"prompts": {"task_init": "ones"},
                                    "teacher": {"distillation": "none"}}  # fmt: skip

PLAIN = "MPDT-no-distillation"
VEL = "cheetah_vel"


def laid(data: str, method: str, seed: int, label: str, *changes: Mapping[str, Any]) -> Cell:
    size = {"cheetah_dir": FEW, "ml10": TEN, "mt10": TEN}.get(data, MANY)
    laid: dict[str, Any] = {}
    for each in (COMMON, size, *changes):
        laid = merge(laid, each)
    return Cell(data, method, seed, label, changes=laid)


def blocks(method: str, depth: int) -> Mapping[str, Any]:
    return {"backbone": {"depth": depth}} if has_language_model(method) else {}


META_WORLD = ("ml10", "mt10", "ml45", "mt50")
# Cheetah, ant and the first pass: shown, as published (0018 for what Meta-World says of it).
SHOWN = {"inputs": {"previous_action": True}}
HIDDEN = {"inputs": {"previous_action": False}}
ANT_LONG: Mapping[str, Any] = {"multitask": {"steps": 4800}, **HIDDEN}


def four(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    """Judged with the mean of two tasks' prompts; since then held-out training tasks have chosen
    the nearest one's (0010)."""
    return laid(data, method, seed, label, blocks(method, 4), TWO, SHOWN, *changes)


def one(
    data: str, method: str, *changes: Mapping[str, Any], seed: int = 0, label: str = ""
) -> Cell:
    """Judged by default: `infer` as the method has it."""
    shown = {} if data in META_WORLD else SHOWN
    return laid(data, method, seed, label, blocks(method, 1), shown, *changes)


# What each method is judged with.
OWN: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "MPDT-E": (EVERY_START, LEVELS),
    **dict.fromkeys(("MPDT", PLAIN, "MPDT-ones", "MPDT-mixed"), (STARTS, EXPERT)),
    **dict.fromkeys(("MPDT-WP", "MPDT-WP-frozen", "MPDT-teacher-parts", "MPDT+sparse"), (STARTS,)),
    "Soft-Prompt-TTA": (EXPERT,),
    "Prompt-DT": (INFER,),
}


def cell_of(
    data: str, method: str, seed: int = 0, *changes: Mapping[str, Any], label: str = ""
) -> Cell:
    return one(data, method, *OWN.get(method, ()), *changes, seed=seed, label=label)
