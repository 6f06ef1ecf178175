"""One's own families: where they come from, and what is refused before they are believed.

    mpdt.register_family(family)                              a program
    [project.entry-points."mpdt.families"] name = "module:family"    an installed package
    families: {name: {module: "module:family"}}               datasets.yaml, modules beside it

A name is looked for in this order. What a data file says is never imported: its family's name
chooses among what the user declared, and that is all it does.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from mpdt.data.spec import tasks as known
from mpdt.data.spec.family import Family, stored_family
from mpdt.data.spec.named import import_named
from mpdt.data.spec.rules import family_problems
from mpdt.data.spec.training import settings_over, settings_problems
from mpdt.data.spec.yamltext import load_yaml
from mpdt.errors import DataError, Lines, MpdtError, SpecError, UsageError, nearest

GROUP = "mpdt.families"
FILE_NAME = "datasets.yaml"
KEYS = ("module", "scripts", "pretrain")

_FOLDERS: dict[str, str] = {}
"""By family: the folder that its module was found in; empty where it is installed."""


def register_family(family: Family) -> Family:
    """Make a family known to this process, and to the workers that it starts.

    Args:
        family: of a name that nobody has. The module that calls this is imported again in workers.
    Returns: the family as it is known, with the module it is from.
    Raises: SpecError for a family that does not keep the contract, or a name that is taken.
    """
    frame = inspect.currentframe()
    caller = frame.f_back.f_globals.get("__name__", "") if frame and frame.f_back else ""
    return _add(family, caller, "")


def is_known(family: Family) -> bool:
    """Whether it is the registered one of its name, not a variant of it."""
    return known.FAMILIES.get(family.name) is family


def family_again(name: str, module: str, folder: str) -> Family:
    """A registered family in another process. Raises: as `load_family`."""
    if name in known.FAMILIES:
        return known.FAMILIES[name]
    if ":" not in module:  # registered by a program: importing it does so again
        import_named(f"{module}:__name__", Path(folder or "."))
        if name in known.FAMILIES:
            return known.FAMILIES[name]
        raise SpecError("the family is not registered when its module is imported", where=module,
                        expected=f"mpdt.register_family of '{name}' outside of any function",
                        hint="a worker has nothing else to know it from")  # fmt: skip
    return load_family(name, {"module": module}, folder)


def folder_of(family: Family) -> str:
    """Where its module was found; empty for an installed one."""
    return _FOLDERS.get(family.name, "")


def load_family(name: str, entry: Mapping[str, Any], folder: str) -> Family:
    """The family of an entry under `families`, registered.

    Args:
        entry: `module`, and `scripts` by name, all `module:name`; settings of `pretrain`.
        folder: looked into before installed packages; empty = only there.
    Raises: SpecError for a module that does not import or has no such family.
    """
    words = entry["module"]
    already = known.FAMILIES.get(name)
    if already and (already.module, folder_of(already)) == (words, folder):
        return already
    try:
        found = import_named(words, Path(folder) if folder else None)
        if not isinstance(found, Family) and callable(found):
            found = found()
    except UsageError as error:
        raise SpecError(error.what, where=error.where, hint=error.hint) from error
    except MpdtError:
        raise
    except (Exception, SystemExit) as error:
        raise SpecError(f"it raised {type(error).__name__}: {error}"[:200], where=words) from error
    if not isinstance(found, Family):
        raise SpecError("no family", where=words, expected="a mpdt.Family, or a function of "
                        "nothing that gives one", found=type(found).__name__)  # fmt: skip
    scripts = dict(found.scripts) | dict(entry.get("scripts", {}))
    training = settings_over(found.pretrain, entry.get("pretrain", {}))
    return _add(replace(found, name=name, scripts=scripts, pretrain=training), words, folder)


def _add(family: Family, module: str, folder: str) -> Family:
    there = known.FAMILIES.get(family.name) if isinstance(family.name, str) else None
    if family.name in known.SHIPPED:
        raise SpecError("mpdt has a family of that name", where=family.name,
                        hint="choose another name")  # fmt: skip
    if there is not None and (there.module, folder_of(there)) != (module, folder):
        raise SpecError("two families of one name", where=family.name, expected="one of them",
                        found=f"{there.module} and {module}",
                        hint="give one of them another name")  # fmt: skip
    if problems := family_problems(family):
        what = problems[0] if len(problems) == 1 else Lines.of(
            f"{len(problems)} things the contract of a family does not allow", *problems
        )  # fmt: skip
        raise SpecError(what, where=f"{family.name} ({module})",
                        hint="mpdt/data/spec/family.py says what each means")  # fmt: skip
    added = replace(family, module=module, id=-1)
    known.FAMILIES[added.name] = added
    _FOLDERS[added.name] = folder
    return added


def family_of(name: str, definition: Mapping[str, Any]) -> Family:
    """The family of a file: the one known here, or, without a simulator, what the file says.

    Args:
        definition: what the file says of it; empty for those that mpdt ships.
    Raises: as `get_family` where the file says nothing; DataError for a family of other sizes.
    """
    try:
        found = known.get_family(name)
    except UsageError:
        if not definition:
            raise
        return stored_family(definition)
    if definition:
        stored = stored_family(definition)
        sizes = [(one.observation_size, one.action_size, one.hidden_columns, one.action_low,
                  one.action_high) for one in (stored, found)]  # fmt: skip
        if sizes[0] != sizes[1]:
            raise DataError("the data is of another family of that name", where=name,
                            expected=f"{found.module} {found.version}: {sizes[1]}",
                            found=f"{stored.module} {stored.version}: {sizes[0]}",
                            hint="give one of them another name")  # fmt: skip
    return found


def installed() -> list[str]:
    """Names of the families of installed packages; none of them is imported."""
    return sorted({point.name for point in metadata.entry_points(group=GROUP)})


def find_own(name: str) -> Family | None:
    """The family of that name among installed packages and in the working folder's yaml.

    Raises: SpecError for one that is declared there and cannot be used.
    """
    for point in metadata.entry_points(group=GROUP, name=name):
        return load_family(name, {"module": point.value}, "")
    path = Path(FILE_NAME)
    if not os.path.lexists(path):
        return None
    try:
        text = path.read_text("utf-8")
        # Reading the shipped file as YAML takes 40 ms, and it declares none.
        block = load_yaml(text, FILE_NAME).get("families") if "families:" in text else None
    except (OSError, ValueError, AttributeError):  # whoever reads it for its entries says so
        return None
    if not isinstance(block, dict) or name not in block:
        return None
    return declared_family(name, block[name], str(path.absolute().parent))


def declared_family(name: str, entry: object, folder: str) -> Family:
    """As `load_family`, of an entry that nobody has looked at. Raises: SpecError."""
    where = f"families.{name}"
    for what, hint in _entry_problems(entry):
        raise SpecError(what, where=where, hint=hint)
    assert isinstance(entry, dict)
    return load_family(name, entry, folder)


def _entry_problems(entry: object) -> Iterator[tuple[str, str]]:
    if not isinstance(entry, dict):
        yield "expected a block of keys", "module: my_families:point_robot"
        return
    for key in entry:
        if key not in KEYS:
            near = nearest(str(key), KEYS)
            yield f"unknown key '{key}' {near}".rstrip(), f"allowed: {', '.join(KEYS)}"
    scripts = entry.get("scripts", {})
    if not isinstance(scripts, dict):
        yield "scripts: expected a block of names", "scripts: {expert: my_policies:act}"
        scripts = {}
    for problem in settings_problems(entry.get("pretrain", {}), whole=False):
        yield problem, ""
    for place, words in [("module", entry.get("module")), *scripts.items()]:
        if not isinstance(words, str) or not all(words.partition(":")):
            yield f"{place}: expected module:name, found {words!r}", "my_families:point_robot"
