"""A dataset in another process: its path and what is in the file, mapped again over there."""

from __future__ import annotations

import multiprocessing
import pickle
import shutil
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import mpdt
from mpdt.data.store.amend import add_slice
from mpdt.data.store.reader import open_dataset
from mpdt.errors import MissingFileError, StorageError, UsageError


def there(data: object) -> tuple[bool, bool, float]:
    """In the other process: mapped, not writable, and a number of it."""
    observations = attrgetter("steps.observations")(data)
    return isinstance(observations, np.memmap), observations.flags.writeable, float(
        observations.sum()
    )  # fmt: skip


def test_a_pickle_holds_no_bytes_of_the_file(
    tiny_file: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    data = mpdt.open("tiny.h5")
    text = pickle.dumps(data)
    assert len(text) < 1000 < tiny_file.stat().st_size
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")  # its path still leads to it
    again = pickle.loads(text)
    assert isinstance(again.steps.observations, np.memmap)
    assert not again.steps.observations.flags.writeable
    assert again.content_hash == data.content_hash and again.seal == data.seal != ""
    np.testing.assert_array_equal(again.steps.rewards, data.steps.rewards)
    copied = pickle.loads(pickle.dumps(mpdt.open(tiny_file, preload=True)))
    assert not isinstance(copied.steps.observations, np.memmap)


def test_samplers_take_their_file_with_them(tiny_file: Path) -> None:
    sampler = mpdt.windows(tiny_file, window=3, per_task=2)
    text = pickle.dumps(sampler)
    assert len(text) < tiny_file.stat().st_size / 10
    one, two = sampler.batch(3), pickle.loads(text).batch(3)
    np.testing.assert_array_equal(one.observations, two.observations)


@pytest.mark.parametrize("how", ["spawn", "forkserver"])
def test_workers_map_the_file(tiny_file: Path, how: str) -> None:
    data = open_dataset(tiny_file)
    with multiprocessing.get_context(how).Pool(1) as pool:
        assert pool.apply(there, (data,)) == (True, False, float(data.steps.observations.sum()))


def test_another_file_at_the_path_is_refused(tiny_file: Path, tmp_path: Path) -> None:
    data = open_dataset(tiny_file)
    text = pickle.dumps(data)
    kept = shutil.copy(tiny_file, tmp_path / "kept.h5")
    add_slice(tiny_file, "mine", [1, 2], {})  # the same episodes, another file
    with pytest.raises(StorageError, match="another file took its place"):
        pickle.loads(text)
    tiny_file.unlink()
    with pytest.raises(MissingFileError):
        pickle.loads(text)
    Path(kept).rename(tiny_file)  # a copy is as good
    assert pickle.loads(text).content_hash == data.content_hash


def test_rows_and_ids_are_whatever_is_a_whole_number(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    wanted = data.select(task="backward").tolist()
    for task in (1, np.int64(1), np.uint8(1), np.array(1), [np.int32(1)], np.array([1]), (1,)):
        assert data.select(task=task).tolist() == wanted
    assert data.select(task=iter(["backward", np.int64(1)])).tolist() == wanted
    assert data.task_row(np.int64(1)) == 1 and type(data.task_row(np.int64(1))) is int
    assert data.episode(np.uint32(3)).length == data.episode(3).length
    assert mpdt.windows(data, tasks=[np.int64(1)]).batch(np.int64(0)).observations.shape[0] == 1
    for wrong in (1.0, None, [None]):
        with pytest.raises(TypeError):
            data.task_row(wrong)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="unknown task '2'"):
        data.select(task=np.int64(2))
