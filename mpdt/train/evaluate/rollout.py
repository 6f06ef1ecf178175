"""Closed-loop episodes on a fixed list of seeds: the only judge of a policy.

    rows = tasks x episodes, stepped as one batch (at most `max_rows` at once)

    observation, goal hidden as in the data -> controller -> clip -> env.step -> reward

Whatever can choose actions is a `Controller`; the trained policy, a constant action and a
study's own idea are judged by the same function on the same seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.data.sim.batch import BatchEnv
from mpdt.data.sim.simulators import make_batch
from mpdt.errors import TrainingError
from mpdt.model.limits import check_at_least
from mpdt.seeding import Quality, SeedKey, Stream

if TYPE_CHECKING:
    from mpdt.data.spec.tasks import Family, Task


class EvaluationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Episodes in the simulator after training."""

    episodes: int = 5
    """Episodes (= evaluation seeds) per task."""
    train_episodes: int = 0
    """The same for training tasks, of which there may be dozens; 0 = `episodes`."""
    seed: int = 0
    """Root of the evaluation seeds; apart from the training seed, so runs stay comparable."""
    horizon: int = 0
    """Steps per episode; 0 = the horizon of the data."""
    max_rows: int = 128
    """Simulators held in memory at once; a Meta-World one takes about 21 MiB."""
    blocks: tuple[Literal["train", "test"], ...] = ("train", "test")
    """Whose tasks are judged; `test` alone after another adaptation."""
    constants: bool = True
    """Run the best task-blind constant action, which the file holds, for the table."""

    def __post_init__(self) -> None:
        for name, least in (
            ("episodes", 1),
            ("train_episodes", 0),
            ("horizon", 0),
            ("max_rows", 1),
            ("seed", 0),
        ):
            check_at_least(f"evaluation.{name}", getattr(self, name), least)


Make = Callable[["Family", Sequence["Task"], Mapping[str, float | bool]], BatchEnv]


class Controller(Protocol):
    """Chooses the actions of B rows at once."""

    def begin(self, tasks: NDArray[np.int64], keys: Sequence[SeedKey]) -> None:
        """New episodes: `tasks` (B,) is each row's position in the evaluated task list.

        Whatever is random comes from the rows' `keys`, so that a row is the same in any batch.
        """
        ...

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Actions (B, A), not yet clipped, for observations (B, D) with the goal hidden."""
        ...

    def paid(self, rewards: NDArray[np.float32]) -> None:
        """The rewards (B,) of the step just taken; return-to-go inputs go down by them."""
        ...


@dataclass(frozen=True)
class Evaluation:
    """Per task and episode, in the order of the tasks and of the evaluation seeds."""

    tasks: tuple[str, ...]
    returns: NDArray[np.float64]  # (n, E) sum of rewards, the task's own unit
    lengths: NDArray[np.int64]  # (n, E) steps
    successes: NDArray[np.bool_] | None  # (n, E) any step successful; None where undefined


class SimulatorCache:
    """Keeps the last batch of simulators: building Meta-World ones takes longer than a reset."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._env: BatchEnv | None = None

    def make(
        self, family: Family, tasks: Sequence[Task], options: Mapping[str, float | bool]
    ) -> BatchEnv:
        """As `make_batch`; a reset is a function of (tasks, keys, goals), so reuse is invisible."""
        key = (family.name, *tasks, *sorted(options.items()))
        if self._env is None or key != self._key:
            self._env = None  # let the old ones go before the new ones are built
            self._key, self._env = key, make_batch(family, tasks, options)
        return self._env


class ConstantController:
    """The same action for every task at every step: knows nothing, reads nothing."""

    def __init__(self, action: NDArray[np.float32]) -> None:
        self._action, self._rows = action.astype(np.float32), 0

    def begin(self, tasks: NDArray[np.int64], keys: Sequence[SeedKey]) -> None:
        self._rows = len(tasks)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.tile(self._action, (self._rows, 1))

    def paid(self, rewards: NDArray[np.float32]) -> None:
        pass


