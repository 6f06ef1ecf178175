"""MetaworldBatch: Meta-World tasks, one published env per task, with our own goal draw.

The benchmark classes seed through numpy's global generator and reset every env 50 times, so
they are not used. `reset(seed=)` of the envs is ignored (Farama-Foundation/Metaworld#555);
with the reset vector frozen an episode is a function of (vector, actions) and nothing else.

    draw    seeded mode, `env.seed(n)`, let the env accept a vector, read it back
    reset   freeze that vector, `env.reset()`: every reset is then the same start
    step    `env.step(action)` with the float32 action as it is stored; of all rows of a task at
            once in `lockstep/`, which returns the same bytes

An env takes 0.11-0.17 s and about 21 MiB; envs are built at their task's first use and kept.

Used by simulators.py, gym.py, scripts.py and scripted.py.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mpdt.data.sim.batch import BoolArray, FloatArray, StepResult
from mpdt.data.sim.contacts import FingerContacts
from mpdt.data.sim.lockstep.rows import TaskRows
from mpdt.data.sim.sawyer import quick_class
from mpdt.data.sim.scripts import ACTION_SIZE
from mpdt.errors import ShapeError, SimulatorError, UsageError, unknown_name
from mpdt.seeding import SeedKey, Stream

if TYPE_CHECKING:
    from mpdt.data.spec.tasks import Family, Task

OBSERVATION_SIZE = 39  # 18 now, 18 one step earlier, goal 3
GOAL_COLUMNS = slice(36, 39)
MAX_STEPS = 500  # the envs refuse a further step


@contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings of metaworld and gymnasium, here only.

    They tell of rounded Box bounds and of scripts that answer outside [-1, 1]; both are
    known and handled, and they would repeat at every step.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def find_class(task_name: str, kind: str) -> type[Any]:
    """Meta-World's own class for a task name without "-v3"; `kind` is "env" or "script".

    Raises: UsageError for an unknown task, SimulatorError if metaworld does not import.
    """
    try:
        # Imported here: it takes a second, which commands that simulate nothing save.
        with quiet():
            if kind == "env":
                from metaworld.env_dict import ENV_CLS_MAP as CLASSES
            else:
                from metaworld.policies import ENV_POLICY_MAP as CLASSES
    except ImportError as error:
        raise SimulatorError(
            "Meta-World does not import",
            where=task_name,
            found=str(error),
            hint="pip install metaworld==3.1.1 mujoco==3.3.0, in a fresh environment",
        ) from error
    found: type[Any] | None = CLASSES.get(f"{task_name}-v3")
    if found is None:
        raise unknown_name(
            "Meta-World task", task_name, (name.removesuffix("-v3") for name in CLASSES)
        )
    return found


def check_running(num_steps: int, task_name: str) -> None:
    """Raises: UsageError for a step before a reset, or after the last one."""
    if num_steps >= MAX_STEPS:
        raise UsageError(
            "a Meta-World episode is over",
            where=task_name,
            expected=f"reset(), then at most {MAX_STEPS} steps",
            hint=f"lower the horizon to {MAX_STEPS} or less",
        )


class MetaworldEnv:
    """One env of one task, the goal visible, driven by explicit reset vectors.

    `quick=False` steps the class as it is published: same bytes, slower.
    """

    def __init__(self, task_name: str, *, quick: bool = True) -> None:
        self.task_name = task_name
        published = find_class(task_name, "env")
        with quiet():
            env = (quick_class(published) if quick else published)()
        # As `set_task` does it, without its pickles: show the goal and rebuild the cached
        # space, whose goal bounds are zero while the goal is hidden.
        env._partially_observable = False
        del env.sawyer_observation_space
        env._set_task_called = True
        if quick:
            env.touching_object = FingerContacts(env)
        self._env = env
        self._num_steps = 0

    @property
    def inner(self) -> Any:
        """The env itself, for rows that share its simulator."""
        return self._env

    @property
    def scene(self) -> tuple[Any, Any]:
        """MuJoCo's own (MjModel, MjData), for a camera; look, do not touch."""
        return self._env.model, self._env.data

    def draw(self, seed: int) -> FloatArray:
        """Reset vector (G,) that the env itself accepts when it is seeded with `seed`.

        21 of the 50 tasks draw again while object and goal are too close, so a vector made
        up from the bounds alone could be refused, and once frozen would loop for ever.
        """
        env = self._env

        def stay(steps: int = 50) -> None:
            env.init_tcp = env.tcp_center

        env._freeze_rand_vec, env.seeded_rand_vec = False, True
        env.seed(seed)
        # Acceptance looks at the vector alone; moving the hand home first costs 95 % of a
        # reset and changes no draw (the slow twin in the tests moves it).
        env._reset_hand = stay
        try:
            with quiet():
                env.reset_model()
        finally:
            del env._reset_hand
            env._freeze_rand_vec, env.seeded_rand_vec = True, False
        self._num_steps = MAX_STEPS  # drawing resets half of the env: refuse steps until `reset`
        return np.array(env._last_rand_vec, dtype=np.float64)

    def reset(self, goal: FloatArray) -> FloatArray:
        """First observation (39,) of the episode that starts from reset vector `goal`."""
        space = self._env._random_reset_space
        low, high = space.low, space.high
        if goal.shape != low.shape or not ((goal >= low) & (goal <= high)).all():
            raise UsageError(
                "reset vector outside the task's reset space",
                where=self.task_name,
                expected=f"{low.size} numbers from {low.tolist()} to {high.tolist()}",
                found=str(goal.tolist()),
                hint="let the env draw it: MetaworldEnv.draw(seed)",
            )
        vector = goal.astype(np.float64)  # a copy: envs hand out views of it
        asked = 0

        def frozen() -> FloatArray:
            nonlocal asked
            asked += 1
            if asked > 2:  # once per model reset, of which a reset has two
                raise UsageError(
                    "the env refuses this reset vector (object and goal too close)",
                    where=self.task_name,
                    found=str(goal.tolist()),
                    hint="let the env draw it: MetaworldEnv.draw(seed)",
                )
            return vector

        # Meta-World's own frozen mode would ask for a refused vector without end.
        self._env._get_state_rand_vec = frozen
        try:
            with quiet():
                observation, _ = self._env.reset()
        finally:
            del self._env._get_state_rand_vec
        self._num_steps = 0
        return np.array(observation, dtype=np.float64)

    def step(self, action: npt.NDArray[np.float32]) -> tuple[FloatArray, float, bool]:
        """(observation (39,), reward 0 to 10, success) after `action` (4,) float32.

        The env gets the float32 array itself, so that `env.step(stored_action)` of the plain
        package repeats an episode bit for bit; a cast to float64 would round its products
        otherwise. The env clips to [-1, 1] inside.
        """
        check_running(self._num_steps, self.task_name)
        observation, reward, _, _, info = self._env.step(action)
        self._num_steps += 1
        return observation, float(reward), bool(info["success"])


