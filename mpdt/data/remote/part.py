"""Part: a file on its way, beside its target, and the state of the source it is a part of."""

from __future__ import annotations

import fcntl
from pathlib import Path
from types import TracebackType

from mpdt.disk import disk, sync
from mpdt.errors import BusyError


class Part:
    """`<target>.part` and its note `<target>.part.json`, until `finish` renames it.

    The note is also the lock: HDF5 takes one of its own on the file itself.

    Args:
        source: what it is a part of, as text.
    Raises: BusyError if another process is at it; StorageError.
    """

    def __init__(self, target: Path, source: str) -> None:
        self._target, self._source = target, source
        self.path = target.with_name(target.name + ".part")
        self._note_path = target.with_name(target.name + ".part.json")

    def __enter__(self) -> Part:
        with disk(self._target):
            self._note = self._note_path.open("a+", encoding="utf-8")
            try:
                fcntl.flock(self._note, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._note.close()
                raise BusyError("another process is bringing it", where=str(self.path)) from None
            self._file = self.path.open("ab")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:  # fmt: skip
        self._file.close()
        self._note.close()

    @property
    def size(self) -> int:
        return self._file.tell()

    def resume(self, certain: bool, size: int | None) -> int:
        """Keep what is there if it is of this very source, else begin anew; bytes kept.

        Args:
            certain: the source says what tells one state of it from another.
        """
        with disk(self._target):
            self._note.seek(0)
            same = certain and self._note.read() == self._source
            if not same or size is None or self.size > size:
                self._file.truncate(0)
                self._file.seek(0)
                self._note.truncate(0)
                self._note.write(self._source)
                self._note.flush()
        return self.size

    def write(self, chunk: bytes) -> None:
        with disk(self._target):
            self._file.write(chunk)
            self._file.flush()

    def discard(self) -> None:
        """Away with it and its note."""
        self.path.unlink(missing_ok=True)
        self._note_path.unlink(missing_ok=True)

    def finish(self) -> None:
        """It is whole: make it durable, then rename it."""
        with disk(self._target):
            sync(self.path)
            self.path.rename(self._target)
            self._note_path.unlink(missing_ok=True)
            sync(self._target.parent)
