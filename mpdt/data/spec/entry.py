"""DatasetSpec: what one entry of datasets.yaml asks for, typed and frozen.

A dataset is a pure function of its spec, so the canonical JSON of a spec is hashed and
stored in the file. Changing a default here changes that hash on purpose.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import msgspec

from mpdt.data.spec.behaviour import Behaviour as Behaviour
from mpdt.data.spec.behaviour import behaviour_problems
from mpdt.data.spec.behaviour import is_own_network as is_own_network
from mpdt.data.spec.behaviour import own_weights as own_weights
from mpdt.data.spec.goals import GoalSet
from mpdt.data.spec.tasks import FAMILIES, Family, Role, Task, get_family
from mpdt.errors import Lines, SpecError, UsageError, nearest

# No longer than a file takes, with what files of smoke versions and slices add to a name.
_SEMVER = re.compile(r"\d{1,9}\.\d{1,9}\.\d{1,9}(?:[-+.][0-9A-Za-z.+-]{1,80})?")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
_NAME_HINT = "letters, digits, . _ -, at most 100 of them"


MOST = {
    "horizon": 100_000, "seed": 2**63 - 1, "block": 10_000, "reference": 1_000_000,
    "rungs": 1_000, "episodes": 1_000_000,
}  # fmt: skip
"""Largest numbers of an entry; `episodes` per task, of a quality or a set."""
MOST_BLOCKS = 200_000
"""Units of work of one entry. The largest shipped one, ml45_paper, has 13,150."""


class EpisodeCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Episodes per task and quality."""

    random: int = 0
    medium: int = 0
    expert: int = 0
    history: int = 0

    def of(self, quality: str) -> int:
        """The count of one quality by name."""
        return int(getattr(self, quality))


class TtaRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A set of unlabelled random-action episodes for test-time adaptation.

    Args:
        episodes: per task.
        action_scale: range of the drawn actions as a multiple of the bounds.
        preset_return: the return asked for; `auto` = the family's fixed target.
        tasks: which tasks get such a set; tasks of role `both` always do. With a set of goals,
            `train` means the training goals and everything else the held-out ones.
        horizon: steps; None = the entry's horizon.
    """

    episodes: int
    action_scale: float = 1.0
    preset_return: float | Literal["auto"] = "auto"
    tasks: Literal["test", "train", "all"] = "test"
    horizon: int | None = None


class DatasetSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One entry of datasets.yaml.

    Args:
        version: SemVer of the data, in quotes.
        tasks: `all`, or names and indices of the family's tasks.
        test: those of them that are test tasks, the others being training tasks; None = the
            family's own split.
        goals: numbered goals per task, some held out; None = a goal of its own per episode.
        horizon: steps per episode.
        seed: root seed of every random number.
        block: episodes per unit of work; part of the identity of the data.
        tta: sets for test-time adaptation by name.
        reference: episodes per task behind a reference return that no stored quality gives.
        env: simulator options; allowed keys are the family's. What is not set keeps the simulator's
            default.
        license: SPDX id.

    Raises: SpecError listing every mistake.
    """

    name: str
    version: str
    family: str
    horizon: int
    seed: int
    block: int
    behaviour: Behaviour
    episodes: EpisodeCounts
    license: str
    tasks: Literal["all"] | tuple[str | int, ...] = "all"
    test: tuple[str | int, ...] | None = None
    goals: GoalSet | None = None
    tta: dict[str, TtaRule] = {}
    reference: int = 20
    env: dict[str, float | bool] = {}

    def __post_init__(self) -> None:
        raise_problems(find_problems(self), where=self.name)

    def resolve_tasks(self) -> tuple[Task, ...]:
        """The tasks in ascending family index; row k of the file's task table is item k."""
        family = get_family(self.family)
        chosen = set(family.tasks)
        if self.tasks != "all":
            chosen = {family.task(task) for task in self.tasks}
        if self.test is not None:
            test = {family.task(task) for task in self.test}
            roles: dict[bool, Role] = {True: "test", False: "train"}
            chosen = {replace(task, role=roles[task in test]) for task in chosen}
        return tuple(sorted(chosen, key=lambda task: task.index))

    def __reduce__(self) -> tuple[object, ...]:
        # With its family, which a worker may not know yet.
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        return _again, (FAMILIES.get(self.family), fields)