class UniformController:
    """Uniform actions in [low, high), stream UNIFORM of each row's key, as in the data.

    Drawn step by step: the same numbers as all of an episode at once, at any horizon.
    """

    def __init__(self, action_size: int, low: float, high: float) -> None:
        self._size, self._low, self._high = action_size, low, high
        self._generators: list[np.random.Generator] = []

    def begin(self, tasks: NDArray[np.int64], keys: Sequence[SeedKey]) -> None:
        self._generators = [key.generator(Stream.UNIFORM) for key in keys]

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        draws = [g.uniform(self._low, self._high, self._size) for g in self._generators]
        return np.stack(draws).astype(np.float32)

    def paid(self, rewards: NDArray[np.float32]) -> None:
        pass


def evaluate(
    controller: Controller,
    family: Family,
    tasks: Sequence[Task],
    options: Mapping[str, float | bool],
    horizon: int,
    episodes: int,
    seed: int,
    max_rows: int = 128,
    on_progress: Callable[[int, int], None] | None = None,
    make: Make = make_batch,
    goal_key: Callable[[SeedKey], SeedKey] = lambda key: key,
) -> Evaluation:
    """Run `episodes` episodes of every task and add up the rewards.

    Args:
        options: simulator options, as in the spec of the data.
        horizon: steps after which an episode is cut.
        seed: root seed; episode e of a task has the key (family, task, EVALUATION, 0, e),
            so more episodes or other tasks change no existing one.
        on_progress: called with (steps done, steps in all) once per simulated step.
        make: builds the simulators; hand in `SimulatorCache().make` to build them once.
        goal_key: what an episode's goal is drawn from, given the episode's own key.
    Raises: TrainingError if the controller's actions are not finite numbers.
    """
    n, E = len(tasks), episodes
    returns = np.zeros((n, E))
    lengths = np.zeros((n, E), np.int64)
    successes = np.zeros((n, E), np.bool_)
    rows = [(task, e) for task in range(n) for e in range(E)]
    chunks = [rows[i : i + max_rows] for i in range(0, len(rows), max_rows)]
    has_success = family.has_success
    for number, chunk in enumerate(chunks):
        env = make(family, [tasks[task] for task, _ in chunk], options)
        keys = [
            SeedKey(seed, family.id, tasks[task].index, Quality.EVALUATION, 0, e)
            for task, e in chunk
        ]
        at = np.array(chunk).T
        controller.begin(at[0], keys)
        observations = env.reset(keys, env.draw_goals([goal_key(key) for key in keys]))
        alive = np.ones(len(chunk), np.bool_)
        for step in range(horizon):
            shown = observations.astype(np.float32)
            shown[:, list(family.hidden_columns)] = 0
            actions = np.clip(controller.act(shown), env.low, env.high).astype(np.float32)
            # Rows that have ended are stepped along and do not count, whatever they answer.
            actions[~alive] = 0
            if not np.isfinite(actions).all():
                raise TrainingError("the policy's action is not a number", where=family.name,
                                    found=f"step {step}, row {chunk[_first_bad(actions)]}",
                                    hint="training or adaptation diverged: lower --optimiser.lr"
                                    ", --adapt.lr or --few-shot.lr")  # fmt: skip
            result = env.step(actions)
            # As the data counts it: float32 rewards, summed in float64.
            rewards = result.rewards.astype(np.float32)
            returns[at[0], at[1]] += np.where(alive, rewards, np.float32(0))
            lengths[at[0], at[1]] += alive
            if result.successes is not None:
                successes[at[0], at[1]] |= result.successes & alive
            controller.paid(rewards)
            observations = result.observations
            alive &= ~result.terminations
            if on_progress:
                on_progress(number * horizon + step + 1, len(chunks) * horizon)
            if not alive.any():
                break
    names = tuple(task.name for task in tasks)
    return Evaluation(names, returns, lengths, successes if has_success else None)


def _first_bad(actions: NDArray[np.float32]) -> int:
    return int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
