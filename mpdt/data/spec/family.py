"""The contract of a family: what it says of itself, and everything else follows.

    tasks, columns, bounds, horizon, returns     plain data; a file keeps a copy of it
    env, vector or batch                         who simulates, one of the three
    scripts, inputs                              who acts

The seven that mpdt ships (`tasks.py`) and a user's own (`own.py`) are made of the same parts, and
nothing outside a family's own modules asks which one it is. A function is given as it is or named
as text `module:name`, so that a command imports the simulator it uses and no other.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

from mpdt.data.spec.recorded import Recorded
from mpdt.errors import SimulatorError, unknown_name

Role = Literal["train", "test", "both"]
Hook = str | Callable[..., Any] | None
"""A function, or where it is: `module:name`."""

OWN_IDS = 2**31
"""Seed keys of one's own families begin here: below are those that mpdt ships."""


@dataclass(frozen=True)
class Task:
    """One task of a family.

    Args:
        index: position in the family's fixed list; the seed key's second number.
        role: `both` = the test tasks are the training tasks.
        goal: goal or parameters of the task, such as a direction, a speed in m/s or an angle in
            rad; stored with every episode. Empty where a goal is drawn per episode.
    """

    name: str
    index: int
    role: Role
    goal: tuple[float, ...] = ()


@dataclass(frozen=True)
class View:
    """From where a camera looks at a MuJoCo scene.

    Args:
        azimuth: degrees.
        elevation: degrees.
        distance: m.
        at: m, the point it looks at; None = the body `torso`, which it follows.
        floor: geom whose picture is made ten times as large, where actors run past its end.
    """

    azimuth: float
    elevation: float
    distance: float
    at: tuple[float, float, float] | None = None
    floor: str = ""


@dataclass(frozen=True, kw_only=True)
class Family:
    """Tasks that share simulator and spaces.

    Args:
        name: of the family; what it is called in datasets.yaml and in files.
        tasks: in a fixed order: append, never reorder.
        columns: `name [unit]` of every observation column; unit `1` has no dimension.
        action_low: of every action component, in the env's own unit.
        action_high: likewise.
        horizon: steps after which an episode is truncated.
        step_s: seconds of simulated time per step.
        return_target: the fixed return asked for at test time, of a full-length episode, in summed
            reward. Never computed from test data.
        return_scale: its divisor.
        env: `env(task, **options)` -> gymnasium.Env of one task.
        vector: `vector(tasks, **options)` -> gymnasium VectorEnv, one row per task.
        batch: `batch(family, tasks, options)` -> `BatchEnv` of `sim/batch.py`, the quickest.
        scripts: experts by name, what an entry calls `behaviour: {script: NAME}`:
            `act(observations (B, D), goals (B, G))` -> actions (B, A).
        inputs: `inputs(observations, goals)` -> (B, I), what a behaviour network sees; default:
            both side by side.
        options: simulator options that an entry may set under `env`.
        version: SemVer; raise it with every change that alters an observation, a reward or what a
            script answers. It is part of who acted, and with that of the data.
        exact: the same seed gives the same bytes. Where not, nothing is said of hashes and
            nothing is replayed.
        about: one clause for the data card: what the tasks are.
        goal_hidden: stored observations do not contain the goal.
        hidden_columns: observation columns that are stored as 0; behaviour sees them.
        has_success: the simulator reports success per step, a gymnasium one in `info["success"]`.
        draws_goals: a goal is drawn per episode; else a task is its goal.
        ends_early: an episode may end before the horizon.
        most_steps: what the simulator allows per episode; 0 = any number.
        packages: those beside numpy and gymnasium whose version may change a number.
        scene: what a return depends on beside goal, horizon and options; default NAME/VERSION.
        measured_in: the family that references and mixing rates are measured in, where several
            share their tasks; default: itself.
        rates: name of the files with the mixing rates of `medium`; default NAME.
        scripted: `scripted(family, script, task, rate, rung, level)` -> the policy of a script
            mixed with uniform actions; default: one made of `scripts`.
        single: `single(family, task, **kwargs)` -> the gymnasium.Env of a family that is stepped
            in another way; it keeps horizon and hidden columns itself.
        one_step: `one_step(family, observations, actions, goals, options)` -> next observations
            (N, D) and rewards (N,), where an observation (N, D) tells the simulator's state; nan in
            columns that it does not tell. Shows whether imported data are of this simulator.
        pretrain: how its behaviour network is trained, where not as `training.py` has it:
            `algorithm`, ppo or sac, and settings of it; `mpdt-data pretrain NAME` reads it.
        steps_per_s: of one worker, for estimates only.
        policy_rows: rows at which a trained policy is evaluated when its episodes are collected.
        bundle_rows: rows up to which short blocks are stepped side by side; 0 = block by block.
        view: where its camera stands; None = nothing can be filmed.
        id: the seed key's first number; own families get one from their name.
        module: where an own family is from, `module:name`; empty for those that mpdt ships.
    """

    name: str
    tasks: tuple[Task, ...]
    columns: tuple[str, ...]
    action_size: int
    action_low: float = -1.0
    action_high: float = 1.0
    horizon: int
    step_s: float
    return_target: float
    return_scale: float
    env: Hook = None
    vector: Hook = None
    batch: Hook = None
    scripts: Mapping[str, Hook] = field(default_factory=dict, hash=False)
    inputs: Hook = None
    options: frozenset[str] = frozenset()
    version: str = "1.0.0"
    exact: bool = True
    about: str = ""
    goal_hidden: bool = True
    hidden_columns: tuple[int, ...] = ()
    has_success: bool = False
    draws_goals: bool = False
    ends_early: bool = True
    most_steps: int = 0
    packages: tuple[str, ...] = ()
    scene: str = ""
    measured_in: str = ""
    rates: str = ""
    scripted: Hook = None
    single: Hook = None
    one_step: Hook = None
    pretrain: Mapping[str, float | str] = field(default_factory=dict, hash=False)
    steps_per_s: float = 5_000.0
    policy_rows: int = 25
    bundle_rows: int = 0
    view: View | None = None
    id: int = -1
    module: str = ""

    def __post_init__(self) -> None:
        if self.id < 0:
            word = hashlib.sha256(str(self.name).encode()).digest()[:4]
            # One below 2**32 - 1, which stands for unknown in a seed key.
            number = OWN_IDS + int.from_bytes(word, "big") % (OWN_IDS - 1)
            object.__setattr__(self, "id", number)

    @property
    def observation_size(self) -> int:
        return len(self.columns)

    @property
    def simulates(self) -> bool:
        """Whether its simulator is here; not where a file alone tells of the family."""
        if isinstance(self.env, Recorded):
            return not self.env.missing()
        return not (self.env is None and self.vector is None and self.batch is None)

    def task(self, name_or_index: str | int) -> Task:
        """The task of that name or position.

        Raises: UsageError naming the nearest task.
        """
        for task in self.tasks:
            if name_or_index in (task.name, task.index):
                return task
        known = [task.name for task in self.tasks]
        raise unknown_name("task", str(name_or_index), known, where=self.name)

    def scene_of(self, task: Task) -> str:
        """What the return of a task depends on beside horizon and options."""
        if not self.scene:
            return f"{self.name}/{self.version}/{task.name}"
        return f"{self.scene}/{'/'.join(map(repr, task.goal)) or task.name}"

    def __reduce__(self) -> tuple[Any, ...]:
        # A worker gets the family by its name and place: functions may be no pickles.
        from mpdt.data.spec.own import family_again, folder_of, is_known

        if is_known(self):
            return family_again, (self.name, self.module, folder_of(self))
        return _unpickled, ({name: getattr(self, name) for name in self.__dataclass_fields__},)


