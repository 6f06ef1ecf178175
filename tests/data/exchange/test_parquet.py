"""The Parquet tree: layout, the same content hash after a round trip, damage is found."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]


@pytest.fixture
def export(run: Make, tmp_path: Path) -> Make:
    def write(path: object) -> Path:
        assert run("export", path, "--to", "parquet", "-o", "out") == 0
        return tmp_path / "out"

    return write


def test_the_tree(collected: Path, export: Make) -> None:
    folder, data = export(collected), open_dataset(collected)
    found = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    tables = ("episodes", "goals", "policies", "tasks")
    steps = [f"data/{q}/train-00000-of-00001" for q in ("expert", "history", "medium", "random")]
    assert found == sorted(
        ["README.md", "croissant.json", *(f"{name}.parquet" for name in (*tables, *steps))]
    )
    header = yaml.safe_load((folder / "README.md").read_text().split("---")[1])
    assert [config["config_name"] for config in header["configs"]] == [
        "random", "medium", "expert", "history",
    ]  # fmt: skip
    for config in header["configs"]:
        (files,) = config["data_files"]
        assert len(list(folder.glob(files["path"]))) == 1
    file = pq.ParquetFile(folder / "data/medium/train-00000-of-00001.parquet")
    ids = data.select(quality="medium")
    assert file.num_row_groups == len(ids) == 8
    assert file.metadata.row_group(0).column(3).compression == "ZSTD"
    assert file.schema_arrow.field("observation").type == pa.list_(pa.float32(), 20)
    steps_of = file.read_row_group(3)
    wanted = data.episode(ids[3])
    np.testing.assert_array_equal(steps_of["observation"].to_pylist(), wanted.observations[:-1])
    np.testing.assert_array_equal(steps_of["action"].to_pylist(), wanted.actions)
    assert steps_of["reward"].to_pylist() == wanted.rewards.tolist()
    assert steps_of["truncation"].to_pylist() == [False] * 4 + [True]
    assert set(steps_of["task"].to_pylist()) == {"forward"}
    assert steps_of["step"].to_pylist() == [0, 1, 2, 3, 4]
    assert set(steps_of["episode"].to_pylist()) == {int(ids[3])}


def test_the_episode_table_has_the_final_observation(collected: Path, export: Make) -> None:
    folder, data = export(collected), open_dataset(collected)
    episodes = pq.read_table(folder / "episodes.parquet")
    for i in (0, 31):
        row = episodes.slice(i, 1).to_pylist()[0]
        assert row["final_observation"] == data.episode(i).observations[-1].tolist()
        assert row["return"] == data.episodes.returns[i]
        assert row["seed_key"] == data.episodes.seed_key[i].tolist()
        assert row["digest"] == data.episodes.digest[i].tobytes()
        assert row["task_name"] == ("forward", "backward")[i // 16]
    assert episodes["quality_name"].to_pylist()[:5] == ["random"] * 4 + ["medium"]
    tasks = pq.read_table(folder / "tasks.parquet").to_pydict()
    assert tasks["ref_expert"] == data.tasks.ref_expert.tolist()


def test_croissant_names_every_file_by_its_hash(reach: Path, export: Make) -> None:
    folder = export(reach)
    found = json.loads((folder / "croissant.json").read_text())
    assert found["conformsTo"].endswith("croissant/1.0") and found["license"] == "CC0-1.0"
    for entry in found["distribution"]:
        content = (folder / entry["contentUrl"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == entry["sha256"]
    (steps,) = [r for r in found["recordSet"] if r["@id"].startswith("data/expert")]
    types = {field["name"]: field["dataType"] for field in steps["field"]}
    assert types["observation"] == "sc:Float" and types["success"] == "sc:Boolean"
    assert types["step"] == "sc:Integer" and types["task"] == "sc:Text"


@pytest.mark.parametrize("file", ["collected", "reach"])
def test_out_and_in_again_is_the_same_data(
    file: str, export: Make, imported: Make, request: pytest.FixtureRequest
) -> None:
    path = request.getfixturevalue(file)
    export(path)
    back: Dataset = imported("out", "--from", "parquet")
    data = open_dataset(path)
    assert back.content_hash == data.content_hash
    assert (back.version, back.spec, back.license) == (data.version, data.spec, data.license)
    assert repr(back.tasks.references) == repr(data.tasks.references)  # NaN


def test_a_slice_is_the_same_data_as_the_cut_file(
    collected: Path, export: Make, imported: Make, tmp_path: Path
) -> None:
    export(f"{collected}:history")
    back: Dataset = imported("out", "--from", "parquet")
    cut = cut_file(open_dataset(collected), Cut(quality="history"), tmp_path / "history.h5")
    assert (back.content_hash, back.parent) == (cut.content_hash, cut.parent)


def test_large_sets_are_several_files(
    collected: Path, export: Make, imported: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight episodes of 5 steps of 124 bytes: 620 bytes each, three to a file of 2,000."""
    monkeypatch.setattr("mpdt.data.exchange.parquet.MAX_FILE_BYTES", 2000)
    folder = export(collected)
    files = sorted(path.name for path in (folder / "data/expert").iterdir())
    assert files == [f"train-{i:05d}-of-00003.parquet" for i in range(3)]
    groups = [pq.ParquetFile(folder / "data/expert" / name).num_row_groups for name in files]
    assert groups == [3, 3, 2]
    back: Dataset = imported("out", "--from", "parquet")
    assert back.content_hash == open_dataset(collected).content_hash


