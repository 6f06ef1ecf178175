"""A race of prompts, for comparison: what own episodes bring without a model or learning.

Each trial tries the next prompt: P_c o mean P_k, then those of the training tasks, evenly spaced if
there are many. The best so far is taken: by success, then by return. Nothing is planned or cloned.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from mpdt.model.policy import PromptPolicy
from mpdt.train.adapt.trials.contenders import Contender


def runners(policy: PromptPolicy, mean: Tensor, voices: Tensor) -> list[Contender]:
    """Contenders in the order of their turns.

    Args:
        mean (1, l, s), voices (V, l, s).
    """
    prompts = [mean, *voices[:, None]]
    return [Contender("mean" if i == 0 else f"prompt {i}", policy, prompt)
            for i, prompt in enumerate(prompts)]  # fmt: skip


def next_runner(contenders: Sequence[Contender]) -> int:
    """The first that has run least often."""
    return min(range(len(contenders)), key=lambda i: (len(contenders[i].returns), i))


def leader(contenders: Sequence[Contender]) -> int:
    """The one with most of its runs successful, of several the one that earned most; before the
    first run the mean prompt."""
    ran = [i for i, one in enumerate(contenders) if one.returns]

    def key(i: int) -> tuple[float, float, int]:
        one = contenders[i]
        runs = len(one.returns)
        return (sum(one.successes) / runs, sum(one.returns) / runs, -i)

    return max(ran, key=key, default=0)
