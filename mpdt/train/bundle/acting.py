"""A trained policy in a loop of its user's: one environment, many, or another library's.

    policy = mpdt.load_policy("runs/cheetah_dir-base", task="forward")
    observation, reward, over = env.reset(seed=0)[0], None, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy.act(observation, reward))
        over = terminated or truncated

The numbers are those of `evaluate`, row by row: a row does not depend on which others act beside
it. Between calls torch has the threads it had. Up to sixteen rows act on one of them, more rows on
all, to the same bits; where others work on the machine, `torch.set_num_threads(1)` is faster.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from mpdt.data.spec.tasks import Family
from mpdt.errors import ShapeError, TrainingError, UsageError, unknown_name
from mpdt.model.closed_loop import ClosedLoop
from mpdt.model.fingerprint import fingerprint
from mpdt.model.policy import PromptPolicy
from mpdt.model.returns import ReturnTable

Array = NDArray[Any]


class ActingPolicy:
    """One trained policy behind the prompts of its tasks; a state, many rows.

    Args:
        prompts: (n, l, s), one per task.
        returns: n rows; their targets are what is asked for unless told otherwise.
        tasks: n names.
        task: whose prompt a row acts behind that names none.
        window: steps a window holds, as in training.
    Attributes:
        task: may be set; counts from the next `reset` on, or the next episode of `act`.
    """

    def __init__(
        self, policy: PromptPolicy, prompts: Tensor, returns: ReturnTable, family: Family,
        tasks: Sequence[str], task: str, window: int,
    ) -> None:  # fmt: skip
        self.family, self.tasks, self.task = family, tuple(tasks), task
        self._policy, self._prompts, self._returns = policy, prompts, returns
        self._window = window
        self._targets = dict(zip(self.tasks, returns.target.double().tolist(), strict=True))
        self._loop: ClosedLoop | None = None
        self._names: tuple[str, ...] = ()
        self._slot(task)

    @property
    def targets(self) -> Mapping[str, float]:
        """The return asked of each task's episodes, in the raw unit of its reward."""
        return dict(self._targets)

    def ask(self, target: float, task: str | None = None) -> None:
        """From the next episodes of a task (None: of `self.task`) on, ask for that return.

        Raises: UsageError for a task without a prompt here, or what is no number.
        """
        if not np.isfinite(target):
            raise UsageError("a return that is no number", where="ask", found=str(target))
        name = self.task if task is None else task
        self._slot(name)
        self._targets[name] = float(target)

    def act(self, observation: ArrayLike, reward: float | None = None) -> NDArray[np.float32]:
        """The action (A,) for an observation (D,) of one environment of `self.task`.

        Args:
            reward: what the action before was paid. None begins a new episode: the policy
                forgets what it has seen.
        """
        if reward is None and self._names != (self.task,):
            self.reset()
        elif len(self._names) != 1:
            raise ShapeError("one environment after many", where="act",
                             expected=f"act_batch with {len(self._names)} rows",
                             hint="begin an episode without a reward")  # fmt: skip
        shown = self._numbers(observation)[None]
        starts = np.array([reward is None])
        action: NDArray[np.float32] = self.act_batch(
            shown, None if reward is None else [reward], starts
        )[0]
        return action

    def reset(self, rows: int | Sequence[str] = 1) -> None:
        """Forget everything; the next `act_batch` has these rows, all of which begin.

        Args:
            rows: how many of `self.task`, or the task of each row.
        Raises: UsageError for a task without a prompt here.
        """
        names = (self.task,) * rows if isinstance(rows, int) else tuple(rows)
        self._loop, self._names = self._new_loop(names), names

    def act_batch(
        self,
        observations: ArrayLike,
        rewards: ArrayLike | None = None,
        starts: ArrayLike | None = None,
        targets: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Actions (B, A) for observations (B, D) of B environments, as `reset` has announced them.

        Args:
            rewards: (B,) what the actions before were paid; rows that begin ignore theirs. None
                keeps the return-to-go as it is.
            starts: (B,) bool, rows whose episode begins with this observation; they forget the
                one before. None: all of them at the first call, and none later.
            targets: (B,) return asked of the rows that begin; None: `self.targets` of their tasks.
        Raises: ShapeError. Without `reset` there are as many rows of `self.task` as observations.
        """
        shown = self._shown(observations)
        if self._loop is None:
            self.reset(len(shown))
        assert self._loop is not None
        asked = self._asked(self._names) if targets is None else np.asarray(targets, np.float64)
        self._loop.ask(asked)  # of those that begin
        return _step(self._loop, shown, rewards, starts)

    def acted(self, actions: ArrayLike) -> None:
        """What (B, A) was done in place of what `act_batch` answered, as by added noise.

        A policy that is shown its previous action is shown this one.
        """
        if self._loop is None:
            raise UsageError("nobody has acted yet", where="acted", hint="act_batch comes first")
        self._loop.acted(np.asarray(actions, np.float32))

    @property
    def fingerprint(self) -> bytes:
        """32 bytes that change with anything that the actions of these tasks depend on.

        Returns asked otherwise than the policy came with do not count: they are the caller's.
        """
        return fingerprint(self._policy, self._prompts, self._returns, self._window)

    def predict(
        self,
        observation: ArrayLike,
        state: tuple[Any, ...] | None = None,
        episode_start: ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...]]:
        """Actions and the next state, with the meaning that stable-baselines3 gives them.

        Nobody tells rewards here, so the return-to-go stays at what is asked for: other numbers
        than `act`'s, which lowers it by what was earned, wherever a return-to-go is shown.

        Args:
            observation: (D,) of one environment, or (B, D).
            state: as the call before returned it; None begins. It is left as it was.
            episode_start: (B,) bool, rows whose episode begins.
            deterministic: it always is.
        """
        given = self._numbers(observation)
        shown = self._shown(given[None] if given.ndim == 1 else given)
        loop: ClosedLoop = (
            self._new_loop((self.task,) * len(shown)) if state is None else state[0].fork()
        )
        starts = None if state is None else episode_start
        if starts is not None:
            starts = np.broadcast_to(starts, (len(shown),))
        actions = _step(loop, shown, None, starts)
        return (actions[0] if given.ndim == 1 else actions), (loop,)

    def _new_loop(self, names: Sequence[str]) -> ClosedLoop:
        if not names:
            raise ShapeError("nobody acts", where="reset", expected="at least one row")
        slots = torch.tensor([self._slot(name) for name in names])
        loop = ClosedLoop(
            self._policy, self._prompts, slots, self._window, self._returns,
            self.family.action_low, self.family.action_high,
        )  # fmt: skip
        loop.reset(self._asked(names))
        return loop

    def _asked(self, names: Sequence[str]) -> Array:
        return np.array([self._targets[name] for name in names])

    def _numbers(self, observations: ArrayLike) -> NDArray[np.float32]:
        """A copy as float32. Raises: ShapeError for what is no array of numbers."""
        return _floats(observations, "an observation is an array of numbers", self.family.name,
                       f"({self.family.observation_size},)")  # fmt: skip

    def _shown(self, observations: ArrayLike) -> NDArray[np.float32]:
        """Observations as the data shows them."""
        shown = self._numbers(observations)
        if shown.ndim != 2 or shown.shape[1] != self.family.observation_size:
            raise ShapeError("observations of this family", where=self.family.name,
                             expected=f"(rows, {self.family.observation_size})",
                             found=str(shown.shape))  # fmt: skip
        shown[:, list(self.family.hidden_columns)] = 0
        return shown

    def _slot(self, task: str) -> int:
        if task not in self.tasks:
            raise unknown_name("task", task, self.tasks, where="this policy")
        return self.tasks.index(task)


def _floats(values: ArrayLike, what: str, where: str, expected: str) -> NDArray[np.float32]:
    """A copy as float32; numpy would read text as well. Raises: ShapeError."""
    try:
        found = np.asarray(values)
        is_text = found.dtype.kind in "SUmM" or any(
            isinstance(one, str | bytes) for one in (found.flat if found.dtype == object else ())
        )
        if is_text or np.iscomplexobj(found):
            raise TypeError(f"an array of {found.dtype}")
        return found.astype(np.float32)
    except (TypeError, ValueError) as error:
        raise ShapeError(what, where=where, expected=expected, found=str(error)) from error


def _step(loop: ClosedLoop, shown: Array, rewards: Any, starts: Any) -> NDArray[np.float32]:
    paid = None
    if rewards is not None:
        paid = _floats(rewards, "rewards are an array of numbers", "act", f"({len(shown)},)")
    begins = None if starts is None else np.asarray(starts, np.bool_)
    actions: NDArray[np.float32] = loop.act(shown, paid, begins)
    if not np.isfinite(actions).all():
        raise TrainingError("the policy's action is not a number", where="act",
                            found=f"row {int(np.argmin(np.isfinite(actions).all(axis=1)))}",
                            hint="look at the observations and rewards it was shown, or load "
                                 "another policy")  # fmt: skip
    return actions
