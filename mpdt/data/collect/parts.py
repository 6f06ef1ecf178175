"""Parts: the folder `<target>.parts/` where finished blocks wait for the pack.

plan.json         spec, spec hash, what the bytes depend on beside it (versions, policies)
collector.pid     advisory lock, held by the collector whose process id it shows
blocks/*.npz      one finished block each: there completely, or not there
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpdt.data.collect.part import Part
from mpdt.data.collect.plan import Block
from mpdt.data.lock.claim import changed_keys
from mpdt.data.store.lock import take_lock
from mpdt.disk import disk, replacing
from mpdt.errors import DataError


@dataclass(frozen=True)
class PartsFolder:
    """The parts of one target file."""

    target: Path

    @property
    def path(self) -> Path:
        return self.target.with_name(self.target.name + ".parts")

    def part(self, block: Block) -> Part:
        return Part(self.path / "blocks", block)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Create the folder and hold its lock.

        Raises: BusyError with the other collector's process id; StorageError.
        """
        with disk(self.path):
            lock = take_lock(
                self.path / "collector.pid", "another collector holds this target", self.target,
                "finished blocks are kept",
            )  # fmt: skip
            (self.path / "blocks").mkdir(exist_ok=True)
        try:
            yield
        finally:
            lock.close()

    def agree(self, plan: dict[str, Any]) -> None:
        """Write plan.json, or check that the one that is there says the same.

        Raises: DataError naming the keys that changed.
        """
        path = self.path / "plan.json"
        # A round trip, so that tuples and lists compare equal.
        plan = json.loads(json.dumps(plan))
        found = self._read_plan()
        if found is None:
            if any((self.path / "blocks").iterdir()):
                self.clear()  # parts of an unknown plan are worth nothing
            with replacing(path) as temporary, disk(path):
                temporary.write_text(json.dumps(plan, indent=1, sort_keys=True))
        elif changed := changed_keys(found, plan):
            raise DataError(
                "the unfinished parts were made for another plan: " + "; ".join(changed),
                where=str(self.path),
                hint="--restart deletes them and starts again; or undo the change to resume",
            )

    def _read_plan(self) -> Any:
        try:
            return json.loads((self.path / "plan.json").read_bytes())
        except (FileNotFoundError, ValueError):
            return None

    def clear(self) -> None:
        """Delete every part and the plan; the lock stays."""
        with disk(self.path):
            shutil.rmtree(self.path / "blocks", ignore_errors=True)
            (self.path / "blocks").mkdir()
            (self.path / "plan.json").unlink(missing_ok=True)

    def discard(self) -> None:
        """Delete the folder if there is one and nobody is at work in it. Raises: BusyError."""
        if self.path.is_dir():
            with self.locked():
                self.delete()

    def delete(self) -> None:
        """Delete the folder; the caller holds its lock. A leftover is harmless: no error.

        The lock file goes last: whoever takes the next one finds the rest gone.
        """
        shutil.rmtree(self.path / "blocks", ignore_errors=True)
        with suppress(OSError):
            for name in ("plan.json", "collector.pid"):
                (self.path / name).unlink(missing_ok=True)
            self.path.rmdir()
