"""A family of one's own, from a collection to what is done with its file where it is not known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from own_families import TASKS, forgotten, line

import mpdt
from mpdt.data.collect.collect import collect, describe_plan
from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.exchange import formats
from mpdt.data.exchange.incoming import store
from mpdt.data.exchange.selection import Selection
from mpdt.data.sim.calibrate import calibrate
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.slices.merge import check_kin
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts, TtaRule
from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, SpecError

MODULE = "from own_families import line\nfamily = line\n"


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


def spec(**changes: Any) -> DatasetSpec:
    fields: dict[str, Any] = {
        "name": "mine", "version": "1.0.0", "family": "line", "horizon": 8, "seed": 3, "block": 4,
        "behaviour": Behaviour(script="there", rungs=3),
        "episodes": EpisodeCounts(random=6, expert=5, history=3),
        "tta": {"default": TtaRule(episodes=3, action_scale=2.0)}, "reference": 3,
        "license": "CC0-1.0",
    }  # fmt: skip
    return DatasetSpec(**(fields | changes))


def made(folder: Path, name: str = "mine.h5", workers: int = 0, **changes: Any) -> Any:
    return collect(make_job(spec(**changes)), folder / name, workers=workers).dataset


def test_all_that_the_seven_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mpdt.register_family(line(hidden_columns=(1,), has_success=True))
    data = made(tmp_path)
    assert data.tasks.names == ("left", "right", "far") and data.num_episodes == 3 * 14
    assert data.definition["name"] == "line" and data.definition["tasks"][2]["goal"] == [4.0]
    assert (data.steps.observations[:, 1] == 0).all()
    assert abs(data.tta["default"].actions).max() > 1  # as drawn; the simulator clipped them
    best = data.select(task="right", quality="expert")
    assert data.episodes.success[best].all() and data.episodes.returns[best].mean() > -4
    report = verify(data.path, replay="all")
    assert {finding.id: finding.outcome.value for finding in report.findings if
            finding.outcome.value not in ("PASS", "SKIP")} == {}  # fmt: skip
    FAMILIES.pop("line")
    alone = mpdt.open(data.path)
    assert alone.tasks.indices == (0, 1, 2) and not alone.contract().simulates
    outcome = {finding.id: finding for finding in verify(data.path).findings}
    assert outcome["replay"].outcome.value == "WARN" and "is not here" in outcome["replay"].text
    assert verify(data.path, replay="all").count(Outcome.FAIL) == 1
    some = cut_file(alone, Cut(quality="expert"), tmp_path / "some.h5")
    assert some.definition == alone.definition and some.tasks.envs == alone.tasks.envs
    batch = mpdt.windows(some, window=4, per_task=2).batch(0)
    assert batch.observations.shape == (2, 2, 4, 2)


def test_medium_is_calibrated_for_options_and_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mpdt.register_family(line())
    wanted = spec(episodes=EpisodeCounts(medium=8), tta={}, tasks=("right",))
    with pytest.raises(SpecError, match="'right' has no calibrated mixing rate"):
        make_job(wanted)
    path = calibrate(wanted)
    assert path.name == "line.calibration.json"
    data = collect(make_job(wanted), tmp_path / "mine.h5", workers=0).dataset
    level = data.policy_infos()[1].level
    assert 0.4 <= level <= 0.6 and data.num_episodes == 8
    with pytest.raises(SpecError, match="calibrated with other options"):
        make_job(msgspec.structs.replace(wanted, env={"ends": True}))
    mpdt.register_family(line(version="1.1.0"))
    with pytest.raises(SpecError, match="calibrated with another script"):
        make_job(wanted)


def test_an_export_comes_back_where_the_family_is_not_known(tmp_path: Path) -> None:
    mpdt.register_family(line())
    data = made(tmp_path)
    mpdt.register_family(line(return_scale=11.0))
    with pytest.raises(DataError, match="not made for one file: definition"):
        check_kin(data, made(tmp_path, "other.h5"))
    FAMILIES.pop("line")
    alone = mpdt.open(data.path)
    formats.write("npz", Selection(alone, np.arange(data.num_episodes), ""), tmp_path / "out")
    found = formats.read("npz", [tmp_path / "out"], None, "mine")
    back = store(found, tmp_path / "back.h5", standard_additions)
    assert back.content_hash == data.content_hash and back.definition == data.definition
    for format in ("parquet", "lerobot", "minari"):
        formats.write(format, Selection(alone, np.arange(4), ""), tmp_path / format)


@pytest.mark.slow
def test_workers_know_a_family_of_a_module_beside_the_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "theirs.py").write_text(MODULE)
    (tmp_path / "datasets.yaml").write_text(
        "schema: 1\nfamilies:\n  line: {module: 'theirs:family'}\ndatasets: {}\n"
    )
    monkeypatch.chdir(tmp_path)
    found = []
    for workers in (0, 2):
        (tmp_path / str(workers)).mkdir()
        found.append(made(tmp_path / str(workers), workers=workers).content_hash)
    assert found[0] == found[1]


def test_another_definition_is_other_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a finished file nor parts are taken for those of a family that has changed."""
    monkeypatch.chdir(tmp_path)
    mpdt.register_family(line(about="A"))
    target, few = tmp_path / "mine.h5", {"episodes": EpisodeCounts(random=4), "tta": {}}
    job = make_job(spec(**few))
    assert collect(job, target, workers=0).is_new
    mpdt.register_family(line(about="B"))
    assert not collect(make_job(spec(**few)), target, workers=0).is_new
    moved = (*TASKS[:2], mpdt.Task("far", 2, "test", (5.0,)))
    mpdt.register_family(line(tasks=moved))
    with pytest.raises(DataError, match=r"another definition of line: task 2 .far test \[4.0\]"):
        collect(make_job(spec(**few)), target, workers=0)
    (told,) = verify(target, only=["replay"]).findings
    assert told.outcome is Outcome.FAIL
    assert told.text.startswith("stopped after 2 episodes: line, far: another goal")
    folder = PartsFolder(tmp_path / "next.h5")
    with folder.locked():
        folder.agree(describe_plan(job.plan))
        (folder.path / "blocks/left.npz").write_bytes(b"")
    with pytest.raises(DataError, match=r"made for another plan: definition.task 2"):
        collect(make_job(spec(**few)), folder.target, workers=0)
