"""Flipped bytes: a damaged file reads as it is, or gives an error of ours; nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.slices.stats import compute_stats
from mpdt.data.store import origin
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.store.tables import Additions, Slice
from mpdt.data.store.ttaset import tta_episodes
from mpdt.data.store.writer import write_file
from mpdt.data.verbs.describe import describe
from mpdt.errors import MpdtError

COPIES = 200


def read_everything(path: Path) -> None:
    dataset = open_dataset(path)
    for i in range(dataset.num_episodes):
        dataset.episode(i)
    dataset.policy_infos()
    describe(dataset)
    for name in dataset.slices:
        dataset.select(slice=name)
    for name in dataset.tta:
        list(tta_episodes(dataset, name, *open_tta_rewards(path, name)))


def heap_headers(content: bytes) -> list[int]:
    """Where the sizes of text objects stand: `GCOL`, size, then (id, count, 0, size, text) each.

    Some wrong sizes send HDF5 itself (2.0.0) round in circles for ever, which no reader can
    turn into an error; so they stay as they are here.
    """
    places: list[int] = []
    start = content.find(b"GCOL")
    while start >= 0:
        place, end = start + 16, start + int.from_bytes(content[start + 8 : start + 16], "little")
        places += range(start, place)
        while place + 16 <= end:
            places += range(place, place + 16)
            number = int.from_bytes(content[place : place + 2], "little")
            size = int.from_bytes(content[place + 8 : place + 16], "little")
            if number == 0:  # the free rest
                break
            place += 16 + -(-size // 8) * 8
        start = content.find(b"GCOL", end)
    return places


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::RuntimeWarning")
def test_damage_is_an_error_of_ours(kit, tmp_path, monkeypatch):
    monkeypatch.setattr(origin, "_entries", list)  # else every hint reads datasets.yaml

    def finish(dataset):
        chosen = {"first": Slice(np.array([0, 2]), {})}
        return Additions(slices=chosen, stats=compute_stats(dataset))

    path = tmp_path / "whole.h5"
    # Nothing of this machine in it: every machine tries the same bytes.
    header = replace(kit.header, packages={"mpdt": "0"}, platform={"os": "any"})
    write_file(path, header, kit.source(), {"default": kit.tta()}, finish)
    read_everything(path)
    content = np.frombuffer(path.read_bytes(), np.uint8)
    used = np.flatnonzero(content)  # HDF5 leaves long runs of nothing
    used = np.setdiff1d(used, heap_headers(path.read_bytes()))
    rng = np.random.default_rng(20240901)
    refused, copy = 0, tmp_path / "copy.h5"
    for number in range(COPIES):
        damaged = content.copy()
        places = rng.choice(used, 1)
        damaged[places] ^= np.uint8(1 << rng.integers(0, 8))
        copy.write_bytes(damaged.tobytes())
        try:
            read_everything(copy)
        except MpdtError:
            refused += 1
        except Exception as error:
            raise AssertionError(f"copy {number}, bytes {sorted(places.tolist())}") from error
    assert refused > COPIES // 4
