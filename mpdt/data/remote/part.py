"""Part: a file or folder on its way, beside its target; a broken transfer goes on from it.

x.h5.part         what came so far; appended to
x.h5.part.json    of which state of which source; without it the part is not ours

Its name must be known to whoever goes on, so the target is held as long as it is written.
"""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType

from mpdt.disk import disk, holding, put_file, write_bytes
from mpdt.errors import StorageError
from mpdt.reading import decode_json


class Part:
    """`<target>.part` and its note, until `finish` renames it.

    Args:
        source: what it is a part of, as a JSON list.
    Raises: BusyError if another process writes the target; StorageError, also for a file of
        that name that is not ours.
    """

    def __init__(self, target: Path, source: str) -> None:
        self._target, self._source = target, source
        self.path, self._note = part_of(target)
        self._stack = ExitStack()

    def __enter__(self) -> Part:
        with self._stack as stack, disk(self._target):
            stack.enter_context(holding(self._target, wait_s=0, kept="what came is kept"))
            self._same = take_part(self._target, self._source)
            flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
            self._file = stack.enter_context(os.fdopen(os.open(self.path, flags, 0o666), "ab"))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:  # fmt: skip
        self._stack.close()

    @property
    def size(self) -> int:
        return self._file.tell()

    def resume(self, certain: bool, size: int | None) -> int:
        """Keep what is there if it is of this very source, else begin anew; bytes kept.

        Args:
            certain: the source says what tells one state of it from another.
        """
        with disk(self._target):
            if not (certain and self._same) or size is None or self.size > size:
                self._file.truncate(0)
                self._file.seek(0)
        return self.size

    def write(self, chunk: bytes) -> None:
        with disk(self._target):
            self._file.write(chunk)
            self._file.flush()

    def discard(self) -> None:
        """Away with it and its note."""
        self.path.unlink(missing_ok=True)
        self._note.unlink(missing_ok=True)

    def finish(self) -> None:
        """It is whole: make it durable, then rename it."""
        put_file(self.path, self._target)
        with disk(self._target):
            self._note.unlink(missing_ok=True)


def part_of(target: Path) -> tuple[Path, Path]:
    """Where its part and the note of that are."""
    path = target.with_name(target.name + ".part")
    return path, path.with_name(path.name + ".json")


def forget_part(target: Path) -> None:
    """What a transfer left that was killed between its last rename and its end; no error."""
    part, note = part_of(target)
    if _source_in(note) is None:  # none of ours
        return
    with suppress(OSError):
        if os.path.lexists(part) and part.samefile(target):
            part.unlink()
        if not os.path.lexists(part):
            note.unlink()


def take_part(target: Path, source: str) -> bool:
    """Whether the part that is there is of `source`; of another source, it goes.

    The caller holds the target. The note is there from now on, the part perhaps.

    Raises: StorageError for a part that is not ours.
    """
    part, note = part_of(target)
    found = _source_in(note)
    if found == source and not part.is_symlink():
        if part.is_file() and part.stat().st_nlink > 1:
            part.unlink()  # the target of an earlier transfer, which is not to be written into
        return True
    if part.is_symlink() or (found is None and (os.path.lexists(part) or os.path.lexists(note))):
        odd = part if os.path.lexists(part) else note
        raise StorageError("something is in the way of what is to come", where=str(odd),
                           hint="move it away, it is not ours")  # fmt: skip
    if part.is_dir():
        shutil.rmtree(part)
    part.unlink(missing_ok=True)
    write_bytes(note, source.encode())
    return False


def _source_in(note: Path) -> str | None:
    """What a note of ours says; None for anything else."""
    with suppress(OSError, ValueError):
        if not note.is_symlink() and isinstance(decode_json(note.read_bytes()), list):
            return note.read_text(encoding="utf-8")
    return None
