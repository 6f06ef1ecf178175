"""LeRobot v3, out: one row group per episode, written with pyarrow alone.

    meta/info.json  meta/stats.json  meta/tasks.parquet  README.md
    meta/episodes/chunk-000/file-000.parquet     lengths, row ranges, statistics per episode
    data/chunk-000/file-000.parquet              one row per step

The format has no row for the observation after the last step. Source: huggingface/lerobot,
src/lerobot/datasets (codebase version v3.0). Not by its own writer: lerobot 0.4.4 pins torch below
2.11, does 2,600 steps a second where this does 64,000, and stops at a column of one number with
datasets 5.2 (docs/decisions/0038). Its own LeRobotDataset reads what is written here.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.exchange import arrow
from mpdt.data.exchange.selection import Selection
from mpdt.data.spec.tasks import Family
from mpdt.version import __version__

LOST = "the observation after the last step of every episode, seeds, policies and quality"
CHUNK_FILES, MAX_FILE_MB = 1000, 100
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"

Columns = dict[str, NDArray[Any]]


def write(selection: Selection, folder: Path) -> None:
    """The tree of one dataset. Memory holds one column of all steps. Raises: OSError."""
    family = selection.dataset.contract()
    data, lengths = selection.dataset, selection.dataset.episodes.length[selection.ids]
    step_bytes = 4 * (data.observation_size + data.action_size) + 48
    sizes = np.cumsum(lengths.astype(np.int64)) * step_bytes // (MAX_FILE_MB * 1_000_000)
    _, files = np.unique(sizes, return_inverse=True)
    rows = {task.index: row for row, task in enumerate(selection.header.tasks)}
    episodes: list[dict[str, Any]] = []
    writer: Any = None
    first = 0
    for number, (i, file) in enumerate(zip(selection.ids.tolist(), files.tolist(), strict=True)):
        episode = selection.episode(i)
        columns = _columns(episode, number, first, rows[episode.task], family)
        table = pa.table({name: arrow.column(values) for name, values in columns.items()})
        place = dict(zip(("chunk_index", "file_index"), divmod(file, CHUNK_FILES), strict=True))
        if writer is None or file != files[number - 1]:
            if writer is not None:
                writer.close()
            path = folder / _DATA_PATH.format(**place)
            path.parent.mkdir(parents=True, exist_ok=True)
            writer = pq.ParquetWriter(path, table.schema, compression="snappy")
        writer.write_table(table, row_group_size=len(table))
        task = _task_text(selection, rows[episode.task])
        episodes.append(_episode_row(columns, number, first, task, place))
        first += episode.length
    writer.close()
    _write_meta(selection, folder, episodes, family)


def _task_text(selection: Selection, row: int) -> str:
    return f"{selection.header.family}: {selection.header.tasks[row].name}"


def _columns(episode: Episode, number: int, first: int, task: int, family: Family) -> Columns:
    steps = np.arange(episode.length, dtype=np.int64)
    columns: Columns = {
        "observation.state": episode.observations[:-1],
        "action": episode.actions,
        "next.reward": episode.rewards,
        "next.done": episode.terminations | episode.truncations,
        "next.truncated": episode.truncations,
    }
    if episode.successes is not None:
        columns["next.success"] = episode.successes
    return columns | {
        "timestamp": (steps * family.step_s).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full_like(steps, number),
        "index": first + steps,
        "task_index": np.full_like(steps, task),
    }


def _episode_row(
    columns: Columns, number: int, first: int, task: str, place: dict[str, int]
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "episode_index": number,
        "tasks": [task],
        "length": len(columns["index"]),
        "dataset_from_index": first,
        "dataset_to_index": first + len(columns["index"]),
        **{f"data/{name}": value for name, value in place.items()},
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }
    for name, values in columns.items():
        row |= {f"stats/{name}/{stat}": found for stat, found in _stats(values).items()}
    return row


def _stats(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Per column of (N,) or (N, D) values, as lists; flags count as 0 and 1."""
    table = values.reshape(len(values), -1).astype(np.float64)
    found = {
        "min": table.min(axis=0),
        "max": table.max(axis=0),
        "mean": table.mean(axis=0),
        "std": table.std(axis=0),
    }
    found |= dict(
        zip(_QUANTILES, np.quantile(table, list(_QUANTILES.values()), axis=0), strict=True)
    )
    return {name: numbers.tolist() for name, numbers in found.items()} | {"count": [len(table)]}


def _write_meta(
    selection: Selection, folder: Path, episodes: list[dict[str, Any]], family: Family
) -> None:
    tasks = [_task_text(selection, row) for row in range(len(selection.header.tasks))]
    meta = folder / "meta"
    (folder / _EPISODES_PATH).parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(episodes), folder / _EPISODES_PATH, compression="snappy")
    pq.write_table(_tasks_table(tasks), meta / "tasks.parquet")
    files = sorted((folder / "data").rglob("*.parquet"))
    (meta / "stats.json").write_text(json.dumps(_all_stats(files), indent=4), "utf-8")
    info = {
        "codebase_version": "v3.0",
        "robot_type": family.scene.partition("/")[0] or family.name,
        "total_episodes": len(episodes),
        "total_frames": selection.num_steps,
        "total_tasks": len(tasks),
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": MAX_FILE_MB,
        "video_files_size_in_mb": MAX_FILE_MB,
        "fps": round(1 / family.step_s),
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": _DATA_PATH,
        "video_path": None,
        "features": _features(files[0], family),
    }
    (meta / "info.json").write_text(json.dumps(info, indent=4), "utf-8")
    (folder / "README.md").write_text(_readme(selection), "utf-8")


def _readme(selection: Selection) -> str:
    header = selection.header
    return f"""---
license: {json.dumps(header.license.lower())}
task_categories: [robotics]
tags: [LeRobot]
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# {header.name} {header.version}

{len(selection.ids):,} episodes of the family {header.family}, written by mpdt
{__version__} from the episodes of content hash {selection.content_hash}. The format has no
place for {LOST}.
"""


def _all_stats(files: list[Path]) -> dict[str, dict[str, list[Any]]]:
    """Of every column over all files, one column in memory at a time."""
    stats = {}
    for name, dtype in _dtypes(files[0]).items():
        tables = [pq.read_table(path, columns=[name], partitioning=None) for path in files]
        stats[name] = _stats(np.concatenate([arrow.array(t, name, dtype) for t in tables]))
    return stats


def _dtypes(path: Path) -> dict[str, str]:
    """numpy's name of what each column of a file holds."""
    inner = {
        field.name: field.type.value_type if hasattr(field.type, "list_size") else field.type
        for field in pq.read_schema(path)
    }
    return {name: np.dtype(kind.to_pandas_dtype()).name for name, kind in inner.items()}


def _features(path: Path, family: Family) -> dict[str, dict[str, Any]]:
    names = {
        "observation.state": list(family.columns),
        "action": [f"action_{i}" for i in range(family.action_size)],
    }
    return {
        name: {"dtype": dtype, "shape": [len(names.get(name, "1"))], "names": names.get(name)}
        for name, dtype in _dtypes(path).items()
    }


def _tasks_table(tasks: list[str]) -> Any:
    """task_index by text, with the text as index where pandas reads it."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": tasks})
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_type,
             "metadata": None}
            for name, kind, numpy_type in (
                ("task_index", "int64", "int64"), ("task", "unicode", "object"),
            )
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }  # fmt: skip
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
