"""A lossless export that was edited by hand is found out, whatever the content hash covers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from mpdt.data.exchange.manifest import Manifest
from mpdt.data.exchange.selection import Selection
from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]
Edit = Callable[[dict[str, Any]], None]


def rewrite(to: str, folder: Path, edit: Edit) -> None:
    """Change the manifest where the format keeps it."""

    def edited(text: str | bytes) -> str:
        said = json.loads(text)
        edit(said)
        return json.dumps(said)

    if to == "npz":
        path = folder / "tiny.npz"
        with np.load(path) as archive:
            arrays = dict(archive)
        text = edited(arrays["mpdt"].tobytes()).encode()
        np.savez(path, **arrays | {"mpdt": np.frombuffer(text, np.uint8)})
    elif to == "parquet":
        path = folder / "episodes.parquet"
        table = pq.read_table(path)
        text = edited(table.schema.metadata[b"mpdt"])
        pq.write_table(table.replace_schema_metadata({"mpdt": text}), path)
    else:
        for path in folder.rglob("metadata.json"):
            metadata = json.loads(path.read_text())
            path.write_text(json.dumps(metadata | {"mpdt": edited(metadata["mpdt"])}))


def other(*keys: Any, value: Any) -> Edit:
    def edit(said: dict[str, Any]) -> None:
        for key in keys[:-1]:
            said = said[key]
        assert said[keys[-1]] != value
        said[keys[-1]] = value

    return edit


EDITS = {
    "role": other("header", "tasks", 0, "role", value="train"),
    "licence": other("header", "license", value="ISC"),
    "level": other("header", "policies", 1, "level", value=0.51),
    "lineage": other("header", "lineage", value=[{"verb": "split", "from": []}]),
    "reference": other("header", "tasks", 0, "references", "by_name", "random", "mean", value=9.0),
    "package": other("header", "packages", "mujoco", value="9"),
    "source": other("sources", value="ab" * 32),
}


@pytest.mark.parametrize("to", ["npz", "parquet", "minari"])
@pytest.mark.parametrize("name", EDITS)
def test_an_edited_manifest(
    collected: Path, run: Make, capsys: pytest.CaptureFixture[str], to: str, name: str
) -> None:
    assert run("export", collected, "--to", to, "-o", "out") == 0
    rewrite(to, Path("out"), EDITS[name])
    assert run("import", "out", "--from", to, "-o", "x.h5") == 1
    assert "its hash is that of another manifest" in capsys.readouterr().err
    assert not Path("x.h5").exists()


@pytest.mark.parametrize("to", ["npz", "parquet", "minari"])
def test_an_export_of_an_older_release(
    collected: Path, run: Make, capsys: pytest.CaptureFixture[str], to: str
) -> None:
    def older(said: dict[str, Any]) -> None:
        del said["manifest_sha256"], said["sources"]

    assert run("export", collected, "--to", to, "-o", "out") == 0
    rewrite(to, Path("out"), older)
    assert run("import", "out", "--from", to, "-o", "x.h5") == 0
    assert "an export of an older release: its episodes are proven" in capsys.readouterr().err
    assert open_dataset("x.h5").content_hash == open_dataset(collected).content_hash


def test_other_ids_of_origin(
    collected: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("export", f"{collected}:expert", "--to", "npz", "-o", "out") == 0
    path = Path("out/tiny.npz")
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays["episodes/source"] = arrays["episodes/source"] + 1
    np.savez(path, **arrays)
    assert run("import", path, "--from", "npz", "-o", "x.h5") == 1
    assert "the ids of the file it was cut out of were changed" in capsys.readouterr().err


def test_text_and_back(collected: Path) -> None:
    data = open_dataset(collected)
    text = Manifest.of(Selection(data, np.arange(3))).to_json()
    assert Manifest.from_json(text, "x").to_json() == text