def rewrite(path: Path, change: Callable[[Any], Any], rows: int = 5) -> None:
    table = pq.read_table(path, partitioning=None)
    pq.write_table(change(table), path, row_group_size=rows)


def column_set(name: str, value: Any) -> Callable[[Any], Any]:
    def change(table: Any) -> Any:
        place = table.column_names.index(name)
        return table.set_column(place, name, value(table.column(name)))

    return change


def test_tables_that_repeat_the_manifest_may_be_away(
    reach: Path, export: Make, imported: Make
) -> None:
    folder = export(reach)
    (folder / "tasks.parquet").unlink()
    rewrite(
        folder / "policies.parquet", lambda table: table.append_column("mine", [["a"] * len(table)])
    )
    assert imported("out", "--from", "parquet").content_hash == open_dataset(reach).content_hash


def first_null(column: Any) -> Any:
    values = column.to_pylist()
    return pa.array([None, *values[1:]], column.type)


@pytest.mark.parametrize(
    ("file", "change", "text"),
    [
        (
            "steps",
            column_set("reward", lambda c: pa.array(np.zeros(40, np.float32))),
            "not the epi",
        ),
        (
            "steps",
            column_set("reward", lambda c: pa.array(np.ones(40))),
            "reward is double, not fl",
        ),
        ("steps", column_set("reward", first_null), "column reward has empty cells"),
        ("steps", column_set("truncation", first_null), "column truncation has empty cells"),
        ("steps", lambda table: table.drop_columns("action"), "damaged"),
        ("steps", lambda table: table.slice(5), "too few row groups"),
        ("steps", lambda table: table.slice(0, 4), "not its number of steps"),
        ("episodes", lambda table: table.slice(1), "not the announced number of rows"),
        ("episodes", lambda table: table.replace_schema_metadata({}), "not an export of mpdt"),
        ("episodes", lambda table: table.replace_schema_metadata({"mpdt": "[]"}), "not an export"),
        ("episodes", column_set("quality", lambda c: pa.array(np.ones(32))), "quality is double"),
        ("episodes", lambda table: table.drop_columns("final_observation"), "final_observation"),
        ("goals", lambda table: table.drop_columns("dim"), "column dim is missing"),
        ("tasks", column_set("role", lambda c: pa.array(["test"] * 2)), "tasks.parquet: role"),
        ("tasks", lambda table: table.slice(1), "tasks.parquet: name"),
        ("policies", column_set("hash", lambda c: pa.array(c.to_pylist()[::-1])), "parquet: hash"),
    ],
)
def test_changes_are_found(
    collected: Path, export: Make, run: Make, capsys: pytest.CaptureFixture[str],
    file: str, change: Callable[[Any], Any], text: str,
) -> None:  # fmt: skip
    name = "data/expert/train-00000-of-00001" if file == "steps" else file
    rewrite(export(collected) / f"{name}.parquet", change)
    assert run("import", "out", "--from", "parquet", "-o", "x.h5") == 1
    assert text in capsys.readouterr().err
    assert not list(Path().glob("x.h5*"))


def test_bytes_that_are_no_parquet(
    collected: Path, export: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = export(collected)
    steps = "data/random/train-00000-of-00001.parquet"
    for name in (steps, "policies.parquet", "tasks.parquet", "episodes.parquet"):
        path = folder / name
        path.write_bytes(path.read_bytes()[:-20])
        assert run("import", "out", "--from", "parquet", "-o", "x.h5") == 1
        assert "damaged, or not an export of mpdt" in capsys.readouterr().err
    (folder / "episodes.parquet").unlink()
    assert run("import", "out", "--from", "parquet", "-o", "x.h5") == 2
