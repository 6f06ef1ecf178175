"""A job travels: the policies of the block are those it was made with, wherever it arrives."""

from __future__ import annotations

import pickle
from pathlib import Path

import msgspec
import pytest

from mpdt.data.collect.job import make_job
from mpdt.data.sim.calibration import LOCAL_FILE, load_calibrations, save_calibrations
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.smoke import smoke


@pytest.mark.parametrize("name", ["cheetah_dir", "ant_dir", "ml10"])
def test_whoever_it_is_sent_to_acts_the_same(name: str) -> None:
    job = make_job(smoke(load_catalog().get(name)))
    there = pickle.loads(pickle.dumps(job))
    assert [there.actor(block) for block in there.plan.blocks] == [
        job.actor(block) for block in job.plan.blocks
    ]


def test_rates_of_the_working_folder_travel_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a node there is no such file, and here a calibration may end while a collection runs."""
    monkeypatch.chdir(tmp_path)
    spec = msgspec.structs.replace(smoke(load_catalog().get("ml10")), tasks=("reach",))
    shipped = load_calibrations()["reach", spec.horizon]
    own = msgspec.structs.replace(shipped, rate=round(shipped.rate / 2, 6))
    save_calibrations(Path(LOCAL_FILE), [own], "")
    sent = pickle.dumps(make_job(spec))
    Path(LOCAL_FILE).unlink()
    there, other = pickle.loads(sent), make_job(spec)
    medium = there.plan.of_kind("episodes", "medium")[0]
    assert there.policy(medium)[0].mix_rate == own.rate
    assert there.actor(medium) != other.actor(medium)
