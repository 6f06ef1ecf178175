"""The real thing, small: MuJoCo, the shipped network, spawned workers, one hash."""

from __future__ import annotations

from pathlib import Path

import h5py
import msgspec
import numpy as np
import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block
from mpdt.data.collect.runner import BlockRunner
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts
from mpdt.data.spec.smoke import smoke
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.verify import verify
from mpdt.seeding import SeedKey


def small_spec() -> DatasetSpec:
    return msgspec.structs.replace(
        smoke(load_catalog(Path(__file__).parents[3] / "datasets.yaml").get("cheetah_dir")),
        horizon=30, episodes=EpisodeCounts(random=3, expert=3, history=2), block=2, reference=1,
    )  # fmt: skip


def test_one_worker_equals_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hashes = set()
    for workers in (1, 2):
        data = collect(make_job(small_spec()), tmp_path / f"{workers}.h5", workers=workers).dataset
        hashes.add((data.content_hash, data.tta["default"].content_hash))
    assert len(hashes) == 1
    replay(tmp_path / "1.h5")
    replay_by_workers(tmp_path / "1.h5", monkeypatch)


def replay_by_workers(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes find the one wrong reward of the second task that this process finds."""
    damaged = open_dataset(path).num_episodes - 2
    with h5py.File(path, "r+") as file:
        file["steps/rewards"][file["episodes/start"][damaged] + 3] += 1.0
    monkeypatch.setattr("mpdt.data.verify.replay.ROWS", 4)
    told: dict[int, list[str]] = {0: [], 2: []}
    found = []
    for workers, said in told.items():
        report = verify(path, only=["replay"], replay="all", workers=workers, say=said.append)
        found.append(report.findings)
        monkeypatch.setattr("mpdt.data.verify.replay.WORTH_IT_S", 0.0)
    assert found[0] == found[1] and found[0][0].episodes == (damaged,)
    assert "other rewards when simulated again" in found[0][0].text
    steps = [said[-1].partition(" in ")[0] for said in told.values()]
    assert steps[0] == steps[1] != "" and told[2][-1].endswith("steps/s")


def replay(path: Path) -> None:
    """Stored actions from the stored seed give the stored observations and rewards, bit for bit."""
    data, family = open_dataset(path), get_family("cheetah_dir")
    for i in (0, 4, data.num_episodes - 1):
        episode = data.episode(i)
        key = SeedKey(data.spec["seed"], *episode.seed_key)
        env = make_batch(family, [family.tasks[episode.task]], {})
        observations = [env.reset([key], [episode.goal])[0]]
        for action, reward in zip(episode.actions, episode.rewards, strict=True):
            result = env.step(action[None])
            observations.append(result.observations[0])
            assert np.float32(result.rewards[0]) == reward
        assert np.array(observations, np.float32).tobytes() == episode.observations.tobytes()


def test_a_short_block_acts_like_the_head_of_a_full_one(tmp_path: Path) -> None:
    """Row 0 of a block of one row equals row 0 of a block of two, network and contacts included."""
    job = make_job(small_spec())
    plan, runner = job.plan, BlockRunner(job, PartsFolder(tmp_path / "x.h5"))
    (full, *_) = plan.of_kind("episodes", "expert")
    assert full.rows == plan.width == 2
    short = Block(**{**vars(full), "rows": 1})
    left, right = runner.simulate(full)[0], runner.simulate(short)[0]
    assert left.observations.tobytes() == right.observations.tobytes()
    assert left.actions.tobytes() == right.actions.tobytes()
