"""Corrupting a real small file: change it, and make its hashes fit again where that is wanted."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

from mpdt.data.store.digest import content_hash
from mpdt.data.store.digests import Labels, array_digests
from mpdt.data.store.reader import read_file
from mpdt.data.store.seal import seal as write_seal
from mpdt.data.store.tables import TtaSet
from mpdt.data.verify import replay
from mpdt.data.verify.material import read_material

Change = Callable[[h5py.File], None]


@contextmanager
def changing(path: Path) -> Iterator[h5py.File]:
    with h5py.File(path, "r+", alignment_threshold=1, alignment_interval=64) as file:
        yield file


def reseal(path: Path) -> None:
    """Give the file the digests and content hashes of what is in it now."""
    dataset = read_file(path, checked=False)
    found = {}
    for track in read_material(path, dataset).tracks():
        labels = Labels(dataset)
        digests = b""
        for chunk in track.chunks():
            arrays = [
                (n, getattr(chunk, n))
                for n in ("observations", "actions", "rewards", "terminations", "truncations")
            ]
            if chunk.successes is not None:
                arrays.append(("successes", chunk.successes))
            texts = [
                labels.tta(track.table, i) if isinstance(track.table, TtaSet) else labels.episode(i)
                for i in range(chunk.first, chunk.last)
            ]
            digests += array_digests(arrays, chunk.lengths.tolist(), texts)
        found[track.label] = np.frombuffer(digests, np.uint8).reshape(-1, 32)
    with changing(path) as file:
        file["episodes/digest"][:] = found.pop("")
        content = content_hash(dataset.content_header(), file["episodes/digest"][:])
        file.attrs["content_hash"] = content
        for ids in file.get("slices", {}).values():
            ids.attrs["parent"] = content
        for label, digests in found.items():
            name = label.removeprefix("tta ")
            tta = dataset.tta[name]
            presets = {
                dataset.tasks.names[t]: float(p)
                for t, p in zip(tta.task, tta.preset_return, strict=True)
            }
            identity = dataset.content_header() | {"rule": dict(tta.rule), "preset_return": presets}
            file[f"tta/{name}/episodes/digest"][:] = digests
            if np.isfinite(tta.preset_return).all():
                file[f"tta/{name}"].attrs["content_hash"] = content_hash(identity, digests)
        write_seal(file)


@pytest.fixture
def simulated(fake_sim: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replays use the fake simulator that made tiny.h5."""
    monkeypatch.setattr(replay, "make_batch", fake_sim.FakeBatch)


@pytest.fixture
def tiny(collected: Path, tmp_path: Path, simulated: None) -> Path:
    """An own copy of tiny.h5."""
    return Path(shutil.copy(collected, tmp_path / "tiny.h5"))


@pytest.fixture
def change(tiny: Path) -> Callable[..., Path]:
    """Apply a change to tiny.h5 as a program would that seals it; with honest digests if asked.

    `broken` leaves the seal of before.
    """

    def apply(what: Change, seal: bool = False, broken: bool = False) -> Path:
        with changing(tiny) as file:
            what(file)
            if not broken:
                write_seal(file)
        if seal:
            reseal(tiny)
        return tiny

    return apply
