"""What a merged file says of its sources: every import, and what each said of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpdt.data.store.dataset import Dataset

_TREATMENT = ("from", "clip_actions", "hide_goal")
"""Keys of an import that hold for all its sources; see `exchange/foreign.py`."""


def imports(sources: Sequence[Dataset]) -> dict[str, Any] | None:
    """`import` of the merged spec: every file that was read, each once; None where none was.

    Where the sources were treated or licensed differently, each file has its own treatment and
    licence beside it.
    """
    records: list[dict[str, Any]] = []
    for source in sources:
        said = source.spec.get("import")
        if not isinstance(said, Mapping):
            continue
        own = {key: said[key] for key in _TREATMENT if key in said} | {"license": source.license}
        files = said.get("sources")
        for file in files if isinstance(files, list) else [{}]:
            record = own | (dict(file) if isinstance(file, Mapping) else {"name": str(file)})
            if record not in records:
                records.append(record)
    if not records:
        return None
    shared = {key: records[0].get(key) for key in (*_TREATMENT, "license")}
    if any(record.get(key) != value for record in records for key, value in shared.items()):
        return {"sources": records}
    kept = [{key: v for key, v in record.items() if key not in shared} for record in records]
    return {key: shared[key] for key in _TREATMENT if shared[key] is not None} | {"sources": kept}


def statements(sources: Sequence[Dataset]) -> list[dict[str, Any]]:
    """What each source says about itself; nothing where all say the same."""
    said = [
        {
            "name": source.name,
            "version": source.version,
            "license": source.license,
            "spec": dict(source.spec),
            "packages": dict(source.packages),
            "platform": dict(source.platform),
        }
        for source in sources
    ]
    return [] if all(one == said[0] for one in said) else said
