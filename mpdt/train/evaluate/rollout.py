"""Closed-loop episodes on a fixed list of seeds: the only judge of a policy.

    rows = tasks x episodes, stepped as one batch (at most `max_rows` at once)

    observation, goal hidden as in the data -> actor -> clip -> env.step -> reward

Whatever can choose actions is an `Actor` (mpdt/data/sim/actors.py); the trained policy, a constant
action and a study's own idea are judged by the same function on the same seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import UNKNOWN_PROGRESS, Episode
from mpdt.data.sim.actors import Actor, Rows
from mpdt.data.sim.batch import BatchEnv, roll_out
from mpdt.data.sim.play import Record
from mpdt.data.sim.simulators import make_batch
from mpdt.errors import TrainingError, UsageError, check_at_least
from mpdt.seeding import Quality, SeedKey

if TYPE_CHECKING:
    from mpdt.data.spec.tasks import Family, Task


class EvaluationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Episodes in the simulator after training."""

    episodes: int = 5
    """Episodes (= evaluation seeds) per task. Where goals are held out (mt10, mt50: five of a task)
    they are taken in turn, and more episodes repeat them."""
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
        if not self.blocks:
            raise UsageError("at least one is needed", where="evaluation.blocks",
                             expected="train, test or both")  # fmt: skip


Make = Callable[["Family", Sequence["Task"], Mapping[str, float | bool]], BatchEnv]


@dataclass(frozen=True)
class Evaluation:
    """Per task and episode, in the order of the tasks and of the evaluation seeds."""

    tasks: tuple[str, ...]
    returns: NDArray[np.float64]  # (n, E) sum of rewards, the task's own unit
    lengths: NDArray[np.int64]  # (n, E) steps
    successes: NDArray[np.bool_] | None  # (n, E) any step successful; None where undefined


@dataclass
class Kept:
    """Episodes of an evaluation as data would hold them.

    Args:
        policy: hash of who acts.
    """

    policy: bytes
    episodes: list[Episode] = field(default_factory=list)


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


def evaluate(
    actor: Actor,
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
    kept: Kept | None = None,
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
        kept: gains every episode, task by task; their returns are those of the result.
    Raises: TrainingError if the actor's actions are not finite numbers.
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
        actor.begin(Rows(keys, horizon=horizon, tasks=at[0]))  # its goal is what it has to find
        goals = env.draw_goals([goal_key(key) for key in keys])
        first = env.reset(keys, goals)
        record = kept and Record.of(first, env.action_size, horizon, family.hidden_columns)
        choose = partial(_choose, actor, env, family, chunk)
        for rolled in roll_out(env, first, choose, horizon):
            running, result = rolled.running, rolled.result
            # As the data counts it: float32 rewards, summed in float64.
            rewards = result.rewards.astype(np.float32)
            returns[at[0], at[1]] += np.where(running, rewards, np.float32(0))
            lengths[at[0], at[1]] += running
            if result.successes is not None:
                successes[at[0], at[1]] |= result.successes & running
            if record:
                record.add(rolled)
            if on_progress:
                on_progress(number * horizon + rolled.step + 1, len(chunks) * horizon)
        if kept and record:
            kept.episodes += [
                record.episode(row, key, goals[row], kept.policy, Quality.POLICY, UNKNOWN_PROGRESS)
                for row, key in enumerate(keys)
            ]
    names = tuple(task.name for task in tasks)
    return Evaluation(names, returns, lengths, successes if has_success else None)


def _choose(
    actor: Actor,
    env: BatchEnv,
    family: Family,
    rows: Sequence[tuple[int, int]],
    step: int,
    observations: NDArray[np.float64],
    rewards: NDArray[np.float64] | None,
    running: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """What the actor answers, as the simulator takes it."""
    shown = observations.astype(np.float32)
    shown[:, list(family.hidden_columns)] = 0
    paid = None if rewards is None else rewards.astype(np.float32)
    actions = np.clip(actor.act(step, shown, paid), env.low, env.high).astype(np.float32)
    # Rows that have ended are stepped along and do not count, whatever they answer.
    actions[~running] = 0
    if not np.isfinite(actions).all():
        raise TrainingError("the policy's action is not a number", where=family.name,
                            found=f"step {step}, row {rows[_first_bad(actions)]}",
                            hint="training or adaptation diverged: lower --optimiser.lr"
                            ", --adapt.lr or --few-shot.lr")  # fmt: skip
    return actions


def _first_bad(actions: NDArray[np.float32]) -> int:
    return int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
