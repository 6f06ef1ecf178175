"""Origin: which command makes a file of a given name. For the hints of errors about it.

ml10.h5, data/ml10.h5      mpdt-data collect ml10, with -o data/ml10.h5
ml10-smoke.h5              mpdt-data collect ml10 --smoke
ml10-medium.h5             mpdt-data split ml10.h5 --quality medium
anything else              the nearest entry of datasets.yaml, or how to list them
"""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.spec.catalog import load_catalog
from mpdt.errors import MpdtError, quoted

if TYPE_CHECKING:
    from mpdt.data.store.dataset import Dataset

LIST = "mpdt-data list shows what can be made"


def missing_hint(path: Path) -> str:
    """How to get a file that is not there."""
    known = _entries()
    if command := _command(path, known):
        return command
    near = difflib.get_close_matches(path.stem, known, n=1, cutoff=0.5)
    if not near:
        return LIST
    meant = path.with_name(f"{near[0]}.h5")
    return f"did you mean {meant}? It is made by: {_command(meant, known)}"


def damaged_hint(path: Path, dataset: Dataset | None = None) -> str:
    """How to get a file again that is there, but not whole. It may be all that is left of it, so
    nobody is told to delete it.

    Args:
        dataset: what could be read of it says more than its name.
    """
    if dataset is not None:
        return f"copy it again, or move it away and {again_hint(dataset)}"
    command = _command(path, _entries())
    made = f"move it away and make it again: {command}" if command else "ask whoever made it"
    return f"copy it again, or {made}"


def again_hint(dataset: Dataset) -> str:
    """How to get the episodes of an open file again."""
    if "import" in dataset.spec:
        return "import it again from its sources"
    if dataset.lineage or dataset.parent:
        return f"make it again from its source: mpdt-data show {quoted(dataset.path)} says which"
    name, smoke = dataset.name.removesuffix("-smoke"), dataset.name.endswith("-smoke")
    if name not in _entries():
        return "ask whoever made it for another copy"
    return f"collect it again: {_collect([name, *(['--smoke'] if smoke else [])], dataset.path)}"


def _command(path: Path, known: Iterable[str]) -> str:
    """The command that makes `path`, or nothing for a name that says nothing."""
    known = set(known)
    if path.stem in known:
        return _collect([path.stem], path)
    name, _, kind = path.stem.rpartition("-")
    source = path.with_name(f"{name}.h5")
    if kind == "smoke" and name in known:
        return _collect([name, "--smoke"], path)
    if kind in QUALITY_CODES and name and (name in known or source.exists()):
        return shlex.join(["mpdt-data", "split", str(source), "--quality", kind])
    return ""


def _collect(words: list[str], path: Path) -> str:
    usual = Path(f"{words[0]}{'-smoke' * ('--smoke' in words)}.h5")
    target = [] if path == usual else ["-o", str(path)]
    return shlex.join(["mpdt-data", "collect", *words, *target])


def _entries() -> list[str]:
    try:
        return list(load_catalog().specs)
    except MpdtError:  # a mistake in datasets.yaml is not what this error is about
        return []
