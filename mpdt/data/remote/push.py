"""Push: send a dataset file or an export; each file appears there whole, the list of sums last.

x.h5.1a2b3c4d.part    on its way: named after its sum, so that a resumed one is of these bytes
x.h5                  read back, equal, renamed
x.h5.sha256           the sum beside it
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mpdt.data.remote import hub
from mpdt.data.remote.address import hidden, last_name
from mpdt.data.remote.place import Place
from mpdt.data.remote.sums import FILE_NAME, SUFFIX, dumped, prove, sums_of
from mpdt.disk import Seen, holding
from mpdt.errors import BusyError, DataError, RemoteError, StorageError, UsageError

Tell = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Pushed:
    """What `push` sent.

    Args:
        address: where it is, without secrets.
        num_bytes: of all files; num_new_bytes: of them, moved by this call.
        checked: read back and equal, as opposed to equal in size.
    """

    address: str
    num_files: int
    num_bytes: int
    num_new_bytes: int
    checked: bool


def push(
    source: Path, url: str, replace: bool = False, check: bool = True,
    tell: Tell = lambda *_: None, kind: hub.Kind = "dataset",
) -> Pushed:  # fmt: skip
    """Send a dataset file, a folder that `export` wrote, or a policy's bundle.

    Args:
        url: where it shall be; one that ends with a slash gets the name of `source`.
        replace: also if something else is there.
        check: read back what was sent and compare; else its size alone counts.
        kind: of the repository, where `url` is a hub's.
    Raises: MissingFileError, RemoteError; DataError for a source that is not whole, for something
        else at `url`, and for what arrived damaged; UsageError for http and unknown protocols.
    """
    if url.partition("://")[0] in ("http", "https"):
        raise UsageError("http is read only", where=hidden(url),
                         hint="webdav:// or sftp:// to the same host may do")  # fmt: skip
    proved = Seen.of(source.stat()) if source.is_file() else None
    if proved:
        prove(source)
    with Place(_named(url, source)) as place:
        if source.is_file() and (place.info(place.path) or {}).get("type") == "directory":
            place.enter(source.resolve().name)  # as cp does
        sums = sums_of(source)
        if proved and Seen.of(source.stat()) != proved:
            raise BusyError("another process wrote it meanwhile", where=str(source),
                            hint="the same command sends what is there now")  # fmt: skip
        with _held(place):
            return _push(place, source, sums, replace, check, tell, kind)


@contextmanager
def _held(place: Place) -> Iterator[None]:
    """Nobody else of ours sends there meanwhile, as far as that can be said: to a folder."""
    if not place.is_folder:
        yield
        return
    path = place.path.rstrip("/")
    place.make_folder(path)
    with holding(Path(path), wait_s=0, kept="what was sent so far is kept"):
        yield


def _push(
    place: Place, source: Path, sums: dict[str, str], replace: bool, check: bool, tell: Tell,
    kind: hub.Kind,
) -> Pushed:  # fmt: skip
    if source.is_file():
        base, list_path = place.path, place.path + SUFFIX
        files, digests = {base: source}, {base: sums[source.name]}
        listed = dumped({last_name(base): digests[base]})
    else:
        base = place.path.rstrip("/")
        list_path, listed = f"{base}/{FILE_NAME}", dumped(sums)
        files = {f"{base}/{name}": source / name for name in sums}
        digests = {f"{base}/{name}": digest for name, digest in sums.items()}
    missing = [path for path in files if not _is_there(place, path, files, digests, replace)]
    moved = 0
    if place.protocol == "hf":
        if missing or place.read(list_path) != listed:
            new = {path: files[path] for path in missing}
            moved = hub.commit(place, new, list_path, listed, kind)
        for path in missing:
            _compare(place, path, files[path], digests[path], check)
    else:
        for path in missing:
            moved += _send(place, files[path], path, digests[path], check, tell)
        if place.read(list_path) != listed:
            place.write(list_path, listed)
    total = sum(path.stat().st_size for path in files.values())
    return Pushed(place.address, len(files), total, moved, check)


def _named(url: str, source: Path) -> str:
    """`url`, completed by the name of `source` if it names a folder or a hub repository."""
    is_repository = url.startswith("hf://") and url.count("/") <= 4 and source.is_file()
    if url.endswith("/") or is_repository:
        return f"{url.rstrip('/')}/{source.resolve().name}"
    return url


def _is_there(
    place: Place, path: str, files: dict[str, Path], digests: dict[str, str], replace: bool
) -> bool:
    """Whether this very file is there. Raises: DataError for another one."""
    state = place.state(path)
    if state is None:
        return False
    size = files[path].stat().st_size
    if state["size"] in (size, None) and place.sha256(path) == digests[path]:
        return True
    if not replace:
        raise DataError("something else is there already", where=place.address,
                        found=place.shown(path), hint="--replace, or another URL")  # fmt: skip
    return False


def _send(place: Place, source: Path, path: str, digest: str, check: bool, tell: Tell) -> int:
    """One file under a temporary name, compared, renamed; returns the bytes that moved."""
    temporary, size = f"{path}.{digest[:8]}.part", source.stat().st_size
    if place.is_folder and Path(temporary).is_symlink():
        raise StorageError(
            "a link is in the way", where=temporary, hint="move it away, it is not ours"
        )
    there = _size(place, temporary) if place.can_append else 0
    start = sent = there if there <= size else 0
    while True:
        tell(source.name, sent, size)
        try:
            if place.can_append:
                place.append(temporary, source, sent)
            else:
                place.put(temporary, source)
            break
        except RemoteError:
            place.reconnect()
            arrived = _size(place, temporary) if place.can_append else 0
            if arrived <= sent:  # nothing came: trying again at once will not help
                raise
            sent = arrived
    tell(source.name, size, size)
    _compare(place, temporary, source, digest, check)
    place.rename(temporary, path)
    return size - start


def _size(place: Place, path: str) -> int:
    return int((place.state(path) or {}).get("size") or 0)


def _compare(place: Place, path: str, source: Path, digest: str, check: bool) -> None:
    """Raises: DataError, and what is there is deleted, unless it is what was sent."""
    size = _size(place, path)
    found = place.sha256(path) if check and size == source.stat().st_size else ""
    if size != source.stat().st_size or (check and found != digest):
        place.remove(path)
        raise DataError("arrived damaged, and was deleted there", where=place.address,
                        expected=f"{source.stat().st_size:,} bytes, SHA-256 {digest}",
                        found=f"{size:,} bytes" + (f", {found}" if found else ""),
                        hint="the same command sends it again")  # fmt: skip
