"""Minari's arrow sets: written and loaded by the real package, read by us, also those of others."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from mpdt.data.exchange import minari
from mpdt.data.exchange.minari_sets import opened
from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]
EXPERT = "mpdt/ml10/reach/expert-v2"


@pytest.fixture
def exported(run: Make, reach: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """reach as arrow sets in `out`, where the real package then looks for it."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out"))
    assert run("export", reach, "--to", "minari-arrow", "-o", "out") == 0
    return tmp_path / "out"


def test_minari_loads_what_the_file_holds(exported: Path, reach: Path) -> None:
    import minari as real

    assert set(real.list_local_datasets(compatible_minari_version=True)) == {
        EXPERT, EXPERT.replace("expert", "random")
    }  # fmt: skip
    found, data = real.load_dataset(EXPERT), open_dataset(reach)
    assert found.storage.metadata["data_format"] == "arrow"
    assert found.total_episodes == 2 and found.total_steps == 24
    ids = data.select(quality="expert").tolist()
    starts = list(found.storage.get_episode_metadata([0, 1]))
    for episode, start, i in zip(found, starts, ids, strict=True):
        one = data.episode(i)
        for name in minari.STEPS:
            stored = getattr(episode, name)
            np.testing.assert_array_equal(stored, getattr(one, name))
            assert stored.dtype == getattr(one, name).dtype
        np.testing.assert_array_equal(episode.infos["success"][1:], one.successes)
        assert start["options"]["goal"] == one.goal.tolist() and start["seed"] >= 0
        assert "EpisodeData(id=" in repr(episode)
    metadata = json.loads((exported / EXPERT / "data/metadata.json").read_text())
    assert metadata["ref_max_score"] == data.tasks.ref_expert[0]
    assert metadata["minari_version"] == "0.5.0" and metadata["jpeg_encoding"] is False


def test_out_and_in_again_is_the_same_data(exported: Path, reach: Path, imported: Make) -> None:
    back, data = imported("out", "--from", "minari"), open_dataset(reach)
    assert back.content_hash == data.content_hash
    assert (back.version, back.spec) == (data.version, data.spec)
    assert repr(back.tasks.references) == repr(data.tasks.references)  # NaN


def test_both_storages_give_the_same_foreign_data(
    exported: Path, reach: Path, run: Make, imported: Make
) -> None:
    """As foreign sets: one content, told apart by the hash of all their files."""
    assert run("export", reach, "--to", "minari", "-o", "hdf5") == 0
    words = ("--from", "minari", "--family", "ml10", "--horizon", 12)
    first = imported("hdf5/mpdt", *words)
    Path("imported.h5").unlink()
    second = imported("out/mpdt", *words)
    assert first.content_hash == second.content_hash and second.num_episodes == 4
    hashes = [[one["sha256"] for one in data.spec["import"]["sources"]] for data in (first, second)]
    assert all(len(hash) == 64 for hash in hashes[1]) and not set(hashes[0]) & set(hashes[1])
    place = exported / EXPERT / "data/0/part-0.arrow"
    content = place.read_bytes()
    spoilt = content.replace(b"\0\0\x80\x3f", b"\0\0\0\x3f", 1)  # a 1.0 becomes 0.5
    assert spoilt != content
    place.write_bytes(spoilt)
    Path("imported.h5").unlink()
    changed = imported("out/mpdt", *words)
    assert [one["sha256"] for one in changed.spec["import"]["sources"]] != hashes[1]
    place.write_bytes(content)
    metadata = exported / EXPERT / "data/metadata.json"
    metadata.write_text(metadata.read_text() + "\n")  # it is a part of the set, too
    Path("imported.h5").unlink()
    changed = imported("out/mpdt", *words)
    assert [one["sha256"] for one in changed.spec["import"]["sources"]] != hashes[1]


