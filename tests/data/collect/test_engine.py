"""Collections through other engines: the same file, or one clear error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mpdt.data.collect import engine as engines
from mpdt.data.collect.collect import collect
from mpdt.data.collect.engine import NodeWorker, RayCluster, decisive_versions
from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.store.reader import open_dataset
from mpdt.errors import SimulatorError

Fakes = Callable[..., None]


def in_this_process(worker: Any, blocks: Any, address: str | None) -> Any:
    """A cluster without Ray: the worker does one block after the other, last one first."""
    return map(worker, reversed(blocks))


@pytest.mark.parametrize("shared", [True, False])
def test_a_cluster_makes_the_same_file(
    shared: bool,
    fakes: Fakes,
    tiny_spec: DatasetSpec,
    tiny_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fakes()
    monkeypatch.setattr(engines, "map_blocks_ray", in_this_process)
    cluster = RayCluster(shared_folder=shared)
    data = collect(make_job(tiny_spec), tmp_path / "x.h5", engine=cluster).dataset
    assert data.content_hash == open_dataset(tiny_file).content_hash


def test_a_worker_leaves_nothing_on_its_node(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    fakes()
    job = make_job(tiny_spec)
    plan, worker = job.plan, NodeWorker(job, None)
    finished = worker(plan.blocks[0])
    assert worker._runner is not None
    assert finished.content
    assert not list((worker._runner.folder.path / "blocks").iterdir())
    home = PartsFolder(tmp_path / "x.h5")
    with home.locked():
        path = home.part(plan.blocks[0]).path
        path.write_bytes(finished.content)
        assert len(home.part(plan.blocks[0]).load_episodes()) == plan.blocks[0].rows


def test_a_node_of_another_kind_is_refused(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fakes()
    here = decisive_versions()
    answers = iter([here, here | {"cpu": "another"}])

    def elsewhere(worker: Any, blocks: Any, address: str | None) -> Any:
        for block in blocks:
            finished = worker(block)
            finished.versions.update(next(answers, here))
            yield finished

    monkeypatch.setattr(engines, "map_blocks_ray", elsewhere)
    with pytest.raises(SimulatorError, match="cpu: a node of the cluster would make other bytes"):
        collect(make_job(tiny_spec), tmp_path / "x.h5", engine=RayCluster())
    assert not (tmp_path / "x.h5").exists()
