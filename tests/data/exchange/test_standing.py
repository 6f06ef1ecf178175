"""An import of a known family goes all the way: references, sets, what cannot be checked.

Numbers are those of `foreign_episode` in conftest; the family's are the shipped ones.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.spec.catalog import shipped_catalog
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset

Make = Callable[..., Any]
TEST_TASK = 2  # v0.225 of cheetah_vel


@pytest.fixture
def vel(tmp_path: Path, episode: Make, dump: Make, imported: Make) -> Callable[..., Dataset]:
    """One expert episode of an unseen task, with a horizon of so many steps."""

    def read(steps: int) -> Dataset:
        dump([episode(steps)], tmp_path / f"pdt/cheetah_vel-{TEST_TASK}-expert.pkl")
        data: Dataset = imported(
            "pdt", "--from", "promptdt", "--family", "cheetah_vel", "--horizon", steps
        )
        return data

    return read


def outcomes(run: Make, capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, str]:
    capsys.readouterr()
    run("verify", "imported.h5", "--json", *words)
    checks = json.loads(capsys.readouterr().out)["checks"]
    return {one["id"]: one["outcome"] for one in checks}


def test_the_references_of_its_tasks_and_a_set_of_the_shipped_entry(
    vel: Make, run: Make, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data = vel(200)
    found = data.tasks.references[0]
    assert {found[name].source for name in ("zero", "random", "expert")} == {"shipped"}
    assert found["random"].mean < found["zero"].mean < found["expert"].mean < 0
    assert run("tta", "imported.h5", "--workers", 0, "-q") == 0
    data = open_dataset("imported.h5")
    rule = shipped_catalog().get("cheetah_vel").tta["default"]
    assert len(data.tta["default"]) == rule.episodes and data.content_hash
    assert data.tta["default"].rule["seed"] == shipped_catalog().get("cheetah_vel").seed
    told = outcomes(run, capsys)
    assert told["replay"] == "PASS", "the set, simulated again; imported episodes have no seeds"
    assert told["claims"] == "PASS" and told["tta"] == "PASS"
    # The set a second time is the set that is there; with another seed it would be another one.
    assert run("tta", "imported.h5", "--workers", 0, "-q") == 0
    assert (open_dataset("imported.h5").tta["default"].digest == data.tta["default"].digest).all()


def test_what_is_not_on_record_is_measured_into_the_file(
    vel: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    data = vel(3)
    assert np.isnan(data.tasks.ref_random).all()
    assert "no references on record at 3 steps: v0.225" in capsys.readouterr().err
    assert run("reference", "imported.h5", "--most", 2, "--workers", 0, "-q") == 0
    after = open_dataset("imported.h5")
    assert after.content_hash == data.content_hash, "episodes stay what they are"
    references = after.tasks.references[0]
    assert {references[name].source for name in ("zero", "random", "expert")} == {"local"}
    assert run("reference", "imported.h5", "--horizons", 3) == 2
    assert "a file has its own horizon" in capsys.readouterr().err


def test_a_check_with_nothing_to_check_neither_passes_nor_fails(
    vel: Make, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    vel(3)
    told = outcomes(run, capsys)
    for id in ("quality", "duplicates", "tta"):
        assert told[id] == "NONE", id
    assert told["replay"] == "WARN", "made-up numbers are of no simulator, which one step shows"
    assert outcomes(run, capsys, "--replay", "all")["replay"] == "FAIL", "asked for, and not done"
    run("verify", "imported.h5")
    text = capsys.readouterr().out
    assert "[NONE] tta         nothing to check: no sets" in text
    assert "[NONE] quality     nothing to check: no task has two of random, medium and" in text
    assert "6 passed, 3 warnings, 3 with nothing to check" in text


def test_a_family_that_makes_nothing_like_it(
    vel: Make, run: Make, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A datasets.yaml that lies here decides nothing about an import."""
    vel(3)
    (tmp_path / "datasets.yaml").write_text("schema: 1\ndatasets: {}\n")
    assert run("tta", "imported.h5", "--workers", 0, "-q", "--episodes", 1) == 0
    assert len(open_dataset("imported.h5").tta["default"]) == 1
