"""`mpdt-train methods`: all of them, and what they read as the tables will say it."""

from __future__ import annotations

import json

import pytest

from mpdt.train.cli import main
from mpdt.train.run.catalogue import catalogue
from mpdt.train.run.methods import METHODS


def told(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as stop:
        main(["methods", *words])
    assert stop.value.code == 0
    return capsys.readouterr().out


def test_every_method_has_a_sentence_and_a_paper(capsys: pytest.CaptureFixture[str]) -> None:
    found = catalogue()
    assert [one.name for one in found] == list(METHODS)
    assert all(one.sentence and one.paper and not one.sentence.endswith(".") for one in found)
    text = told(capsys)
    assert all(f"\n{name} " in text for name in METHODS)
    assert json.loads(told(capsys, "--json"))[0]["name"] == "MPDT"


def test_what_is_read_follows_the_settings() -> None:
    reads = {one.name: one.reads for one in catalogue()}
    assert reads["Soft-Prompt"] == reads["MT-ORL"] == "nothing"
    assert reads["Soft-Prompt-TTA"].startswith("X")
    assert reads["Prompt-DT-infer"] == "X+rewards"
    assert reads["MT-BC-FT"] == "labelled steps, nothing"
    assert "demonstration" not in "".join(reads.values()), "one of a training task is shown"