def _again(family: Family | None, fields: dict[str, Any]) -> DatasetSpec:
    return DatasetSpec(**fields)


Problem = tuple[str, str, str]
"""One mistake: key path inside the entry, what is wrong, hint."""


class SpecMistakesError(SpecError):
    """One or more mistakes, also as a list for whoever adds the file and the entry's name."""

    problems: tuple[Problem, ...] = ()


def raise_problems(problems: Sequence[Problem], where: str, separator: str = ".") -> None:
    """SpecError over all `problems`, or nothing if there are none."""
    if not problems:
        return
    places = [f"{where}{separator}{key}" if key else where for key, _, _ in problems]
    if len(problems) == 1:
        error = SpecMistakesError(problems[0][1], where=places[0], hint=problems[0][2])
    else:
        lines = [
            f"{place}: {what}" + (f"  [{hint}]" if hint else "")
            for place, (_, what, hint) in zip(places, problems, strict=True)
        ]
        error = SpecMistakesError(Lines.of(f"{len(problems)} mistakes", *lines))
    error.problems = tuple(problems)
    raise error


def find_problems(spec: DatasetSpec) -> list[Problem]:
    """Every mistake the types cannot catch, as (key path, what, hint)."""
    problems: list[Problem] = []
    if not _NAME.fullmatch(spec.name):
        problems.append(("name", f"{spec.name!r} cannot name a file", _NAME_HINT))
    if not _SEMVER.fullmatch(spec.version):
        problems.append(("version", f"{spec.version!r} is not SemVer", 'write "1.0.0", in quotes'))
    if not spec.license:
        problems.append(("license", "empty", "an SPDX id such as CC-BY-4.0"))
    for key, least in (("horizon", 1), ("seed", 0), ("block", 1), ("reference", 1)):
        problems += _range_problems(key, getattr(spec, key), least, MOST[key])
    for quality in EpisodeCounts.__struct_fields__:
        count = spec.episodes.of(quality)
        problems += _range_problems(f"episodes.{quality}", count, 0, MOST["episodes"])
    problems += _behaviour_problems(spec)
    problems += [problem for name in spec.tta for problem in _tta_problems(name, spec.tta[name])]
    try:
        family = get_family(spec.family)
    except SpecError as error:  # one's own that cannot be used
        return [*problems, ("family", error.message(), error.hint)]
    except UsageError:
        known = ", ".join(FAMILIES)
        near = nearest(spec.family, FAMILIES)
        what = f"unknown family '{spec.family}' {near}".rstrip()
        return [*problems, ("family", what, f"known: {known}")]
    problems += _family_problems(spec, family)
    if not problems and (count := _num_blocks(spec)) > MOST_BLOCKS:
        what = f"asks for {count:,} blocks of work"
        problems.append(("episodes", what, f"at most {MOST_BLOCKS:,}: fewer episodes or tasks, or "
                         "larger blocks"))  # fmt: skip
    return problems


def _range_problems(key: str, number: int, least: int, most: int) -> list[Problem]:
    if number < least:
        return [(key, f"{number} is too small", f"at least {least}")]
    return [(key, f"{number:,} is too large", f"at most {most:,}")] if number > most else []


