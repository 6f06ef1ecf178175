"""What a card says of the tiny file of the fake simulator, by hand.

Two tasks, 4 episodes per quality of 5 steps: medium returns 2.5, expert 5, history 0, 2.5 and 5.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.card import figures
from mpdt.data.card.facts import Facts, Group, commands
from mpdt.data.cli import main
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError


@pytest.fixture
def facts(tiny_file: Path) -> Facts:
    return Facts.of(open_dataset(tiny_file))


def test_groups_of_a_task(facts: Facts) -> None:
    forward = facts.tasks[0]
    assert (forward.name, forward.role, forward.episodes) == ("forward", "both", 16)
    assert facts.qualities == ["random", "medium", "expert", "history"]
    medium = forward.groups["medium"]
    assert (medium.mean, medium.error, medium.success) == (2.5, 0.0, None)
    low, high = (forward.references[name].mean for name in ("random", "expert"))
    assert forward.level(2.5) == (2.5 - low) / (high - low)
    assert facts.num_steps == 2 * 16 * 5


def test_the_typical_episode_is_the_median() -> None:
    """Returns 9 1 5 7 of episodes 10 to 13: the lower of the two in the middle is 5."""
    zeros = np.zeros(4)
    group = Group("expert", np.arange(10, 14), np.array([9.0, 1, 5, 7]), zeros.astype(int), zeros,
                  None)  # fmt: skip
    assert group.typical() == 12
    assert group.error == pytest.approx(math.sqrt((3.5**2 + 4.5**2 + 0.5**2 + 1.5**2) / 3) / 2)


def test_a_slice_has_fewer(tiny_file: Path) -> None:
    expert = Facts.of(open_dataset(tiny_file), "expert")
    assert expert.qualities == ["expert"] and len(expert.ids) == 8


def test_histograms_ladders_and_lengths(facts: Facts) -> None:
    """All expert episodes return 5: one bin of 100 %. The ladder goes 0, 2.5, 5."""
    task = facts.tasks[0]
    marks = {mark.key: mark for mark in figures.returns_chart(task).marks}
    assert marks["expert"].points[:, 1].max() == 100.0
    ladder = figures.ladder_chart(task)
    assert ladder is not None
    line = next(mark for mark in ladder.marks if mark.kind == "line")
    assert line.points.tolist() == [[0, 0], [0.5, 2.5], [1, 5]]
    dots = {m.key: m.points[0].tolist() for m in ladder.marks if m.kind == "dots"}
    assert dots["medium"] == [0.5, 2.5] and dots["expert"] == [1.0, 5.0]
    assert figures.lengths_chart(facts) is None  # all have 5 steps
    assert len(figures.action_charts(facts)) == 6


def test_overviews_split_many_rows(facts: Facts, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "ROWS", 1)
    first, second = figures.overviews(facts)
    assert (first.row_names, second.row_names) == (("forward",), ("backward",))
    assert first.x == second.x


def test_no_history_no_ladder(tiny_file: Path) -> None:
    """Nor one of imported episodes, whose progress is unknown."""
    expert = Facts.of(open_dataset(tiny_file), "expert")
    data = open_dataset(tiny_file)
    unknown = replace(data.episodes, progress=np.full(data.num_episodes, -1, np.float32))
    for facts in (expert, Facts.of(replace(data, episodes=unknown))):
        assert figures.ladder_chart(facts.tasks[0]) is None and figures.ladders_chart(facts) is None


def test_commands_make_the_same_episodes_again(tiny_file: Path) -> None:
    """What a cut-out's card says, typed, gives the cut-out's content hash."""
    words = ["--quality", "expert", "--episodes", "2", "--tasks", "forward", "-o", "few.h5", "-q"]
    assert main(["split", "tiny.h5", *words]) == 0
    few = open_dataset(Path("few.h5"))
    collect, split = commands(few, None, is_locked=False)
    assert collect == "mpdt-data collect tiny"
    options = ["--episodes 2", "--quality expert", "--tasks forward", "-o few.h5"]
    assert split == f"mpdt-data split tiny.h5 {' '.join(options)}"
    Path("few.h5").unlink()
    assert main(split.split()[1:]) == 0
    assert open_dataset(Path("few.h5")).content_hash == few.content_hash


def test_commands_of_a_locked_file_and_of_a_slice(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    assert commands(data, None, is_locked=True) == ["mpdt-data collect tiny --locked"]
    first, told, show = commands(data, "expert", is_locked=False)
    assert first == "mpdt-data collect tiny" and show == "mpdt-data show tiny.h5:expert"
    assert told.startswith("# slice expert: ")


@pytest.mark.parametrize(
    ("step", "line"),
    [
        ({"verb": "split", "rule": {"tasks": ["a;b", "c"], "progress": [0, 0.3], "role": "train",
                                    "slice": "s"}},
         "mpdt-data split tiny.h5:s --tasks 'a;b,c' --progress 0:0.3 --train -o 'x y.h5'"),
        ({"verb": "x\nrm -rf ~", "rule": {"k": "v\nw"}, "from": ["12345678ab"]},
         "# x rm -rf ~ k v w of 12345678 -> x y.h5"),
        ({"verb": "split", "rule": {"progress": 7}}, "# split progress 7 of -> x y.h5"),
        ({"verb": "merge", "rule": [1]}, "# merge [1] of -> x y.h5"),
    ],
)  # fmt: skip
def test_steps_of_a_lineage_can_be_pasted(
    tiny_file: Path, step: dict[str, object], line: str
) -> None:
    """Names are quoted, and what is no command stays behind its # on one line."""
    data = replace(open_dataset(tiny_file), lineage=(step,), path=Path("x y.h5"))
    assert commands(data, None, is_locked=False)[1] == line


def test_an_empty_slice_has_no_card(tiny_file: Path) -> None:
    data = replace(open_dataset(tiny_file), slices={"none": np.zeros(0, np.int64)})
    with pytest.raises(DataError, match=r"tiny\.h5:none: no episodes"):
        Facts.of(data, "none")
