"""A file whose family is not installed: trained on and bundled, judged by nobody; it says so."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_families import forgotten, line

import mpdt
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts, TtaRule
from mpdt.data.spec.tasks import FAMILIES
from mpdt.train.cli import main

TINY = ("--preset", "smoke", "--name", "run", "--teacher.steps", "1", "--multitask.steps", "2",
        "--adapt.windows", "2")  # fmt: skip


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


def train(*words: str) -> object:
    with pytest.raises(SystemExit) as stopped:
        main(["--data", "mine.h5", *TINY, *words])
    return stopped.value.code


@pytest.mark.slow  # the tutorial does as much; this looks at every word
def test_trained_bundled_and_not_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mpdt.register_family(line())
    spec = DatasetSpec(
        name="mine", version="1.0.0", family="line", horizon=8, seed=3, block=4, reference=3,
        behaviour=Behaviour(script="there", rungs=3), license="CC0-1.0",
        episodes=EpisodeCounts(random=4, expert=4), tta={"default": TtaRule(episodes=3)},
    )  # fmt: skip
    collect(make_job(spec), tmp_path / "mine.h5", workers=0)
    FAMILIES.pop("line")
    assert train("--adapt", "trials") == 3
    assert "the simulator of this family is not here" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
    assert train() == 0
    told = capsys.readouterr().err
    assert "not judged: the simulator of this family is not here; install the package" in told
    results = json.loads((tmp_path / "runs/run/results.json").read_text())
    methods = {row["method"]: row["mean"] for row in results["scores"] if row["task"] == "far"}
    assert methods["zero action"] is None and methods["MPDT from cross, adapted"] is None
    assert methods["expert"] is None  # smoke judges another horizon than the file's
    mpdt.register_family(line())  # now it is here: the same command judges
    policy = mpdt.load_policy("runs/run/policy", task="far", start="cross")
    assert policy.act(np.zeros(2)).shape == (1,)
    assert train("--evaluation.episodes", "1") == 0
    results = json.loads((tmp_path / "runs/run/results.json").read_text())
    assert all(row["mean"] for row in results["scores"] if row["method"] == "zero action")