def _num_blocks(spec: DatasetSpec) -> int:
    """At most, whichever tasks a set is for and whatever is on record."""
    counts = [spec.episodes.of(quality) for quality in EpisodeCounts.__struct_fields__]
    counts += [rule.episodes for rule in spec.tta.values()] + [spec.reference] * 3
    each = sum(-(-count // spec.block) for count in counts) + spec.behaviour.rungs
    return len(spec.resolve_tasks()) * each


def _behaviour_problems(spec: DatasetSpec) -> list[Problem]:
    rungs = _range_problems("behaviour.rungs", spec.behaviour.rungs, 2, MOST["rungs"])
    return [*behaviour_problems(spec.behaviour), *rungs]


def _tta_problems(name: str, rule: TtaRule) -> list[Problem]:
    key, problems = f"tta.{name}", list[Problem]()
    if not _NAME.fullmatch(name):
        problems.append((key, f"{name!r} cannot name a set", _NAME_HINT))
    problems += _range_problems(f"{key}.episodes", rule.episodes, 1, MOST["episodes"])
    if not (math.isfinite(rule.action_scale) and rule.action_scale > 0):
        problems.append((f"{key}.action_scale", f"{rule.action_scale} is not a range", "over 0"))
    if rule.preset_return != "auto" and not math.isfinite(rule.preset_return):
        problems.append((f"{key}.preset_return", "not finite", "a number or auto"))
    if rule.horizon is not None:
        problems += _range_problems(f"{key}.horizon", rule.horizon, 1, MOST["horizon"])
    return problems


def _family_problems(spec: DatasetSpec, family: Family) -> list[Problem]:
    problems: list[Problem] = []
    names = [task.name for task in family.tasks]
    known: set[str | int] = {*names, *range(len(names))}
    for key, tasks in (("tasks", spec.tasks), ("test", spec.test)):
        if tasks is None or tasks == "all":
            continue
        for task in tasks:
            if task not in known:
                what = f"unknown task '{task}' {nearest(str(task), names)}".rstrip()
                problems.append((key, what, f"known: {', '.join(names)}"))
        if not tasks:
            problems.append((key, "empty", "a list of names or indices, or leave it out"))
    if not problems and spec.test is not None:
        inside = set(range(len(names)))
        if spec.tasks != "all":
            inside = {family.task(task).index for task in spec.tasks}
        test = {family.task(task).index for task in spec.test}
        if not test <= inside:
            outside = ", ".join(names[index] for index in sorted(test - inside))
            problems.append(("test", f"not among the tasks: {outside}", "add them to tasks"))
        if test >= inside:
            problems.append(("test", "leaves no training task", "name fewer"))
    if spec.behaviour.script is not None and spec.behaviour.noise and family.scripted is not None:
        problems.append(("behaviour.noise", f"the scripts of {family.name} take none",
                         "leave it out"))  # fmt: skip
    if spec.goals is not None:
        if spec.goals.problem:
            problems.append(("goals", spec.goals.problem, "0 < held_out < count"))
        if not family.draws_goals:
            problems.append(("goals", f"a task of {family.name} is its goal", "leave it out"))
    allowed = family.options
    for option in sorted(set(spec.env) - allowed):
        what = f"unknown key '{option}' {nearest(option, allowed)}".rstrip()
        hint = f"allowed: {', '.join(sorted(allowed)) or 'none for ' + family.name}"
        problems.append((f"env.{option}", what, hint))
    for option, value in spec.env.items():
        if not math.isfinite(value):
            problems.append((f"env.{option}", "not finite", ""))
    # Meta-World itself truncates there, and raises on any further step.
    horizons = [("horizon", spec.horizon)]
    horizons += [(f"tta.{name}.horizon", rule.horizon or 1) for name, rule in spec.tta.items()]
    for key, steps in horizons:
        if 0 < family.most_steps < steps:
            hint = f"at most {family.most_steps} in {family.name}"
            problems.append((key, f"{steps} steps are too many", hint))
    return problems


def canonical_json(value: Any) -> bytes:
    """One byte form per value: sorted keys, no spaces, UTF-8.

    Raises: ValueError for NaN or infinity (write an open bound as None).
    """
    plain = msgspec.to_builtins(value)
    text = json.dumps(
        plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode("utf-8")


def spec_hash(spec: DatasetSpec | Mapping[str, Any]) -> str:
    """SHA-256 of the spec's canonical JSON, 64 hex digits. Raises: as `canonical_json`."""
    return hashlib.sha256(canonical_json(spec)).hexdigest()
