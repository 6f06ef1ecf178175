"""collect where something is already: left alone if finished, gone on with, or refused.

tiny has 2 x 11 blocks: see test_collect.py.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from mpdt.data.collect.collect import Progress, collect, find_finished
from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.store import provenance
from mpdt.data.store.reader import open_dataset
from mpdt.errors import BusyError, DataError

Fakes = Callable[..., None]


def test_a_finished_file_is_left_alone(
    tiny_file: Path, tiny_spec: DatasetSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "mpdt.data.collect.collect.run_missing", None
    )  # would fail if anything were run
    before = tiny_file.stat().st_mtime_ns
    done = collect(make_job(tiny_spec), tiny_file, workers=0)
    assert not done.is_new
    assert tiny_file.stat().st_mtime_ns == before


def test_leftover_parts_of_a_finished_file_are_cleared(
    tiny_file: Path, tiny_spec: DatasetSpec
) -> None:
    folder = PartsFolder(tiny_file)
    (folder.path / "blocks").mkdir(parents=True)
    collect(make_job(tiny_spec), tiny_file, workers=0)
    assert not folder.path.exists()


def test_restart_makes_the_same_content_again(tiny_file: Path, tiny_spec: DatasetSpec) -> None:
    before = open_dataset(tiny_file).content_hash
    done = collect(make_job(tiny_spec), tiny_file, workers=0, restart=True)
    assert done.is_new
    assert done.dataset.content_hash == before


def test_another_spec_is_refused_with_its_keys(tiny_file: Path, tiny_spec: DatasetSpec) -> None:
    before = tiny_file.read_bytes()
    spec = msgspec.structs.replace(tiny_spec, version="1.1.0", block=2)
    with pytest.raises(DataError, match=r'block 3 -> 2; version "1\.0\.0" -> "1\.1\.0"') as caught:
        collect(make_job(spec), tiny_file, workers=0)
    assert "--restart" in caught.value.hint
    assert caught.value.exit_code == 1
    assert tiny_file.read_bytes() == before
    assert collect(make_job(spec), tiny_file, workers=0, restart=True).dataset.version == "1.1.0"


def test_a_foreign_target_is_refused(fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path) -> None:
    target = tmp_path / "notes.h5"
    target.write_text("precious")
    with pytest.raises(DataError, match="not an HDF5 file"):
        collect(make_job(tiny_spec), target, workers=0)
    assert target.read_text() == "precious"


def interrupt_after(blocks: int) -> Callable[[Progress], None]:
    def tell(progress: Progress) -> None:
        if progress.done_blocks - progress.resumed_blocks == blocks:
            raise KeyboardInterrupt

    return tell


def interrupted(spec: DatasetSpec, target: Path, blocks: int) -> Path:
    """`target` after a collection that was stopped when so many blocks were done."""
    with pytest.raises(KeyboardInterrupt):
        collect(make_job(spec), target, workers=0, on_progress=interrupt_after(blocks))
    return target


def test_an_interrupted_collection_goes_on(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    whole = collect(make_job(tiny_spec), tmp_path / "whole.h5", workers=0).dataset
    for _ in range(2):
        target = interrupted(tiny_spec, tmp_path / "x.h5", 5)
    assert not target.exists()
    parts = sorted((PartsFolder(target).path / "blocks").iterdir())
    assert len(parts) == 10
    parts[3].write_bytes(parts[3].read_bytes()[:-50])
    seen: list[Progress] = []
    done = collect(make_job(tiny_spec), target, workers=0, on_progress=seen.append)
    assert (seen[0].resumed_blocks, seen[0].damaged_blocks, seen[0].num_blocks) == (9, 1, 22)
    assert len(seen) == 1 + 22 - 9
    assert seen[-1].done_steps == seen[-1].num_steps == 2 * 20 * 5
    assert done.resumed_blocks == 9
    assert done.dataset.content_hash == whole.content_hash
    assert done.dataset.tasks.ref_random.tolist() == whole.tasks.ref_random.tolist()
    assert done.dataset.tta["default"].content_hash == whole.tta["default"].content_hash


def test_parts_of_other_rates_are_made_again_and_told_apart(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    """Rung 1 acts in medium and history at another level: its hash or its progress differ."""
    target = interrupted(tiny_spec, tmp_path / "x.h5", 4)
    names = {path.stem for path in (PartsFolder(target).path / "blocks").iterdir()}
    assert names == {"forward-random-0", "forward-random-1", "forward-medium-0", "forward-medium-1"}
    fakes(0.45)
    seen: list[Progress] = []
    collect(make_job(tiny_spec), target, workers=0, on_progress=seen.append)
    found = (seen[0].resumed_blocks, seen[0].damaged_blocks, seen[0].outdated_blocks)
    assert found == (2, 0, 2)


def test_parts_of_another_spec_are_refused(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    target = interrupted(tiny_spec, tmp_path / "x.h5", 5)
    other = msgspec.structs.replace(tiny_spec, horizon=6)
    with pytest.raises(DataError, match="horizon 5 -> 6"):
        collect(make_job(other), target, workers=0)
    assert collect(make_job(other), target, workers=0, restart=True).dataset.num_steps == 32 * 6


def test_parts_of_another_mujoco_are_refused(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = interrupted(tiny_spec, tmp_path / "x.h5", 1)
    real = provenance.packages()
    monkeypatch.setattr(provenance, "packages", lambda: real | {"mujoco": "9.9.9"})
    with pytest.raises(DataError, match=r'versions\.mujoco .* -> "9\.9\.9"'):
        collect(make_job(tiny_spec), target, workers=0)


def test_a_second_collector_is_refused(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    """Another one is another thread here: whoever holds a file may hold it again."""
    target, job = tmp_path / "x.h5", make_job(tiny_spec)
    with PartsFolder(target).locked(), ThreadPoolExecutor(1) as other:
        refused = other.submit(collect, job, target, workers=0).exception()
    assert isinstance(refused, BusyError) and refused.exit_code == 4
    assert str(os.getpid()) in refused.message() and "finished blocks are kept" in refused.hint


def test_a_cut_out_is_not_the_finished_file(tiny_file: Path, tiny_spec: DatasetSpec) -> None:
    from mpdt.data.slices.cut import Cut, cut_file

    target = tiny_file.with_name("cut.h5")
    cut_file(open_dataset(tiny_file), Cut(quality="expert"), target)
    with pytest.raises(DataError, match="cut out"):
        find_finished(make_job(tiny_spec), target)


def test_a_file_of_other_behaviour_weights_is_not_the_finished_file(
    tiny_file: Path, tiny_spec: DatasetSpec
) -> None:
    from dataclasses import replace

    job = make_job(tiny_spec)
    assert find_finished(job, tiny_file) is not None
    retrained = [replace(policy, hash=bytes(32)) for policy in job.policies]
    other = replace(job, ladder=SimpleNamespace(policies=lambda tasks: retrained))
    with pytest.raises(DataError, match="other behaviour weights"):
        find_finished(other, tiny_file)
