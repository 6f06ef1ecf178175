"""Large tables are maps of the file: equal to what is read, and nobody else's when written to."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from makers import make_episode, make_header, source_of

from mpdt.data.store import integrity, tree
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.writer import write_file
from mpdt.errors import FormatError


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("os.fsync", lambda handle: None)
    episodes = [make_episode(3 + i % 4, float(i), row=i) for i in range(12)]
    write_file(tmp_path / "a.h5", make_header(episodes), source_of(episodes))
    return tmp_path / "a.h5"


def tables(data: Dataset) -> dict[str, np.ndarray]:
    found = {f.name: getattr(data.episodes, f.name) for f in dataclasses.fields(data.episodes)}
    return {name: values for name, values in found.items() if values is not None}


def is_map(values: np.ndarray) -> bool:
    while values.base is not None and isinstance(values.base, np.ndarray):
        values = values.base
    return isinstance(values, np.memmap)


def test_maps_hold_what_is_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = tables(open_dataset(path))
    assert not any(map(is_map, read.values()))
    monkeypatch.setattr(tree, "MAPPED_BYTES", 1)
    mapped, preloaded = open_dataset(path), open_dataset(path, preload=True)
    assert all(map(is_map, tables(mapped).values()))
    assert not any(map(is_map, tables(preloaded).values()))
    for name, values in tables(mapped).items():
        assert values.dtype == read[name].dtype and values.tobytes() == read[name].tobytes(), name
        assert type(values) is np.ndarray
    before = path.read_bytes()
    mapped.episodes.task[:] = 7
    assert path.read_bytes() == before and (open_dataset(path).episodes.task != 7).all()


def test_offsets_are_compared_in_every_piece(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = open_dataset(path)
    monkeypatch.setattr(integrity, "_AT_ONCE", 5)
    integrity.check_tables(data)
    for column, row in (("start", 7), ("obs_start", 11), ("length", 0)):
        values = getattr(data.episodes, column)
        values[row] += 1
        with pytest.raises(FormatError, match=r"overlaps at episode|does not cover"):
            integrity.check_tables(data)
        values[row] -= 1
