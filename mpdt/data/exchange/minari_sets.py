"""One Minari set as an import looks at it: episodes by number, wherever their numbers lie.

hdf5     main_data.hdf5: a group per episode, told by its attributes
arrow    a folder per episode, see `minari_arrow.py`
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import h5py
from numpy.typing import NDArray

from mpdt.data.exchange import hdf5, minari_arrow
from mpdt.data.exchange.minari import MAIN
from mpdt.disk import sha256
from mpdt.errors import FormatError

FORMS = ("hdf5", "arrow")


class StoredEpisode(Protocol):
    """One episode, of which nothing is believed.

    Args:
        where: for errors.
        attributes: `seed`, `options/goal`, ... as the set has them.
    """

    @property
    def where(self) -> str: ...

    @property
    def attributes(self) -> Mapping[str, Any]: ...

    def length(self) -> int | None:
        """Number of rewards; None where they are no array over time. Raises: FormatError."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Of what one step has under `name`. Raises: FormatError."""

    def array(self, name: str, rows: int) -> NDArray[Any]:
        """At most `rows` rows of it. Raises: FormatError."""

    def successes(self, rows: int) -> NDArray[Any] | None:
        """Of the steps; None where the set tells none. Raises: FormatError."""


class StoredSet(Protocol):
    """The episodes of one set."""

    def __len__(self) -> int: ...

    def episode(self, number: int) -> StoredEpisode:
        """Raises: FormatError."""


def main_file(folder: Path, metadata: Mapping[str, Any]) -> Path:
    """The file that a set is named and hashed by; an arrow set has none but its metadata."""
    return folder / ("metadata.json" if metadata["data_format"] == "arrow" else MAIN)


def files_of(folder: Path, metadata: Mapping[str, Any]) -> list[Path]:
    """All files of a set."""
    rest = minari_arrow.files_of(folder) if metadata["data_format"] == "arrow" else []
    return [folder / "metadata.json", *(rest or [folder / MAIN])]


def notes_of(folder: Path, metadata: Mapping[str, Any]) -> dict[str, str]:
    """What identifies a set better than its main file: of an arrow set the hash of all its files.

    SHA-256 of a line `<sha256>  <path in the set>` per file, in the order of the paths.
    """
    if metadata["data_format"] != "arrow":
        return {}
    lines = [f"{sha256(path)}  {path.relative_to(folder).as_posix()}\n"
             for path in files_of(folder, metadata)]  # fmt: skip
    return {"sha256": hashlib.sha256("".join(lines).encode()).hexdigest()}


@contextmanager
def opened(folder: Path, metadata: Mapping[str, Any]) -> Iterator[StoredSet]:
    """The set in a folder.

    Raises: FormatError where it has another number of episodes than its metadata say, and for
        whatever cannot be read in it; MissingFileError; StorageError.
    """
    if metadata["data_format"] == "arrow":
        found: StoredSet = minari_arrow.ArrowSet(folder)
        _check_count(found, metadata, folder)
        yield found
        return
    with hdf5.opened(folder / MAIN) as file:
        found = _Hdf5Set(file, folder / MAIN)
        _check_count(found, metadata, folder / MAIN)
        yield found


def _check_count(found: StoredSet, metadata: Mapping[str, Any], where: Path) -> None:
    if len(found) != metadata["total_episodes"]:
        raise FormatError("not the number of episodes in its metadata", where=str(where),
                          expected=str(metadata["total_episodes"]),
                          found=str(len(found)))  # fmt: skip


@dataclass(frozen=True)
class _Hdf5Set:
    file: h5py.File
    path: Path

    def __len__(self) -> int:
        return len(self.file)

    def episode(self, number: int) -> StoredEpisode:
        where = f"{self.path}: episode {number}"
        return _Hdf5Episode(hdf5.member(self.file, f"episode_{number}", where), where)


@dataclass(frozen=True)
class _Hdf5Episode:
    group: h5py.Group
    where: str

    @property
    def attributes(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.group.attrs
        return found

    def length(self) -> int | None:
        hdf5.array(self.group, "rewards", self.where, (0, 0))  # one, and no larger than its file?
        shape = self.group["rewards"].shape
        return int(shape[0]) if shape else None

    def shape(self, name: str) -> tuple[int, ...]:
        return hdf5.array(self.group, name, self.where, (0, 0)).shape[1:]

    def array(self, name: str, rows: int) -> NDArray[Any]:
        return hdf5.array(self.group, name, self.where, (0, rows))

    def successes(self, rows: int) -> NDArray[Any] | None:
        """Infos also have a row for the reset."""
        if "infos" not in self.group or "success" not in hdf5.member(
            self.group, "infos", self.where
        ):
            return None
        return hdf5.array(self.group, "infos/success", self.where, (0, rows))[1:]
