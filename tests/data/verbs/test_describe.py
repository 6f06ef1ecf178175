"""What show prints of the references; the tiny file's are drawn in fake_sim.py."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.reference import Reference, References
from mpdt.data.store.reader import open_dataset
from mpdt.data.verbs.describe import describe, level_table, reference_table

KNOWN = References(
    {
        "zero": Reference(0.0, 0.25, 20, None, "shipped"),
        "random": Reference(-10.0, 1.0, 40, None, "shipped"),
        "constant": Reference(2.0, 0.5, 20, None, "shipped"),
        "expert": Reference(90.0, 3.0, 80, 0.75, "local"),
    },
    (0.0, 0.0, 1.0, 0.0, 0.0, -1.0),
)


def test_references_by_hand(tiny_file: Path) -> None:
    """The largest error is 3 of a span of 100; medium earns 2.5, so (2.5 + 10) / 100."""
    data = open_dataset(tiny_file)
    data = replace(data, tasks=replace(data.tasks, references=(KNOWN, References())))
    heading, row, action = reference_table(data).splitlines()
    assert heading.split()[:5] == ["reference", "zero", "random", "constant", "expert"]
    assert row.split("  ")[0] == "forward" and "-10.0 +- 1.0" in row and "90.0 +- 3.0" in row
    assert row.split()[-5:] == ["0.75", "160", "3.0%", "shipped,", "local"]
    assert action == "constant action  0 0 1 0 0 -1"
    assert reference_table(data, names=("backward",)) == ""
    forward, backward = level_table(data).splitlines()[1:]
    assert forward.split()[2:4] == ["16", "0.0"] and "0.12" in forward
    assert backward.split()[3] == "-", "nothing is known of zero action there"


def test_roll_outs_of_another_length_have_no_level(tiny_file: Path) -> None:
    """Their level is not on record, for references are of the data's length."""
    data = open_dataset(tiny_file)
    quality = np.full_like(data.episodes.quality, QUALITY_CODES["policy"])
    levels = np.where(data.policies.tasks == 0, np.float32("nan"), np.float32(0.5))
    data = replace(
        data, tasks=replace(data.tasks, references=(KNOWN, KNOWN)),
        episodes=replace(data.episodes, quality=quality),
        policies=replace(data.policies, levels=levels),
    )  # fmt: skip
    forward, backward = (line.split() for line in level_table(data).splitlines()[1:])
    assert forward[-2] == "-" and float(backward[-2]) != 0


def test_references_as_json(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    one = References({"zero": Reference.of(np.array([1.0]))})
    data = replace(data, tasks=replace(data.tasks, references=(KNOWN, one)))
    tasks = json.loads(json.dumps(describe(data), allow_nan=False))["tasks"]
    assert tasks[0]["references"]["expert"] == {
        "mean": 90.0, "error": 3.0, "episodes": 80, "success": 0.75, "source": "local",
    }  # fmt: skip
    assert tasks[0]["constant_action"] == [0, 0, 1, 0, 0, -1]
    assert tasks[1]["references"]["zero"]["error"] is None
    assert tasks[1]["constant_action"] is None and set(tasks[1]["references"]) == {"zero"}