def _unpickled(fields: dict[str, Any]) -> Family:
    return Family(**fields)


def resolve(hook: Hook) -> Callable[..., Any]:
    """The function behind a hook. Raises: whatever its module raises; AttributeError."""
    if isinstance(hook, str):
        module, _, name = hook.partition(":")
        found: Callable[..., Any] = getattr(import_module(module), name)
        return found
    assert hook is not None
    return hook


def view_of(family: Family) -> View:
    """Where the camera of a family stands. Raises: SimulatorError."""
    if family.view is None:
        raise SimulatorError("no picture: this family does not say where its camera stands",
                             where=family.name, hint="give it a view: mpdt.View(azimuth, "
                             "elevation, distance)")  # fmt: skip
    return family.view


PLAIN = ("name", "version", "columns", "action_size", "action_low", "action_high", "horizon",
         "step_s", "return_target", "return_scale", "exact", "about", "goal_hidden",
         "hidden_columns", "has_success", "ends_early", "draws_goals", "most_steps", "packages",
         "module")  # fmt: skip
"""What of a family is data."""


def definition(family: Family) -> dict[str, Any]:
    """A family as JSON values, for the files of its episodes; `fingerprint` is over the rest."""
    plain: dict[str, Any] = {key: getattr(family, key) for key in PLAIN}
    plain["options"] = sorted(family.options)
    plain["tasks"] = [
        {"name": task.name, "index": task.index, "role": task.role, "goal": list(task.goal)}
        for task in family.tasks
    ]
    if isinstance(family.env, Recorded):
        plain["environments"] = family.env.plain()
    text = json.dumps({**plain, "module": ""}, sort_keys=True, allow_nan=False)
    plain["fingerprint"] = hashlib.sha256(text.encode()).hexdigest()
    found: dict[str, Any] = json.loads(json.dumps(plain))  # lists, as a file gives them back
    return found


def decisive(told: Mapping[str, Any]) -> dict[str, Any]:
    """What of a definition makes other data, as lines that can be compared; empty for none."""
    found = {k: v for k, v in told.items() if k not in ("module", "fingerprint", "about", "tasks")}
    for task in told.get("tasks", ()):
        goal = json.dumps(task["goal"])
        if len(task["goal"]) > 4:
            goal = hashlib.sha256(goal.encode()).hexdigest()[:12]
        found[f"task {task['index']}"] = f"{task['name']} {task['role']} {goal}"
    return found


def own_definition(family: Family) -> dict[str, Any]:
    """`definition` of one's own family; nothing of those that mpdt ships, which it knows."""
    return definition(family) if family.module or family.id >= OWN_IDS else {}


def stored_family(plain: Mapping[str, Any]) -> Family:
    """The family that a file tells of: without a simulator, or, where an import was asked for it,
    with the environment that its data name.

    Raises: ValueError for what `definition` does not write.
    """
    said = dict(plain)
    try:
        tasks = tuple(
            Task(task["name"], task["index"], task["role"], tuple(task["goal"]))
            for task in said["tasks"]
        )
        fields = {key: said[key] for key in PLAIN}
        for key in ("columns", "hidden_columns", "packages"):
            fields[key] = tuple(fields[key])
        if "environments" in said:
            fields["env"] = Recorded.of(said["environments"])
            if {name for name, _, _ in fields["env"].environments} != {one.name for one in tasks}:
                raise ValueError("environments of other tasks than the family's")
        return Family(tasks=tasks, options=frozenset(said["options"]), **fields)
    except (KeyError, TypeError) as error:
        raise ValueError(f"no definition of a family: {error}") from error
