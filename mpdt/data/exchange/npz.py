"""One .npz with every array (lossless). Loads with `numpy.load` alone.

    row            0    1    2  |  3    4     one more row than steps per episode
    observations  o_0  o_1  o_2 | o_0  o_1    the last one is the final observation
    actions       a_0  a_1   0  | a_0   0     zero where there is no step
    rewards, terminations, truncations, successes: as actions
    valids         1    1    0  |  1    0     1 where the row is a step

Beside them the columns of `episodes/` and `goals/` (lengths, qualities, seed keys, ...) and, as
UTF-8 bytes, a manifest with tasks, policies and identity. Memory holds the whole selection.
"""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.exchange.episode_table import EpisodeTable
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.manifest import AGAIN, KEY, Manifest, single_file
from mpdt.data.exchange.selection import Selection
from mpdt.data.exchange.treatment import Rules
from mpdt.data.store.layout import EPISODES, GOALS, STEPS
from mpdt.data.store.sources import EpisodeSource
from mpdt.errors import FormatError, MpdtError
from mpdt.reading import TEXT_BYTES, open_plain, refuse_other

Arrays = dict[str, NDArray[Any]]

_MOST_COMPRESSED = 100
"""Bytes per stored one at most. We store them plainly; others may have packed them again."""
_EPISODES = {column.path: f"episodes/{column.path}" for column in EPISODES}
_GOALS = {column.path: f"goals/{column.path}" for column in GOALS}
_ROWS = dict.fromkeys((column.path for column in STEPS), "N") | dict.fromkeys(
    _EPISODES.values(), "E"
)
"""What counts the rows of an array: N steps and one more per episode, or E episodes."""
_NAMES = (*(column.path for column in STEPS), *_EPISODES.values(), *_GOALS.values())
_PER_STEP = [column.path for column in STEPS if column.path != "observations"]
# What numpy and zipfile raise about bytes that make no sense.
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, SyntaxError, ValueError,
    TypeError, KeyError, EOFError, OSError, MemoryError, OverflowError, NotImplementedError,
    RecursionError,
)  # fmt: skip


def write(selection: Selection, folder: Path) -> None:
    """`<name>.npz` in `folder`. Raises: OSError."""
    table, dataset = EpisodeTable.of(selection), selection.dataset
    obs_start, lengths = table.columns["obs_start"], table.columns["length"]
    num_rows = selection.num_steps + len(selection.ids)
    arrays: Arrays = {
        "observations": np.zeros((num_rows, dataset.observation_size), "<f4"),
        "valids": np.ones(num_rows, bool),
    }
    for name in _PER_STEP:
        if (column := getattr(dataset.steps, name)) is not None:
            arrays[name] = np.zeros((num_rows, *column.shape[1:]), column.dtype)
    for i, first, length in zip(selection.ids.tolist(), obs_start, lengths, strict=True):
        episode = selection.episode(i)
        arrays["observations"][first : first + length + 1] = episode.observations
        arrays["valids"][first + length] = False
        for name in _PER_STEP:
            if name in arrays:
                arrays[name][first : first + length] = getattr(episode, name)
    arrays |= {f"episodes/{name}": column for name, column in table.columns.items()}
    arrays |= {f"goals/{name}": column for name, column in table.goals.items()}
    text = Manifest.of(selection).to_json().encode()
    arrays[KEY] = np.frombuffer(text, np.uint8)
    np.savez(folder / f"{selection.header.name}.npz", allow_pickle=False, **arrays)


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """An export of ours, whose content hash the result has to have.

    Raises: MissingFileError; FormatError for a file that is damaged or not an export of ours.
    """
    path = single_file(files_below(paths, ".npz"), ".npz file", str(paths[0]))
    refuse_other(path, "an .npz file", "a zip archive")
    try:
        with open_plain(path) as file, zipfile.ZipFile(file) as archive:
            odd = _others(archive)
            text = _manifest(archive)
            manifest = Manifest.from_json(text, str(path))
            arrays = {name: _array(archive, name, manifest, path) for name in _wanted(archive)}
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("damaged, or not an export of mpdt", where=str(path),
                          found=f"{type(error).__name__}: {error}"[:120],
                          hint=AGAIN) from error  # fmt: skip
    table = EpisodeTable(
        {name: arrays[key] for name, key in _EPISODES.items() if key in arrays},
        {name: arrays[key] for name, key in _GOALS.items() if key in arrays},
    )
    table.check(manifest, str(path))
    _check_steps(arrays, manifest, str(path))
    source = EpisodeSource(
        _episodes(arrays, table, manifest), manifest.num_episodes, manifest.num_steps,
        table.source_ids(),
    )  # fmt: skip
    told = [f"left out of {path}: {', '.join(odd[:3])}, not of an export of mpdt"] * bool(odd)
    return manifest.incoming(source, [*left_out(paths, [path]), *told])


