"""Do the settings of a run fit each other? Asked before anything is trained.

    time table     a row for every step of an episode, of the data and of the evaluation
    positions      soft prompt + window must lie inside what the language model can place
    adapt.layers   blocks that are there

Each part checks itself as well, where it is used; here all of it is known at once, in seconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from mpdt.errors import UsageError

if TYPE_CHECKING:
    from mpdt.train.config import TrainConfig


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
    needed = config.prompts.length + tokens
    if needed > backbone.max_positions:
        raise UsageError(
            "soft prompt and window are longer than the language model",
            where="prompts.length, sampler.window",
            expected=f"at most {backbone.max_positions} positions ({backbone.name})",
            found=f"{config.prompts.length} + {tokens}",
            hint="shorten --prompts.length or --sampler.window",
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