@lru_cache(maxsize=1)
def _kept_env(task_name: str) -> MetaworldEnv:
    """The env of a task; that of the last one is kept for the next batch.

    Building one takes longer than a short block. Batches may share one: their rows are put into
    its simulator whenever they are stepped.
    """
    return MetaworldEnv(task_name)


def batch_of(
    family: Family, tasks: Sequence[Task], options: Mapping[str, float | bool]
) -> MetaworldBatch:
    """As `make_batch` asks for it: Meta-World is stepped as published, without options."""
    return MetaworldBatch(tasks)


class MetaworldBatch:
    """BatchEnv over Meta-World: row i is an episode of `tasks[i]`, tasks may differ by row.

    Rewards are 0 to 10 per step, nothing terminates, success is reported per step. The rows of a
    task share one env and are stepped in lockstep.
    """

    observation_size = OBSERVATION_SIZE
    action_size = ACTION_SIZE

    def __init__(self, tasks: Sequence[Task]) -> None:
        self.task_names = tuple(task.name for task in tasks)
        self.num_rows = len(self.task_names)
        self.low = np.full(ACTION_SIZE, -1.0)
        self.high = np.full(ACTION_SIZE, 1.0)
        names = np.array(self.task_names)
        self._rows = {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}
        self._envs: dict[str, MetaworldEnv] = {}
        self._groups: dict[str, TaskRows] = {}
        self._num_steps = MAX_STEPS

    def _env(self, name: str) -> MetaworldEnv:
        if name not in self._envs:
            self._envs[name] = _kept_env(name)
        return self._envs[name]

    def _group(self, name: str) -> TaskRows:
        if name not in self._groups:
            env, rows = self._env(name), len(self._rows[name])
            self._groups[name] = TaskRows(name, env.inner, env.reset, rows)
        return self._groups[name]

    def scene(self, row: int) -> tuple[Any, Any]:
        """MuJoCo's own (MjModel, MjData) of a row."""
        name = self.task_names[row]
        if name in self._groups:
            self._groups[name].show(int(np.searchsorted(self._rows[name], row)))
        return self._env(name).scene

    def draw_goals(self, keys: Sequence[SeedKey]) -> list[FloatArray]:
        """One accepted reset vector (3,) or (6,) per row, from stream GOAL of its key.

        Ends the episodes in progress: the envs must be reset before they are stepped.
        """
        self._expect(len(keys), "keys")
        self._num_steps = MAX_STEPS
        return [
            self._env(name).draw(key.env_seed(Stream.GOAL))
            for name, key in zip(self.task_names, keys, strict=True)
        ]

    def reset(self, keys: Sequence[SeedKey], goals: Sequence[FloatArray]) -> FloatArray:
        """First observations (B, 39). `keys` add nothing: with a goal set nothing is random."""
        self._expect(len(keys), "keys")
        self._expect(len(goals), "goals")
        first = np.zeros((self.num_rows, OBSERVATION_SIZE))
        for name, rows in self._rows.items():
            first[rows] = self._group(name).reset([goals[row] for row in rows.tolist()])
        self._num_steps = 0
        return first

    def step(self, actions: npt.NDArray[np.float32]) -> StepResult:
        """One step of every row with exactly these float32 actions (B, 4)."""
        if actions.shape != (self.num_rows, ACTION_SIZE) or actions.dtype != np.float32:
            raise ShapeError(
                "actions do not fit the batch",
                expected=f"({self.num_rows}, {ACTION_SIZE}) float32",
                found=f"{actions.shape} {actions.dtype}",
            )
        check_running(self._num_steps, self.task_names[0])
        self._num_steps += 1
        never: BoolArray = np.zeros(self.num_rows, dtype=np.bool_)
        observations = np.zeros((self.num_rows, OBSERVATION_SIZE))
        rewards, successes = np.zeros(self.num_rows), never.copy()
        for name, rows in self._rows.items():
            found = self._groups[name].step(actions[rows])
            observations[rows], rewards[rows], successes[rows] = found
        return StepResult(observations, rewards, never, successes)

    def _expect(self, found: int, what: str) -> None:
        if found != self.num_rows:
            raise ShapeError(
                f"wrong number of {what}", expected=f"{self.num_rows} rows", found=str(found)
            )
