"""Parquet in the layout of Hugging Face datasets (lossless): one configuration per quality.

    data/<quality>/train-00000-of-00001.parquet   steps; one row group per episode
    episodes.parquet    one row per episode: the file format's columns, and the observation
                        after the last step, which has no row of its own
    tasks.parquet  goals.parquet  policies.parquet  README.md  croissant.json

Vectors are `fixed_size_list`, compressed with zstd. The schema of episodes.parquet holds the
manifest, which is what an import believes, beside the numbers.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.exchange import arrow
from mpdt.data.exchange.croissant import describe, readme
from mpdt.data.exchange.episode_table import EpisodeTable
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import quality_name
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.manifest import AGAIN, KEY, Manifest, single_file
from mpdt.data.exchange.parquet_copies import check_copy, copies_in, policies_table, tasks_table
from mpdt.data.exchange.selection import Selection
from mpdt.data.exchange.treatment import Rules
from mpdt.data.store.layout import EPISODES, GOALS, STEPS
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.errors import FormatError, MissingFileError, MpdtError, ShapeError
from mpdt.reading import refuse_other

_TABLES = ("episodes.parquet", "goals.parquet", "tasks.parquet", "policies.parquet")
_SHARD = "train-{:05d}-of-{:05d}.parquet"
_COUNT = re.compile(r"-of-(\d{5})\.parquet")
MAX_FILE_BYTES = 500_000_000
_COMPRESSION = "zstd"
# Name of the column of a step -> of the array in the file format.
_STEPS = {
    "observation": "observations", "action": "actions", "reward": "rewards",
    "termination": "terminations", "truncation": "truncations", "success": "successes",
}  # fmt: skip
_DTYPES = {column.path: column.dtype for column in STEPS + EPISODES + GOALS}
_MOST_COMPRESSED = 1000
"""Bytes per stored one at most; rewards of zeros are the worst of what we write."""
_DAMAGE = (pa.ArrowException, OSError, KeyError, ValueError, TypeError, IndexError, AttributeError)


# ---- out ----


def write(selection: Selection, folder: Path) -> None:
    """The tree of one export. Memory holds one episode and the tables. Raises: OSError."""
    manifest, table = Manifest.of(selection), EpisodeTable.of(selection)
    qualities = {int(code): quality_name(int(code)) for code in np.unique(table.columns["quality"])}
    for code, name in qualities.items():
        _write_steps(selection, np.flatnonzero(table.columns["quality"] == code),
                     folder / "data" / name)  # fmt: skip
    tables = {
        "episodes": _episodes_table(selection, table, manifest),
        "tasks": tasks_table(manifest.header),
        "goals": pa.table({name: arrow.column(values) for name, values in table.goals.items()}),
        "policies": policies_table(manifest.header),
    }
    for name, content in tables.items():
        pq.write_table(content, folder / f"{name}.parquet", compression=_COMPRESSION)
    (folder / "README.md").write_text(readme(manifest, list(qualities.values())), "utf-8")
    text = json.dumps(describe(manifest, folder), indent=1)
    (folder / "croissant.json").write_text(text, "utf-8")


def _write_steps(selection: Selection, places: NDArray[np.int64], folder: Path) -> None:
    """Steps of the episodes at `places` of the export, in as few files as the limit allows."""
    folder.mkdir(parents=True)
    data = selection.dataset
    step_bytes = 4 * (data.observation_size + data.action_size) + 20
    lengths = data.episodes.length[selection.ids[places]].astype(np.int64)
    # By size before compression: never too large, at times a file more than needed.
    _, number = np.unique(np.cumsum(lengths * step_bytes) // MAX_FILE_BYTES, return_inverse=True)
    count = int(number[-1]) + 1
    for part in range(count):
        writer: Any = None
        for place in places[number == part].tolist():
            table = _steps_table(selection, place)
            if writer is None:
                path = folder / _SHARD.format(part, count)
                writer = pq.ParquetWriter(path, table.schema, compression=_COMPRESSION)
            writer.write_table(table, row_group_size=len(table))
        if writer is not None:
            writer.close()


def _steps_table(selection: Selection, place: int) -> Any:
    data, i = selection.dataset, int(selection.ids[place])
    episode = selection.episode(i)
    columns = {
        "episode": pa.array(np.full(episode.length, place, np.int32)),
        "step": pa.array(np.arange(episode.length, dtype=np.int32)),
        "task": pa.array([data.tasks.names[int(data.episodes.task[i])]] * episode.length),
    }
    for name, stored in _STEPS.items():
        if (values := getattr(episode, stored)) is not None:
            columns[name] = arrow.column(values[: episode.length])
    return pa.table(columns)


def _episodes_table(selection: Selection, table: EpisodeTable, manifest: Manifest) -> Any:
    data = selection.dataset
    last = data.episodes.obs_start[selection.ids] + data.episodes.length[selection.ids]
    names = [task.name for task in manifest.header.tasks]
    columns = {
        "episode": pa.array(np.arange(len(selection.ids), dtype=np.int32)),
        "task_name": pa.array([names[row] for row in table.columns["task"]]),
        "quality_name": pa.array([quality_name(int(q)) for q in table.columns["quality"]]),
    }
    columns |= {name: arrow.column(values) for name, values in table.columns.items()}
    columns["final_observation"] = arrow.column(data.steps.observations[last])
    return pa.table(columns).replace_schema_metadata({KEY: manifest.to_json()})


# ---- in ----


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """An export of ours, whose content hash the result has to have.

    Raises: MissingFileError; FormatError for files that are damaged or not an export of ours.
    """
    found = [one for one in files_below(paths, ".parquet") if one.name == "episodes.parquet"]
    path = single_file(found, "episodes.parquet", str(paths[0]))
    folder = path.parent
    with _told(path):
        text = (_schema(path).metadata or {})[KEY.encode()]
        manifest = Manifest.from_json(text, str(path))
        names = [column.path for column in EPISODES] + ["final_observation"]
        episodes = _table(path, names, manifest.num_episodes)
        columns = _columns(episodes, EPISODES)
        final = arrow.array(episodes, "final_observation", "<f4")
    with _told(folder / "goals.parquet"):
        goals = _table(folder / "goals.parquet", [column.path for column in GOALS])
        table = EpisodeTable(columns, _columns(goals, GOALS))
    for path_of_copy in copies_in(folder):
        with _told(path_of_copy):
            check_copy(path_of_copy, manifest.header)
    table.check(manifest, str(folder))
    if final.shape != (manifest.num_episodes, manifest.header.observation_size):
        raise FormatError("column final_observation is wrong", where=str(path), hint=AGAIN)
    codes = np.unique(table.columns["quality"]).tolist()
    shards = {quality: _shards(folder / "data" / quality) for quality in map(quality_name, codes)}
    steps = [one for some in shards.values() for one in some]
    announced = [*(folder / name for name in _TABLES), *steps]
    if odd := [one for one in files_below([folder], ".parquet") if one not in announced]:
        raise _unannounced(odd[0])
    _check_widths(steps, manifest.header)
    source = EpisodeSource(
        _episodes(shards, manifest, table, final), manifest.num_episodes, manifest.num_steps,
        table.source_ids(),
    )  # fmt: skip
    pages = [folder / "README.md", folder / "croissant.json"]
    return manifest.incoming(source, left_out(paths, announced + pages))


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """What pyarrow says of a file that makes no sense, as one error."""
    try:
        yield
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("damaged, or not an export of mpdt", where=str(path),
                          found=f"{type(error).__name__}: {error}"[:160],
                          hint=AGAIN) from error  # fmt: skip


def _shards(folder: Path) -> list[Path]:
    """The files of one quality, in order; the first says how many.

    Raises: MissingFileError for one of them, FormatError for another file among them.
    """
    found = sorted(folder.glob("*.parquet"))
    said = _COUNT.search(found[0].name) if found else None
    count = int(said[1]) if said else 1
    wanted = [folder / _SHARD.format(i, count) for i in range(count)]
    for path in wanted:
        if path not in found:
            raise MissingFileError("steps of the export are missing", where=str(path), hint=AGAIN)
    if odd := [path for path in found if path not in wanted]:
        raise _unannounced(odd[0])
    return wanted


def _unannounced(path: Path) -> FormatError:
    return FormatError("not of the export that it lies in", where=str(path),
                       hint="move it away; the export says nothing of it")  # fmt: skip


def _schema(path: Path) -> Any:
    refuse_other(path, "a Parquet file", "a Parquet file")
    return pq.read_schema(path)


def _table(path: Path, names: Sequence[str], rows: int | None = None) -> Any:
    """The columns of these names, as far as they are there, of a table of `rows` rows.

    Raises: FormatError where it announces other rows, or more than a file of its size can hold.
    """
    refuse_other(path, "a Parquet file", "a Parquet file")
    with pq.ParquetFile(path) as file:
        _check_rows(path, file.schema_arrow, names, file.metadata.num_rows, rows)
        found = [name for name in names if name in file.schema_arrow.names]
        return file.read(columns=found, use_threads=False)


def _check_rows(
    path: Path, schema: Any, names: Sequence[str], found: int, wanted: int | None
) -> None:
    """A run of equal numbers takes no place in the format: a shape may say anything."""
    if wanted is not None and found != wanted:
        raise FormatError("not the announced number of rows", where=str(path),
                          expected=f"{wanted:,}", found=f"{found:,}", hint=AGAIN)  # fmt: skip
    fields = [schema.field(name).type for name in names if name in schema.names]
    if any(isinstance(kind, pa.ListType | pa.StructType | pa.MapType) for kind in fields):
        raise FormatError("columns of lists of any length", where=str(path), hint=AGAIN)
    size = found * sum(_width_bytes(kind) for kind in fields)
    if size > _MOST_COMPRESSED * path.stat().st_size + 1_000_000:
        raise FormatError("larger than a file of its size can hold", where=str(path),
                          found=f"{found:,} rows, {size:,} bytes", hint=AGAIN)  # fmt: skip


def _width_bytes(kind: Any) -> int:
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size) * _width_bytes(kind.value_type)
    return max(1, int(kind.bit_width) // 8)


def _columns(table: Any, columns: Sequence[Any]) -> dict[str, NDArray[Any]]:
    names = [column.path for column in columns if column.path in table.column_names]
    return {name: arrow.array(table, name, _DTYPES[name]) for name in names}


def _episodes(
    shards: Mapping[str, Sequence[Path]], manifest: Manifest, table: EpisodeTable,
    final: NDArray[np.float32],
) -> Iterator[Episode]:  # fmt: skip
    groups = {quality: _row_groups(paths) for quality, paths in shards.items()}
    wanted = [name for name in _STEPS if name != "success" or manifest.header.has_success]
    lengths = table.columns["length"].tolist()
    for i, code in enumerate(table.columns["quality"].tolist()):
        quality = quality_name(code)
        if (place := next(groups[quality], None)) is None:
            raise FormatError("too few row groups", where=str(shards[quality][-1]),
                              expected=f"one for episode {i}", hint=AGAIN)  # fmt: skip
        with _told(place[0]):
            steps = _read_group(place, wanted, lengths[i], f"{place[0]}: episode {i}")
            found = {_STEPS[n]: arrow.array(steps, n, _DTYPES[_STEPS[n]]) for n in wanted}
        found["observations"] = np.concatenate([found["observations"], final[i : i + 1]])
        yield table.episode(i, manifest, found)
    for rows in groups.values():
        if (place := next(rows, None)) is not None:
            raise FormatError("more row groups than the export has episodes",
                              where=str(place[0]), hint=AGAIN)  # fmt: skip


def _check_widths(paths: Sequence[Path], header: FileHeader) -> None:
    """Raises: FormatError before anything is reserved for vectors of another size."""
    wanted = {"observation": header.observation_size, "action": header.action_size}
    for path in paths:
        with _told(path):
            schema = _schema(path)
            found = {name: int(schema.field(name).type.list_size) for name in wanted}
        if found != wanted:
            raise FormatError("vectors of another size than the export says", where=str(path),
                              expected=str(wanted), found=str(found), hint=AGAIN)  # fmt: skip


def _row_groups(paths: Sequence[Path]) -> Iterator[tuple[Path, Any, int]]:
    for path in paths:
        refuse_other(path, "a Parquet file", "a Parquet file")
        with pq.ParquetFile(path) as file:
            for number in range(file.num_row_groups):
                yield path, file, number


def _read_group(place: tuple[Path, Any, int], wanted: list[str], length: int, where: str) -> Any:
    """The steps of one episode. Raises: ShapeError for another number of them; FormatError."""
    path, file, number = place
    found = file.metadata.row_group(number).num_rows
    if found != length:
        raise ShapeError("not its number of steps", where=where, expected=str(length),
                         found=str(found), hint=AGAIN)  # fmt: skip
    _check_rows(path, file.schema_arrow, wanted, found, length)
    names = [name for name in wanted if name in file.schema_arrow.names]
    return file.read_row_group(number, columns=names, use_threads=False)
