"""Constants: the best task-blind constant action of a family, chosen on its training tasks.

    candidates     zero, then +1 along each axis, then -1 along each axis
    level[k, c]    (R[k, c] - R_random[k]) / (R_expert[k] - R_random[k])
    chosen         the candidate of the highest mean level over the training tasks

One action for all tasks: what a policy reaches that knows the family and nothing of the task.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def constant_actions(action_size: int) -> npt.NDArray[np.float32]:
    """The candidates (2 * action_size + 1, action_size), zero first."""
    axes = np.eye(action_size, dtype=np.float32)
    return np.concatenate([np.zeros((1, action_size), np.float32), axes, -axes])


def choose_constant(returns: FloatArray, random: FloatArray, expert: FloatArray) -> int | None:
    """The best candidate by its mean level over tasks; of equal ones the first.

    Args:
        returns: (K, C) mean returns of C candidates on K training tasks.
        random, expert: (K,) mean returns that are level 0 and 1.

    Returns: None where a level is not defined for some task, or there is no task.
    """
    if not len(returns):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        levels = (returns - random[:, None]) / (expert - random)[:, None]
    if not np.isfinite(levels).all():
        return None
    return int(levels.mean(axis=0).argmax())
