"""Do the settings of a run fit each other? Asked before anything is trained.

    time table     a row for every step of an episode, of the data and of the evaluation
    positions      prompt + window must lie inside what the language model can place
    teacher        prompts of a kind that it can teach
    adapt.layers   blocks that are there

Each part checks itself as well, where it is used; here all of it is known at once, in seconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from mpdt.errors import UsageError

if TYPE_CHECKING:
    from mpdt.train.run.config import TrainConfig


# `prompt` compares prompts, so they must have one shape; adapters leave no room for a teacher.
_TAUGHT = {
    "prompt": ("decomposed", "shared"),
    "parts": ("decomposed",),
    "mpt": ("decomposed", "shared", "demonstration", "none"),
}


class Shape(Protocol):
    """What is asked of a `Backbone`."""

    @property
    def name(self) -> str: ...
    @property
    def num_layers(self) -> int: ...
    @property
    def max_positions(self) -> int: ...


def check_fits(backbone: Shape, config: TrainConfig, horizon: int) -> None:
    """Raises: UsageError naming the setting, what fits and what was found.

    Args:
        horizon: steps of the longest episode of the data; the evaluation's own counts too.
    """
    steps = max(horizon, config.evaluation.horizon)
    rows = config.inputs.time_table
    if 0 < rows < steps:
        raise UsageError(
            "an episode is longer than the time-step table",
            where="inputs.time_table",
            expected=f"at least {steps}, or 0 for none",
            found=str(rows),
            hint=f"--inputs.time-table {steps}",
        )
    tokens = config.sampler.window * config.inputs.tokens_per_step
    before = _positions_before(config)
    if before + tokens > backbone.max_positions:
        raise UsageError(
            "prompt and window are longer than the language model",
            where="prompts.length, sampler.window",
            expected=f"at most {backbone.max_positions} positions ({backbone.name})",
            found=f"{before} + {tokens}",
            hint="shorten --prompts.length or --sampler.window",
        )
    taught = _TAUGHT.get(config.teacher.distillation)
    if taught is not None and config.prompts.kind not in taught:
        raise UsageError(
            "a teacher's soft prompt cannot teach prompts of this kind",
            where="teacher.distillation",
            expected=f"prompts of kind {', '.join(taught)}",
            found=config.prompts.kind,
            hint="--teacher.distillation none",
        )
    last = backbone.num_layers - 1
    if any(not 0 <= layer <= last for layer in config.adapt.layers):
        raise UsageError(
            f"{backbone.name} has no such block",
            where="adapt.layers",
            expected=f"0 to {last}",
            found=" ".join(map(str, config.adapt.layers)),
            hint="leave it out to compare all blocks",
        )


def _positions_before(config: TrainConfig) -> int:
    """Places that the prompt takes; the larger of teacher's and student's.

    A demonstration of l steps is l q tokens. HDT's (`hyper`) becomes adapters, which take none.
    """
    length, kind = config.prompts.length, config.prompts.kind
    own = {"demonstration": length * config.inputs.tokens_per_step, "hyper": 0, "none": 0}
    taught = length if config.teacher.distillation != "none" else 0
    return max(own.get(kind, length), taught)
