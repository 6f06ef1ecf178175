"""Which tasks and episodes are trained on, and the returns asked of them.

Rewards of the tiny file are 1 + quality code at every step: expert 3, medium 2, random 1.
Lengths of task 0: rows 0..3 -> 6 7 8 9; of task 1: 7 8 9 6.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mpdt.errors import DataError, UsageError
from mpdt.seeding import Quality, SeedKey
from mpdt.train.fit.data import load_material, return_table, sample_demonstrations


def test_auto_takes_the_expert_of_a_whole_file(tiny_file):
    material = load_material(str(tiny_file), "auto")
    assert material.quality == "expert"
    assert material.train_rows == (0, 1) and material.test_rows == (0, 1)
    # canonical order: random 2, medium 2, expert 4 of task 0, then of task 1
    assert {row: ids.tolist() for row, ids in material.episode_ids.items()} == {
        0: [4, 5, 6, 7], 1: [12, 13, 14, 15],
    }  # fmt: skip
    assert material.horizon == 9
    assert [task.name for task in material.tasks([1])] == ["backward"]


def test_auto_takes_what_a_cut_out_has(medium_file):
    assert load_material(str(medium_file), "auto").quality == "medium"


def test_all_and_slice(tiny_file):
    everything = load_material(str(tiny_file), "all")
    assert [len(ids) for ids in everything.episode_ids.values()] == [8, 8]
    few = load_material(f"{tiny_file}:few", "all")
    assert [ids.tolist() for ids in few.episode_ids.values()] == [[0], [8]]


def test_missing_quality_says_what_there_is(medium_file):
    with pytest.raises(DataError, match=r"no expert episodes of training task forward.*medium"):
        load_material(str(medium_file), "expert")


@pytest.mark.parametrize(
    ("ref", "quality", "text"),
    [
        ("{}", "exprt", r"unknown quality 'exprt' \(did you mean 'expert'\?\)"),
        ("{}:fw", "all", r"unknown slice 'fw' \(did you mean 'few'\?\)"),
    ],
)
def test_unknown_names(tiny_file, ref, quality, text):
    with pytest.raises(UsageError, match=text):
        load_material(ref.format(tiny_file), quality)


def test_random_episodes_are_found_outside_the_slice_or_missed_clearly(tiny_file, medium_file):
    ids = load_material(str(tiny_file), "expert").random_ids()
    assert {row: found.tolist() for row, found in ids.items()} == {0: [0, 1], 1: [8, 9]}
    with pytest.raises(DataError, match="no random episodes"):
        load_material(str(medium_file), "medium").random_ids()


def test_returns_per_task_by_hand(tiny_file):
    """Expert returns of task 0: 3 x (6 7 8 9) = 18 21 24 27; smallest to-go 3, largest 27."""
    table = return_table(load_material(str(tiny_file), "expert"), "task", quantile=0.5)
    assert table.low.tolist() == [3.0, 3.0]
    assert table.high.tolist() == [27.0, 27.0] and table.scale.tolist() == [27.0, 27.0]
    assert table.target.tolist() == [22.5, 22.5]


def test_family_returns_are_the_published_ones(tiny_file):
    table = return_table(load_material(str(tiny_file), "expert"), "family", quantile=0.5)
    assert table.target.tolist() == [1500.0, 1500.0]
    assert table.scale.tolist() == [1000.0, 1000.0] and table.high.tolist() == [27.0, 27.0]


def test_a_negative_family_is_asked_for_what_a_first_step_showed(tiny_file):
    """Rewards -3 a step: episode returns -18 -21 -24 -27. The largest return-to-go is -3, the
    one of a last step; asking for it at the first step is the trap."""
    material = load_material(str(tiny_file), "expert")
    steps = SimpleNamespace(rewards=-np.asarray(material.dataset.steps.rewards))
    negative = SimpleNamespace(
        dataset=SimpleNamespace(steps=steps, episodes=material.dataset.episodes),
        train_rows=(0,), episode_ids=material.episode_ids, family=material.family,
    )  # fmt: skip
    table = return_table(negative, "task", quantile=1.0)
    assert (table.low.item(), table.high.item(), table.target.item()) == (-27.0, -3.0, -18.0)
    assert table.scale.item() == 27.0


def test_a_policy_without_return_to_go_reads_no_reward(tiny_file):
    """The table has a row per task and no attribute of the steps is touched."""
    material = load_material(str(tiny_file), "expert")
    blind = SimpleNamespace(train_rows=(0, 1), family=material.family, dataset=SimpleNamespace())
    table = return_table(blind, "none", quantile=0.5)
    assert len(table) == 2 and table.pooled([7.0]).target.tolist() == [7.0]


def test_the_range_of_returns_is_kept_not_its_values(tiny_file):
    """Rewards that change sign: 1 and -4 leave returns-to-go -3 and -4; -2 and 5 leave 3 and 5."""
    material = load_material(str(tiny_file), "expert")
    toy = SimpleNamespace(
        dataset=SimpleNamespace(
            steps=SimpleNamespace(rewards=np.array([9.0, 1.0, -4.0, -2.0, 5.0])),
            episodes=SimpleNamespace(start=np.array([1, 3]), length=np.array([2, 2])),
        ),
        train_rows=(7,), episode_ids={7: np.array([0, 1])}, family=material.family,
    )  # fmt: skip
    table = return_table(toy, "task", quantile=0.0)
    assert (table.low.item(), table.high.item(), table.scale.item()) == (-4.0, 5.0, 5.0)
    assert table.target.item() == -3.0


def test_an_episode_as_long_as_a_prompt_is_shown_whole(tiny_file):
    material = load_material(str(tiny_file), "expert")
    shown = sample_demonstrations(material, 9, seed=0, each=2)
    assert shown.observations.shape[:3] == (2, 2, 9) and shown.mask.all()
    with pytest.raises(DataError, match="as long as a prompt"):
        sample_demonstrations(material, 10, seed=0)


def test_goals_are_drawn_as_the_data_drew_them(tiny_file):
    """Of four goals the last is held out: training meets 0 1 2 0, the test the last one only."""
    material = load_material(str(tiny_file), "expert")
    keys = [SeedKey(99, 0, 1, int(Quality.EVALUATION), 0, row) for row in range(4)]
    assert material.goals is None and material.one_table
    assert [material.goal_key(key, "test") for key in keys] == keys
    spec = dict(material.dataset.spec) | {"goals": {"count": 4, "held_out": 1}, "seed": 7}
    held = replace(material, dataset=replace(material.dataset, spec=spec))
    assert not held.one_table
    found = {block: [held.goal_key(key, block) for key in keys] for block in ("train", "test")}
    assert [key.row for key in found["train"]] == [0, 1, 2, 0]
    assert [key.row for key in found["test"]] == [3, 3, 3, 3]
    assert [held.num_goals(block) for block in ("train", "test")] == [3, 1]
    assert material.num_goals("test") is None
    for key in (*found["train"], *found["test"]):
        assert (key.seed, key.task, key.quality) == (7, 1, Quality.GOALS), "the data's own seed"
