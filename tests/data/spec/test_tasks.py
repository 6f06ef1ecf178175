"""Every number here is copied from the sources by hand, not computed by the code under test."""

import pytest

from mpdt.data.spec.rules import family_problems
from mpdt.data.spec.tasks import FAMILIES, get_family
from mpdt.errors import UsageError


def test_family_ids_are_a_registry():
    assert {name: family.id for name, family in FAMILIES.items()} == {
        "cheetah_dir": 0, "cheetah_vel": 1, "ant_dir": 2, "ml10": 3, "ml45": 4, "mt10": 5,
        "mt50": 6,
    }  # fmt: skip


# D, A, horizon, step_s, tasks, train, test, both, target, scale
@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("cheetah_dir", (20, 6, 200, 0.05, 2, 0, 0, 2, 1500, 1000)),
        ("cheetah_vel", (20, 6, 200, 0.05, 40, 35, 5, 0, 0, 500)),
        ("ant_dir", (27, 8, 200, 0.05, 50, 45, 5, 0, 500, 500)),
        ("ml10", (39, 4, 500, 0.0125, 15, 10, 5, 0, 4500, 1000)),
        ("ml45", (39, 4, 500, 0.0125, 50, 45, 5, 0, 4500, 1000)),
        ("mt10", (39, 4, 500, 0.0125, 10, 0, 0, 10, 4500, 1000)),
        ("mt50", (39, 4, 500, 0.0125, 50, 0, 0, 50, 4500, 1000)),
    ],
)
def test_published_numbers(name, numbers):
    family = get_family(name)
    roles = [task.role for task in family.tasks]
    assert (
        family.observation_size, family.action_size, family.horizon, family.step_s, len(roles),
        roles.count("train"), roles.count("test"), roles.count("both"),
        family.return_target, family.return_scale,
    ) == numbers  # fmt: skip
    assert (family.action_low, family.action_high) == (-1.0, 1.0)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
def test_tables_are_sound(family):
    assert [task.index for task in family.tasks] == list(range(len(family.tasks)))
    assert len({task.name for task in family.tasks}) == len(family.tasks)
    assert len(family.columns) == len(set(family.columns)) == family.observation_size
    assert all(column.endswith("]") for column in family.columns)
    goal_sizes = {len(task.goal) for task in family.tasks}
    assert goal_sizes == ({0} if family.draws_goals else {1})
    assert family.has_success == family.draws_goals == ("metaworld" in family.packages)
    assert family_problems(family) == []  # what one's own are held to


def test_cheetah_directions():
    rows = [(t.name, t.goal, t.role) for t in FAMILIES["cheetah_dir"].tasks]
    assert rows == [("forward", (1.0,), "both"), ("backward", (-1.0,), "both")]


def test_cheetah_speeds():
    tasks = FAMILIES["cheetah_vel"].tasks
    assert (tasks[0].goal, tasks[39].goal) == ((0.075,), (3.0,))
    tests = {t.index: t.goal[0] for t in tasks if t.role == "test"}
    assert tests == {2: 0.225, 7: 0.6, 15: 1.2, 23: 1.8, 26: 2.025}
    assert tasks[2].name == "v0.225"


def test_ant_angles():
    tasks = FAMILIES["ant_dir"].tasks
    tests = {t.index: t.goal[0] for t in tasks if t.role == "test"}
    assert tests == {
        6: 0.24543954, 17: 1.77806705, 23: 0.90417500, 30: 3.56879346, 41: 4.14190964,
    }  # fmt: skip
    assert (tasks[0].goal[0], tasks[49].goal[0]) == (1.20336059, 0.18319881)
    assert tasks[8].goal == (5.94190270,)
    assert tasks[33].goal == (0.99876725,)
    # Sum of (index + 1) * 1e8 * angle over the published list: every digit and its place count.
    assert sum(round(t.goal[0] * 1e8) * (t.index + 1) for t in tasks) == 411898905960


def test_metaworld_splits():
    ml10 = [(t.name, t.role) for t in FAMILIES["ml10"].tasks]
    assert ml10[0] == ("reach", "train")
    assert ml10[9] == ("basketball", "train")
    assert [name for name, role in ml10 if role == "test"] == [
        "drawer-open", "door-close", "shelf-place", "sweep-into", "lever-pull",
    ]  # fmt: skip
    ml45 = [t.name for t in FAMILIES["ml45"].tasks]
    assert ml45[45:] == ["bin-picking", "box-close", "hand-insert", "door-lock", "door-unlock"]
    assert (ml45[0], ml45[44]) == ("assembly", "window-close")
    mt50 = [t.name for t in FAMILIES["mt50"].tasks]
    assert set(mt50) == set(ml45)
    assert {t.name for t in FAMILIES["mt10"].tasks} | {name for name, _ in ml10} <= set(mt50)


def test_only_hidden_goal_families_hide_columns():
    hidden = {name: family.hidden_columns for name, family in FAMILIES.items()}
    assert {name for name, columns in hidden.items() if columns} == {"ml10", "ml45"}
    assert hidden["ml10"] == (36, 37, 38)
    assert FAMILIES["ml10"].columns[36:] == ("goal_x [m]", "goal_y [m]", "goal_z [m]")


def test_lookup_by_name_and_index():
    family = get_family("cheetah_dir")
    assert family.task("backward") is family.task(1) is family.tasks[1]


def test_unknown_names_get_the_nearest():
    with pytest.raises(UsageError, match=r"unknown family 'cheeta_dir' \(did you mean 'cheetah_d"):
        get_family("cheeta_dir")
    with pytest.raises(UsageError, match=r"ml10: unknown task 'reech' \(did you mean 'reach'\?\)"):
        get_family("ml10").task("reech")