def test_sets_of_others_become_a_family_of_their_own(tmp_path: Path, imported: Make) -> None:
    """No success, no options, a seed; numbers by hand."""
    import gymnasium
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    box = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    (tmp_path / "theirs").mkdir()
    storage = MinariStorage.new(tmp_path / "theirs/data", box, box, data_format="arrow")
    storage.update_episodes(
        EpisodeBuffer(
            id=number, seed=7, observations=np.full((4, 2), number / 4, np.float32),
            actions=np.full((3, 2), 0.5, np.float32), rewards=[0.0, 1.0, 2.0],
            terminations=[False] * 3, truncations=[False, False, True],
        )
        for number in range(2)
    )  # fmt: skip
    data = imported("theirs", "--from", "minari", "--family-of", "mine")
    assert data.num_episodes == 2 and data.episode(1).observations[0].tolist() == [0.25, 0.25]
    assert data.episode(0).rewards.tolist() == [0.0, 1.0, 2.0]
    with opened(tmp_path / "theirs/data", {"data_format": "arrow", "total_episodes": 2}) as stored:
        assert stored.episode(1).attributes["seed"] == 7
        assert stored.episode(1).successes(9) is None


def rewritten(path: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    with pa.ipc.open_file(path) as file:
        batch = file.get_batch(0)
    columns = change({name: batch.column(name) for name in batch.schema.names})
    new = pa.RecordBatch.from_pydict(columns)
    with pa.OSFile(str(path), "wb") as out, pa.ipc.new_file(out, new.schema) as writer:
        writer.write_batch(new)


def without(columns: dict[str, Any]) -> dict[str, Any]:
    del columns["actions"]
    return columns


def of_parts(columns: dict[str, Any]) -> dict[str, Any]:
    part = pa.StructArray.from_arrays([columns["observations"]], ["a"])
    return columns | {"observations": part}


def with_a_gap(columns: dict[str, Any]) -> dict[str, Any]:
    return columns | {"rewards": pa.array([None, *columns["rewards"].to_pylist()[1:]])}


def with_a_gap_inside(columns: dict[str, Any]) -> dict[str, Any]:
    numbers = columns["observations"].flatten().to_pylist()
    part = pa.FixedSizeListArray.from_arrays(pa.array([None, *numbers[1:]], pa.float32()), 39)
    return columns | {"observations": part}


def narrower(columns: dict[str, Any]) -> dict[str, Any]:
    wide = columns["actions"].flatten().to_numpy().reshape(-1, 4)[:, :3].copy().reshape(-1)
    return columns | {"actions": pa.FixedSizeListArray.from_arrays(pa.array(wide), 3)}


def test_it_has_no_links(reach: Path, run: Make, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", reach, "--to", "minari-arrow", "-o", "out", "--link") == 2
    assert "minari-arrow has no links" in capsys.readouterr().err


def test_what_is_refused(
    exported: Path, run: Make, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """One line each, and no file."""
    data = exported / EXPERT / "data"
    place = data / "0/part-0.arrow"
    saved = place.read_bytes()

    def refused(why: str) -> None:
        assert run("import", "out", "--from", "minari", "-o", "x.h5") == 1
        error = capsys.readouterr().err
        assert why in error and "Traceback" not in error, error
        assert not Path("x.h5").exists()

    for change, why in ((without, "no actions"), (with_a_gap, "empty cells"),
                        (with_a_gap_inside, "observations has empty cells"),
                        (of_parts, "observations of several parts"),
                        (narrower, "arrays of other sizes")):  # fmt: skip
        rewritten(place, change)
        refused(why)
        place.write_bytes(saved)
    with pa.ipc.open_file(place) as file:
        batch = file.get_batch(0)
    with pa.OSFile(str(place), "wb") as out, pa.ipc.new_file(out, batch.schema) as writer:
        for part in (batch.slice(0, 6), batch.slice(6)):
            writer.write_batch(part)
    refused("not one batch of steps; found 2")
    place.write_bytes(saved)
    (data / "0/part-1.arrow").write_bytes(saved)
    refused("not one file of steps")
    (data / "0/part-1.arrow").unlink()
    place.write_bytes(saved[: len(saved) // 2])
    refused("damaged, or not an Arrow file of Minari")
    place.write_bytes(b"PK\x03\x04")
    refused("a zip archive")
    place.unlink()
    refused("not one file of steps")
    place.write_bytes(saved)
    (data / "0/metadata.json").write_text("{")
    refused("not JSON")
    shutil.copytree(data / "1", data / "2")
    refused("not the number of episodes in its metadata; expected 2, found 3")
    shutil.rmtree(data / "2")
    shutil.rmtree(data / "1")
    refused("not the number of episodes in its metadata")
