"""The LeRobot v3 tree: row groups, ranges, statistics, and what is not in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]


@pytest.fixture
def export(run: Make, tmp_path: Path) -> Make:
    def write(path: object) -> Path:
        assert run("export", path, "--to", "lerobot", "-o", "out") == 0
        return tmp_path / "out"

    return write


def test_steps(reach: Path, export: Make, capsys: pytest.CaptureFixture[str]) -> None:
    folder, data = export(reach), open_dataset(reach)
    assert "the observation after the last step" in capsys.readouterr().err
    file = pq.ParquetFile(folder / "data/chunk-000/file-000.parquet")
    assert file.num_row_groups == 4 and file.metadata.row_group(0).column(0).compression == "SNAPPY"
    rows = file.read_row_group(2)
    episode = data.episode(2)
    np.testing.assert_array_equal(rows["observation.state"].to_pylist(), episode.observations[:-1])
    np.testing.assert_array_equal(rows["action"].to_pylist(), episode.actions)
    assert rows["next.reward"].to_pylist() == episode.rewards.tolist()
    assert rows["next.done"].to_pylist() == [False] * 11 + [True]
    assert rows["next.success"].to_pylist() == episode.successes.tolist()
    assert rows["index"].to_pylist() == list(range(24, 36))
    assert rows["frame_index"].to_pylist() == list(range(12))
    assert set(rows["episode_index"].to_pylist()) == {2}
    # 80 steps per second: the simulator's own 12.5 ms.
    assert rows["timestamp"].to_pylist()[:3] == pytest.approx([0, 0.0125, 0.025])
    assert file.schema_arrow.field("observation.state").type == pa.list_(pa.float32(), 39)


def test_info_and_statistics(reach: Path, export: Make) -> None:
    folder, data = export(reach), open_dataset(reach)
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["splits"]) == ("v3.0", 80, {"train": "0:4"})
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (4, 48, 1)
    columns = pq.read_schema(folder / "data/chunk-000/file-000.parquet").names
    assert list(info["features"]) == columns
    shapes = {name: feature["shape"] for name, feature in info["features"].items()}
    assert shapes["observation.state"] == [39] and shapes["next.reward"] == [1]
    assert info["features"]["next.done"]["dtype"] == "bool"
    assert info["features"]["frame_index"]["dtype"] == "int64"
    assert info["features"]["observation.state"]["names"][:2] == ["hand_x [m]", "hand_y [m]"]
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert set(stats) == set(columns) and set(stats["action"]) == {
        "min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99",
    }  # fmt: skip
    actions = data.steps.actions.astype(np.float64)
    np.testing.assert_allclose(stats["action"]["mean"], actions.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(stats["action"]["q90"], np.quantile(actions, 0.9, axis=0))
    assert stats["frame_index"]["q50"] == [5.5] and stats["index"]["count"] == [48]
    assert stats["next.done"]["mean"] == [4 / 48]


def test_episodes_and_tasks(collected: Path, export: Make) -> None:
    folder, data = export(collected), open_dataset(collected)
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert len(episodes) == 32
    row = episodes[20]
    assert (row["episode_index"], row["length"], row["tasks"]) == (20, 5, ["cheetah_dir: backward"])
    assert (row["dataset_from_index"], row["dataset_to_index"]) == (100, 105)
    assert row["stats/next.reward/mean"] == [pytest.approx(data.episode(20).rewards.mean())]
    assert row["stats/action/count"] == [5]
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert tasks.to_pydict() == {
        "task_index": [0, 1], "task": ["cheetah_dir: forward", "cheetah_dir: backward"],
    }  # fmt: skip
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_large_sets_are_several_files(
    collected: Path, export: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing fits a file of 0 MB, so every episode gets its own; two files to a chunk."""
    monkeypatch.setattr("mpdt.data.exchange.lerobot.MAX_FILE_MB", 1e-6)
    monkeypatch.setattr("mpdt.data.exchange.lerobot.CHUNK_FILES", 2)
    folder = export(f"{collected}:expert")
    files = sorted(p.relative_to(folder).as_posix() for p in folder.glob("data/*/*"))
    assert files == [f"data/chunk-{c:03d}/file-{f:03d}.parquet" for c in range(4) for f in (0, 1)]
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(e["data/chunk_index"], e["data/file_index"]) for e in episodes[:3]] == [
        (0, 0), (0, 1), (1, 0),
    ]  # fmt: skip