def _others(archive: zipfile.ZipFile) -> list[str]:
    """Names of members that no export of ours has.

    Raises: ValueError for two members of one name: which of them is read is the reader's choice.
    """
    names = Counter(archive.namelist())
    if twice := [name for name, times in names.items() if times > 1]:
        raise ValueError(f"two members are called {twice[0]}")
    return sorted(names.keys() - {f"{name}.npy" for name in (KEY, "valids", *_NAMES)})


def _wanted(archive: zipfile.ZipFile) -> list[str]:
    """Names of the arrays that are read; whatever else lies in the archive is not looked at."""
    there = set(archive.namelist())
    return [name for name in _NAMES if f"{name}.npy" in there]


def _manifest(archive: zipfile.ZipFile) -> bytes:
    info = archive.getinfo(f"{KEY}.npy")
    if info.file_size > TEXT_BYTES:
        raise ValueError(f"a manifest of {info.file_size:,} bytes")
    with archive.open(info) as file:
        text: bytes = np.lib.format.read_array(file, allow_pickle=False).tobytes()
    return text


def _array(archive: zipfile.ZipFile, name: str, manifest: Manifest, path: Path) -> NDArray[Any]:
    """One array, once it is known to be what the manifest announces, and no larger.

    Raises: FormatError for another type or number of rows; what numpy says of damage.
    """
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0,
                       (2, 0): np.lib.format.read_array_header_2_0}[version]  # fmt: skip
        shape, _, dtype = read_header(file)
    counts = {"N": manifest.num_steps + manifest.num_episodes, "E": manifest.num_episodes}
    rows = counts.get(_ROWS.get(name, ""))
    if dtype.hasobject or (rows is not None and shape[:1] != (rows,)):
        raise FormatError(f"array {name} is wrong", where=str(path), expected=f"{rows} rows",
                          found=f"{dtype} of shape {shape}")  # fmt: skip
    size = prod(shape) * dtype.itemsize
    if size > min(info.file_size, _MOST_COMPRESSED * path.stat().st_size):
        raise FormatError(f"array {name} is larger than its file can hold", where=str(path),
                          found=f"{size:,} bytes")  # fmt: skip
    with archive.open(info) as file:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _check_steps(arrays: Arrays, manifest: Manifest, where: str) -> None:
    header, rows = manifest.header, manifest.num_steps + manifest.num_episodes
    widths = {"observations": (header.observation_size,), "actions": (header.action_size,)}
    for column in STEPS:
        name = column.path
        if name == "successes" and not header.has_success:
            continue
        found = arrays.get(name)
        wanted = (rows, *widths.get(name, ()))
        if found is None or found.shape != wanted or found.dtype != np.dtype(column.dtype):
            sides = "nothing" if found is None else f"{found.dtype} of shape {found.shape}"
            raise FormatError(f"array {name} is wrong", where=where,
                              expected=f"{column.dtype} of shape {wanted}",
                              found=sides)  # fmt: skip


def _episodes(arrays: Arrays, table: EpisodeTable, manifest: Manifest) -> Iterator[Episode]:
    first = 0
    for i, length in enumerate(table.columns["length"].tolist()):
        steps = {name: arrays[name][first : first + length] for name in _PER_STEP if name in arrays}
        steps["observations"] = arrays["observations"][first : first + length + 1]
        yield table.episode(i, manifest, steps)
        first += length + 1
