"""What the contract of a family allows, looked at before a family is believed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from mpdt.data.spec.family import Family, Task
from mpdt.data.spec.training import settings_problems

# As names of entries: parts of a collection and sets of an export are files of these names.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
COLUMN = re.compile(r"[^\[\]]{1,80} \[[^\[\]]{1,40}\]")
_SEMVER = re.compile(r"\d{1,9}\.\d{1,9}\.\d{1,9}")
MOST_TASKS = 10_000
MOSTCOLUMNS = 4_096
MOST_STEPS = 100_000


def family_problems(family: Family) -> list[str]:
    """What is wrong with it, one line each; nothing for one that keeps the contract."""
    if problem := family_name_problem(family.name):
        return [problem]
    return [*plain_problems(family), *_hooks(family)]


def family_name_problem(name: object) -> str:
    """Why it cannot name a family; empty where it can."""
    if isinstance(name, str) and _NAME.fullmatch(name):
        return ""
    return f"name {name!r}: letters, digits, . _ -, at most 100 of them"


def plain_problems(family: Family) -> list[str]:
    """What is wrong with its data, whoever simulates."""
    return [*_tasks(family), *_columns(family), *_numbers(family)]


def _tasks(family: Family) -> Iterator[str]:
    tasks = family.tasks
    if not isinstance(tasks, tuple) or not all(isinstance(task, Task) for task in tasks):
        yield "tasks: a tuple of mpdt.Task"
        return
    if not 1 <= len(tasks) <= MOST_TASKS:
        yield f"tasks: 1 to {MOST_TASKS:,}, found {len(tasks):,}"
        return
    names = [task.name for task in tasks]
    for place, task in enumerate(tasks):
        if not isinstance(task.name, str) or not _NAME.fullmatch(task.name):
            yield f"tasks: {task.name!r} cannot name a task: letters, digits, . _ -"
        elif names.count(task.name) > 1:
            yield f"tasks: two of the name '{task.name}'"
        if task.index != place:
            yield f"tasks: '{task.name}' has index {task.index!r} at position {place}"
        if task.role not in ("train", "test", "both"):
            yield f"tasks: '{task.name}' has role {task.role!r}: train, test or both"
        if not isinstance(task.goal, tuple) or not all(_finite(number) for number in task.goal):
            yield f"tasks: the goal of '{task.name}' is no tuple of finite numbers"
    if len({len(task.goal) for task in tasks if isinstance(task.goal, tuple)}) > 1:
        yield "tasks: goals of different lengths"
    if not any(task.role in ("train", "both") for task in tasks):
        yield "tasks: none to train on"


def _columns(family: Family) -> Iterator[str]:
    columns = family.columns
    if not isinstance(columns, tuple) or not 1 <= len(columns) <= MOSTCOLUMNS:
        yield f"columns: a tuple of 1 to {MOSTCOLUMNS:,} texts `name [unit]`"
        return
    for column in columns:
        if not isinstance(column, str) or not COLUMN.fullmatch(column):
            yield f"columns: {column!r} is not `name [unit]`; a number without dimension has [1]"
    if len(set(columns)) != len(columns):
        yield "columns: two of one name"
    hidden = family.hidden_columns
    if not isinstance(hidden, tuple) or not all(
        type(column) is int and 0 <= column < len(columns) for column in hidden
    ):
        yield f"hidden_columns: a tuple of positions from 0 to {len(columns) - 1}"


def _numbers(family: Family) -> Iterator[str]:
    for key, most in (("action_size", MOSTCOLUMNS), ("horizon", MOST_STEPS)):
        number = getattr(family, key)
        if type(number) is not int or not 1 <= number <= most:
            yield f"{key}: a whole number from 1 to {most:,}, found {number!r}"
    for key in ("action_low", "action_high", "step_s", "return_target", "return_scale",
                "steps_per_s"):  # fmt: skip
        if not _finite(getattr(family, key)):
            yield f"{key}: a finite number, found {getattr(family, key)!r}"
    for key in ("step_s", "return_scale", "steps_per_s"):
        if _finite(getattr(family, key)) and getattr(family, key) <= 0:
            yield f"{key}: above 0, found {getattr(family, key)!r}"
    low, high = family.action_low, family.action_high
    if _finite(low) and _finite(high) and low >= high:
        yield f"action_low: below action_high, found {low!r} and {high!r}"
    if type(family.policy_rows) is not int or family.policy_rows < 1:
        yield f"policy_rows: 1 or more, found {family.policy_rows!r}"
    if not isinstance(family.version, str) or not _SEMVER.fullmatch(family.version):
        yield f'version: SemVer such as "1.0.0", found {family.version!r}'


def _hooks(family: Family) -> Iterator[str]:
    given = [key for key in ("env", "vector", "batch") if getattr(family, key) is not None]
    if len(given) != 1:
        yield f"env, vector, batch: exactly one of them, found {', '.join(given) or 'none'}"
    places = [
        (key, getattr(family, key)) for key in (*given, "inputs", "scripted", "single", "one_step")
    ]
    places += [(f"script {name}", hook) for name, hook in family.scripts.items()]
    for key, hook in places:
        is_words = isinstance(hook, str) and all(hook.partition(":"))
        if hook is not None and not is_words and (isinstance(hook, str) or not callable(hook)):
            yield f"{key}: a function or `module:name`, found {hook!r}"
    yield from settings_problems(family.pretrain)
    if not isinstance(family.options, frozenset) or not all(
        isinstance(option, str) and option.isidentifier() for option in family.options
    ):
        yield "options: a frozenset of names"
    for name in family.scripts:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            yield f"scripts: {name!r} cannot name a script"


def _finite(number: object) -> bool:
    return isinstance(number, int | float) and type(number) is not bool and math.isfinite(number)
