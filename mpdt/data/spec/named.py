"""What a user named as `module:name`, imported: from a folder first, then what is installed."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from mpdt.errors import UsageError, nearest


def import_named(words: str, folder: Path | None) -> Any:
    """The object behind `module:name` or `module:outer.inner`.

    Args:
        folder: where the module is looked for before anything installed; None = nowhere. What it
            imports later is still found there, behind everything installed.
    Raises: UsageError for words of another form, a module that does not import, or no such name.
    """
    module_name, colon, path = words.partition(":")
    if not (colon and module_name and path):
        raise UsageError(f"cannot read '{words}'", expected="module:name")
    here = None if folder is None else str(folder.absolute())
    if here is not None:
        sys.path.insert(0, here)
    try:
        module = importlib.import_module(module_name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        text = " ".join(str(error).split())
        told = f"{type(error).__name__}: {text}"[:200] if text else type(error).__name__
        hint = "-v shows where; modules are looked for beside datasets.yaml and in what is "
        hint += "installed"
        if "/" in module_name or module_name.endswith(".py"):
            hint = f"a module's name, not a file's: {Path(module_name).stem}:{path}"
        raise UsageError(f"cannot be imported: {told}", where=module_name, hint=hint) from error
    finally:
        if here is not None:
            sys.path.remove(here)
            if here not in sys.path:
                sys.path.append(here)
    found: Any = module
    for name in path.split("."):
        if not hasattr(found, name):
            near = nearest(name, [each for each in vars(module) if not each.startswith("_")])
            where = getattr(module, "__file__", None) or "a folder without __init__.py"
            raise UsageError(f"no '{name}' in it {near}".rstrip(), where=words,
                             hint=f"what was imported is {where}")  # fmt: skip
        found = getattr(found, name)
    return found
