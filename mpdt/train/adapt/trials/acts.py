"""Who acts in a trial, step by step: a policy, a tour of prompts, the planner, or two of them.

Each is an `Act`: it is asked at every step and knows nothing but the episode so far.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mpdt.data.sim.actors import Rows
from mpdt.data.sim.play import Record
from mpdt.seeding import SeedKey
from mpdt.train.adapt.trials.live import Act, Floats
from mpdt.train.evaluate.controller import PromptController


def by_policy(controller: PromptController, key: SeedKey, horizon: int) -> Act:
    """The policy behind its only prompt."""
    return _listening(controller, [key], horizon, lambda step: 0)


def by_tour(controller: PromptController, key: SeedKey, horizon: int, prompts: int, until: int
            ) -> Act:  # fmt: skip
    """Each of the controller's prompts for an equal share of the first `until` steps."""
    each = max(1, -(-until // prompts))
    return _listening(controller, [key] * prompts, horizon, lambda step: (step // each) % prompts)


def _listening(
    controller: PromptController, keys: Sequence[SeedKey], horizon: int, row: Callable[[int], int]
) -> Act:
    """All prompts see the episode; what that of `row(step)` answers is done."""
    n = len(keys)
    controller.begin(Rows(keys, horizon=horizon, tasks=np.arange(n)))

    def act(step: int, seen: Floats, paid: float | None, _: Record) -> NDArray[np.floating]:
        rewards = None if paid is None else np.full(n, paid, np.float32)
        answers: NDArray[np.floating] = controller.act(step, np.repeat(seen[None], n, 0), rewards)
        action: NDArray[np.floating] = answers[row(step)]
        return action

    return act


def relay(first: Act, until: int, second: Callable[[int, Record], Act]) -> Act:
    """`first` for `until` steps, and for the whole episode if it succeeds in these; then another,
    made when its turn comes (step, episode so far)."""
    later: list[Act] = []

    def act(step: int, seen: Floats, paid: float | None, record: Record) -> NDArray[np.floating]:
        if step == until and not (
            record.successes is not None and record.successes[0, :step].any()
        ):
            later.append(second(step, record))
        return (later[0] if later else first)(step, seen, paid, record)

    return act
