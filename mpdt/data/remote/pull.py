"""Pull: bring a file or an export here; it appears when all of it is proved.

x.h5.part         what came so far           x.h5.part.json   of which state of the source
folder.part/...   an export on its way       folder           all files, each with its sum
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from mpdt.data.remote.address import last_name
from mpdt.data.remote.failure import RefusedError
from mpdt.data.remote.part import Part, forget_part, part_of, take_part
from mpdt.data.remote.place import Place
from mpdt.data.remote.sums import FILE_NAME, SUFFIX, dumped, loaded, prove
from mpdt.disk import disk, expect_folder, holding, put_folder, sha256
from mpdt.errors import DataError, MissingFileError, RemoteError, UsageError

SPARED_BYTES = 1 << 28  # left free by a server that does not say how much it will send
Tell = Callable[[str, int, int | None], None]
"""Name of a file, bytes that are there, bytes it has (None: the server does not say)."""


@dataclass(frozen=True)
class Pulled:
    """What `pull` brought.

    Args:
        num_bytes: of all files; num_new_bytes: of them, moved by this call.
        proof: `sums`, or `digests` for a dataset file without a sum beside it.
        content_hash: of a dataset file.
    """

    path: Path
    num_files: int
    num_bytes: int
    num_new_bytes: int
    proof: str
    content_hash: str = ""


def pull(
    url: str, target: Path | None = None, lock: Path | None = None, tell: Tell = lambda *_: None,
    inside: bool = False,
) -> Pulled:  # fmt: skip
    """Bring what is at `url`: a dataset file, or what `push` made of an export.

    Broken off, it goes on where it stopped if the source is still the same.

    Args:
        target: default: the URL's last name, here. Into a folder that is there a file goes under
            its own name, as with cp.
        lock: only what this datasets.lock holds will do.
        inside: `target` ended with a slash: of a file it is the folder, there or not.
    Raises: MissingFileError, RemoteError; DataError for what arrived damaged and for something
        else at `target`; UsageError; StorageError; BusyError.
    """
    with Place(url) as place, ExitStack() as stack:
        name = last_name(place.path) or last_name(place.path.rstrip("/"))
        target = target or Path(name or "pulled")
        expect_folder(target.parent)
        is_there = target.is_dir()
        file = target / (name or "pulled") if inside or is_there else target
        held = file if is_there else target
        stack.enter_context(holding(held, wait_s=0, kept="what came so far is kept"))
        # A signature is for one file alone: nothing lies beside it.
        is_signed = place.is_read_only and bool(re.search("[?;]", place.path))
        if not is_signed and (content := place.read(place.path + SUFFIX)):
            return _pull_file(place, file, _single(content, place), lock, tell)
        refused: list[RefusedError] = []
        try:
            is_file = place.state(place.path) is not None
        except RefusedError as error:  # some servers say so of any folder
            refused, is_file = [error], False
        # Of a folder, a web server shows a page of links.
        may_be_folder = not is_signed and (place.is_read_only or not is_file)
        list_path = f"{place.path.rstrip('/')}/{FILE_NAME}"
        if may_be_folder and (content := place.read(list_path)):
            sums = loaded(content, f"{place.address}/{FILE_NAME}")
            return _pull_folder(place, target, sums, lock, tell)
        if refused:
            raise refused[0]
        if not is_file:
            raise MissingFileError("no file there, and no folder with a list of sums",
                                   where=place.address, expected=f"a file, or {FILE_NAME} in it",
                                   hint="mpdt-data push writes that list")  # fmt: skip
        return _pull_file(place, file, None, lock, tell)


def _single(content: bytes, place: Place) -> str:
    sums = loaded(content, place.address + SUFFIX)
    if len(sums) != 1:
        raise DataError("several sums for one file", where=place.address + SUFFIX)
    return next(iter(sums.values()))


def _pull_file(
    place: Place, target: Path, sum: str | None, lock: Path | None, tell: Tell
) -> Pulled:
    proof = "sums" if sum else "digests"
    if target.exists():
        if sum is None or not target.is_file() or sha256(target) != sum:
            raise _in_the_way(target)
        moved, content = 0, prove(target, lock)
        forget_part(target)
    else:
        found: list[str] = []
        # A sum says that it arrived as it was sent; the digests, that it was whole when sent.
        moved = fetch(place, place.path, target, sum, lambda p: found.append(prove(p, lock)), tell)
        content = found[0]
    return Pulled(target, 1, target.stat().st_size, moved, proof, content)


def _pull_folder(
    place: Place, target: Path, sums: dict[str, str], lock: Path | None, tell: Tell
) -> Pulled:
    if lock is not None:
        raise UsageError("the lock holds dataset files, not exports", where=place.address)
    arriving, _ = part_of(target)
    there = target if target.exists() else arriving
    moved = 0
    if there is arriving:
        with disk(target):
            take_part(target, json.dumps([place.address, FILE_NAME]))
    for name, sum in sums.items():
        path = there / name
        if path.is_file() and sha256(path) == sum:
            continue
        if there is target:
            raise _in_the_way(target)
        with disk(path):
            path.unlink(missing_ok=True)
            path.parent.mkdir(parents=True, exist_ok=True)
        moved += fetch(place, f"{place.path.rstrip('/')}/{name}", path, sum, lambda _: None, tell)
    if there is arriving:
        with disk(target):
            for path in arriving.rglob("*"):  # of an earlier state of the source
                if path.is_file() and path.relative_to(arriving).as_posix() not in sums:
                    path.unlink()
            (arriving / FILE_NAME).write_bytes(dumped(sums))
        put_folder(arriving, target)
    forget_part(target)
    size = sum_of_sizes(target, sums)
    return Pulled(target, len(sums), size, moved, "sums")


def sum_of_sizes(folder: Path, names: dict[str, str]) -> int:
    return sum((folder / name).stat().st_size for name in names)


def _in_the_way(target: Path) -> DataError:
    return DataError("something else is there already", where=str(target),
                     hint="choose another name with -o, or move it away first")  # fmt: skip


def fetch(
    place: Place, path: str, target: Path, sum: str | None, check: Callable[[Path], object],
    tell: Tell,
) -> int:  # fmt: skip
    """One file, through `<target>.part`; returns the bytes that moved.

    Raises: as `pull`.
    """
    state = place.state(path)
    if state is None:
        raise MissingFileError("no such file", where=place.shown(path))
    size = state["size"]
    with Part(target, json.dumps([place.address, place.shown(path), state, sum])) as part:
        start = part.resume(certain=bool(sum or state["version"]), size=size)
        _room(target, None if size is None else size - start)
        tell(target.name, start, size)
        while size is None or part.size < size:
            before = part.size
            try:
                for chunk in place.stream(path, before):
                    if size is None:
                        _room(target, len(chunk) + SPARED_BYTES)
                    elif part.size + len(chunk) > size:
                        part.discard()
                        raise DataError("sends more than it announced, and was deleted",
                                        where=place.address, expected=f"{size:,} bytes",
                                        found="more")  # fmt: skip
                    part.write(chunk)
                    tell(target.name, part.size, size)
                if size is None or part.size >= size:
                    break
                raise RemoteError("ended early", where=place.address, expected=f"{size:,} bytes",
                                  found=f"{part.size:,}",
                                  hint="the same command goes on from here")  # fmt: skip
            except RemoteError:
                if part.size == before:  # nothing came: trying again at once will not help
                    raise
                place.reconnect()
        moved = part.size - start
        found = sha256(part.path)
        if sum not in (None, found):
            part.discard()
            raise DataError("arrived damaged, and was deleted", where=place.address,
                            expected=f"SHA-256 {sum}", found=found,
                            hint="the same command starts anew; if that fails too, the copy "
                                 "there is damaged")  # fmt: skip
        try:
            check(part.path)
        except DataError:
            part.discard()
            raise
        part.finish()
    return moved


def _room(target: Path, num_bytes: int | None) -> None:
    """Raises: StorageError if the disk has no room, before the long part."""
    with disk(target):
        free = shutil.disk_usage(target.parent).free
        if num_bytes is not None and free < num_bytes:
            raise OSError(f"No space left: {num_bytes:,} bytes needed, {free:,} free")
