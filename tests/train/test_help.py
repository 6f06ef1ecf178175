"""Help, completions and JSON of mpdt-train have the look of mpdt-data's."""

from __future__ import annotations

import json
import re
import subprocess

import pytest

from mpdt.train.cli import main
from mpdt.train.options import COMMANDS, EVALUATE_POLICY

VERBS = [name for name in COMMANDS if name != EVALUATE_POLICY]
Capture = pytest.CaptureFixture[str]


def call(*words: str) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code


@pytest.mark.parametrize("verb", [*VERBS, EVALUATE_POLICY])
def test_help_has_three_examples(verb: str, capsys: Capture) -> None:
    words = [*verb.split(), "theirs:act"] if verb == EVALUATE_POLICY else [verb]
    assert call(*words, "-h") == 0
    examples = re.findall(r"^  (mpdt-train \S.*)$", capsys.readouterr().out, re.MULTILINE)
    assert len(examples) == 3
    start = "mpdt-train --data" if verb == "run" else f"mpdt-train {verb}"
    assert all(line.startswith(start) for line in examples)


def test_help_without_a_verb_lists_them_all_and_the_options_of_a_run(capsys: Capture) -> None:
    assert call("-h") == 0
    text = capsys.readouterr().out
    listed = re.findall(r"^  (\S+(?: --policy)?)  +[A-Z]", text, re.MULTILINE)
    assert listed == list(COMMANDS) and "--time-limit-s FLOAT" in text


@pytest.mark.parametrize("verb", [*VERBS, EVALUATE_POLICY])
def test_every_verb_takes_json(verb: str) -> None:
    assert "json" in COMMANDS[verb].__dataclass_fields__


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completions_know_every_verb(shell: str, capsys: Capture) -> None:
    assert call("completion", shell) == 0
    script = capsys.readouterr().out
    assert all(verb in script for verb in VERBS) and "time-limit-s" in script
    if shell == "bash":
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_a_study_as_json_is_one_document(tmp_path: object, capsys: Capture) -> None:
    words = ("study", "one-block", "--only", "cheetah_vel.MPDT-ones.s0", "--dry-run", "--json")
    assert call(*words, "--data-dir", str(tmp_path), "--results-dir", str(tmp_path)) == 0
    (one,) = json.loads(capsys.readouterr().out)
    assert one["cell"] == "cheetah_vel.MPDT-ones.s0" and one["state"] and one["note"]
