"""Validation slices on the small collected file: 2 tasks x 4 episodes of each of 4 qualities."""

import shutil

import numpy as np
import pytest

from mpdt.data.cli import main
from mpdt.data.slices.cut import Cut, choose
from mpdt.data.slices.held_out import held_out
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, UsageError


@pytest.fixture
def data(tiny_file):
    return open_dataset(tiny_file)


@pytest.mark.parametrize(("share", "count"), [(0.01, 1), (0.25, 1), (0.4, 2), (0.5, 2), (0.99, 3)])
def test_of_each_task_and_quality_some_and_never_all(data, share, count):
    ids = choose(data, Cut(validation=share))
    groups = [(i // 16, i % 16 // 4) for i in ids.tolist()]
    assert groups == sorted([(task, q) for task in (0, 1) for q in range(4)] * count)


def test_few_episodes_and_those_held_out_are_two_ends_of_one_order(data):
    few = choose(data, Cut(episodes=1, quality="expert"))
    held = choose(data, Cut(validation=0.75, quality="expert"))
    assert sorted([*few, *held]) == choose(data, Cut(quality="expert")).tolist()


def test_whole_tasks_and_whole_goals(data):
    ids = choose(data, Cut(validation=0.1, by="task"))
    assert {i // 16 for i in ids.tolist()} in ({0}, {1}) and len(ids) == 16
    with pytest.raises(DataError, match="every task has one goal"):
        choose(data, Cut(validation=0.1, by="goal"))
    goals = np.arange(32) % 4  # as if each task had four, one for each episode of a quality
    data.episodes.goal[:] = goals
    object.__setattr__(data.goals, "values", np.arange(4.0)[:, None])
    object.__setattr__(data.goals, "dims", np.ones(4, np.int32))
    ids = choose(data, Cut(validation=0.25, by="goal"))
    assert len(ids) == 8 and len(set(goals[ids])) == 1


@pytest.mark.parametrize("by", ["episode", "task"])
def test_tasks_that_are_only_tested_on_are_never_touched(data, by):
    data.tasks.roles[:] = [1, 0]
    if by == "task":
        with pytest.raises(DataError, match="one task has all the episodes"):
            choose(data, Cut(validation=0.5, by=by))
        return
    assert (choose(data, Cut(validation=0.5, by=by)) >= 16).all()


def test_on_the_command_line(tiny_file, tmp_path, capsys):
    path = shutil.copy(tiny_file, tmp_path / "f.h5")
    assert main(["split", str(path), "--validation", "0.25"]) == 0
    assert "f.h5:validation   8 episodes" in capsys.readouterr().out
    after = open_dataset(path)
    assert after.slice_rules["validation"] == {"validation": 0.25}
    assert after.content_hash == open_dataset(tiny_file).content_hash
    assert verify(path, only=["claims", "leak"]).count("fail") == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--by", "task"], "--by says how --validation"), (["--validation", "1"], "below 1"),
     (["--validation", "0.1", "--per-task"], "--validation adds a slice")],
)  # fmt: skip
def test_refused(tiny_file, capsys, words, said):
    assert main(["split", str(tiny_file), *words]) == 2
    assert said in capsys.readouterr().err


def test_an_unknown_way(data):
    with pytest.raises(UsageError, match="did you mean 'goal'"):
        held_out(data, np.arange(4), 0.5, "goals")
