"""The families under examples/: found as an installed package, sound, the same bytes everywhere."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from own_families import forgotten

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts
from mpdt.data.spec.smoke import smoke
from mpdt.data.spec.tasks import get_family
from mpdt.data.verify import family as checks
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import UsageError

HERE = Path(__file__).parents[3] / "examples/families"
PROJECT = tomllib.loads((HERE / "pyproject.toml").read_text())["project"]
NAMES = tuple(PROJECT["entry-points"]["mpdt.families"])


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """As pip leaves it: the package on the path, and its entry points beside it."""
    told = tmp_path / "site/mpdt_families-1.0.0.dist-info"
    told.mkdir(parents=True)
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: mpdt-families\nVersion: 1.0.0\n")
    points = PROJECT["entry-points"]["mpdt.families"].items()
    (told / "entry_points.txt").write_text(
        "\n".join(["[mpdt.families]", *(f"{name} = {place}" for name, place in points)])
    )
    with forgotten():
        monkeypatch.syspath_prepend(HERE)
        monkeypatch.syspath_prepend(told.parent)
        folder = tmp_path / "work"
        folder.mkdir()
        for path in (*HERE.glob("*.json"), *HERE.glob("*.yaml")):
            shutil.copy(path, folder)

        monkeypatch.chdir(folder)
        yield folder


def entry(name: str) -> DatasetSpec:
    """Of four tasks, two of them for testing, and a few episodes of every quality."""
    spec = smoke(load_catalog(Path("datasets.yaml")).get(name))
    last = len(get_family(name).tasks) - 1
    few = EpisodeCounts(random=2, expert=2, history=2)
    return msgspec.structs.replace(spec, tasks=(0, 1, last - 1, last), episodes=few)


def test_a_name_that_is_nearly_one_is_told_of() -> None:
    with pytest.raises(
        UsageError, match=r"unknown family 'point_robo' .did you mean 'point_robot'"
    ):
        get_family("point_robo")


@pytest.mark.parametrize("name", NAMES)
def test_each_keeps_the_contract(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "SECONDS", 0.002)
    monkeypatch.setattr(checks, "TASKS", 2)
    monkeypatch.setattr(checks, "ROWS", 2)
    family = get_family(name)
    assert family.module == PROJECT["entry-points"]["mpdt.families"][name]
    short = replace(family, horizon=5, scripts={})
    found = {one.id: one for one in checks.check_family(short, worker=False)}
    assert {one.outcome for one in found.values()} == {Outcome.PASS}, found


@pytest.mark.parametrize("name", ["point_robot", "pendulum_params"])
def test_collected_and_replayed(name: str, installed: Path) -> None:
    spec = entry(name)
    if name == "point_robot":  # calibrated rates are shipped beside the entry
        counts = EpisodeCounts(random=2, medium=20, expert=2, history=2)
        spec = msgspec.structs.replace(spec, episodes=counts, tasks=(0, 49), block=20)
    data = collect(make_job(spec), installed / "few.h5", workers=0).dataset
    bad = {f.id: f.text for f in verify(data.path, replay="all").findings
           if f.outcome in (Outcome.FAIL, Outcome.WARN)}  # fmt: skip
    assert not bad and len(data.tta["default"]) == (2 if name == "point_robot" else 4)
    expert = data.select(quality="expert")
    first = data.episode(int(expert[0])).actions
    assert (first != data.episode(int(expert[1])).actions).any()


def test_a_task_is_its_draw(installed: Path) -> None:
    """The stored goal says which model it was: numbers of MuJoCo's model, worked out from it."""
    from gymnasium.envs.mujoco.walker2d_v5 import Walker2dEnv

    family = get_family("walker_params")
    task = family.tasks[7]
    make: Any = family.env
    model, plain = make(task).model, Walker2dEnv().model
    assert len(task.goal) == 58 and max(map(abs, task.goal)) <= 3
    np.testing.assert_allclose(
        model.body_mass[1:], plain.body_mass[1:] * 1.5 ** np.array(task.goal[:7])
    )
    damping = plain.dof_damping[3:] * 1.3 ** np.array(task.goal[28:34])
    np.testing.assert_allclose(model.dof_damping[3:], damping)
    assert (model.dof_damping[:3] == 0).all()
    assert len({other.goal for other in family.tasks}) == 50
    with pytest.raises(ValueError, match="1 exponents more than the model has numbers"):
        make(replace(task, goal=(*task.goal, 0.0)))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_same_bytes_with_any_workers(name: str, installed: Path) -> None:
    job, hashes = make_job(entry(name)), set()
    for workers in (0, 1, 2):
        target = installed / f"{workers}.h5"
        hashes.add(collect(job, target, workers=workers).dataset.content_hash)
        outcome = {one.id: one.outcome for one in verify(target, replay="all").findings}
        assert outcome["replay"] is Outcome.PASS
    assert len(hashes) == 1
