"""Statistics against numbers worked out by hand, and against numpy on everything at once."""

import h5py
import numpy as np
import pytest
from makers import make_episode, make_header, source_of

from mpdt.data.episode import Episode
from mpdt.data.slices.stats import compute_stats
from mpdt.data.store.amend import add_slice
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.seal import seal
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import (
    Additions,
    Slice,
    write_file,
    write_stats,
)
from mpdt.errors import DataError, UsageError


def episode(task: int, row: int, observations, rewards) -> Episode:
    length = len(rewards)
    return make_episode(
        length, task=task, row=row, observations=np.array(observations, np.float32),
        actions=np.full((length, 1), 0.1, np.float32), rewards=np.array(rewards, np.float32),
    )  # fmt: skip


def write(path, episodes, roles, finish=None):
    rows = [TaskRow(f"t{i}", i, role, {}) for i, role in enumerate(roles)]
    header = make_header(episodes, rows, family="made-up")
    return write_file(path, header, source_of(episodes), finish=finish)


@pytest.fixture
def small(tmp_path):
    """Three tasks: train, test, both. The test task's numbers are far away."""
    return write(
        tmp_path / "a.h5",
        [
            episode(0, 0, [[0, 7], [2, 7]], [1]),
            episode(0, 1, [[4, 7], [6, 7], [8, 7]], [2, 3]),
            episode(1, 0, [[1e6, 1e6], [1e6, 1e6]], [1e6]),
            episode(2, 0, [[10, 7], [22, 7]], [6]),
        ],
        ("train", "test", "both"),
    )


def test_numbers_by_hand(small):
    """Column 0 of the observations: 0 2 4 6 8 10 22, sum 52, squares 704.

    mean 52/7; variance 704/7 - (52/7)^2; the quantile q lies at position 6q: 0.1 -> 0.6 between
    0 and 2 = 1.2; 0.5 -> 6; 0.9 -> 5.4 between 10 and 22 = 14.8; 0.99 -> 5.94 = 21.28.
    """
    stats = compute_stats(small)
    table = {name: values[0] for name, values in stats.fields["observations"].items()}
    assert table["count"] == 7
    assert table["mean"] == pytest.approx(52 / 7)
    assert table["std"] == pytest.approx((704 / 7 - (52 / 7) ** 2) ** 0.5)
    assert (table["min"], table["q50"], table["max"]) == (0, 6, 22)
    assert table["q01"] == pytest.approx(0.12)
    assert table["q10"] == pytest.approx(1.2)
    assert table["q90"] == pytest.approx(14.8)
    assert table["q99"] == pytest.approx(21.28)
    rewards = {name: values[0] for name, values in stats.fields["rewards"].items()}
    assert (rewards["count"], rewards["mean"], rewards["max"]) == (4, 3, 6)
    returns = {name: values[0] for name, values in stats.fields["returns"].items()}
    assert (returns["count"], returns["min"], returns["q50"], returns["max"]) == (3, 1, 5, 6)
    assert returns["mean"] == 4


def test_test_tasks_are_not_seen(small):
    stats = compute_stats(small)
    assert stats.tasks_seen == (0, 2)
    assert max(table["max"].max() for table in stats.fields.values()) == 22


def test_constant_columns_are_named(small):
    assert compute_stats(small).constant == {
        "observations": (1,), "actions": (0,), "rewards": (), "returns": (),
    }  # fmt: skip


def test_equal_numbers_have_no_spread_at_all(tmp_path):
    """Three returns of 1e8 + 0.1: their sum in float64 is rounded, and so was its third."""
    same = [[0, 0], [0, 0], [0, 0]]
    made = write(tmp_path / "a.h5", [episode(0, i, same, [1e8, 0.1]) for i in range(3)], ("train",))
    assert len(set(made.episodes.returns)) == 1
    assert made.episodes.returns.mean() != made.episodes.returns[0]
    returns = compute_stats(made).fields["returns"]
    assert (returns["mean"][0], returns["std"][0]) == (made.episodes.returns[0], 0.0)


def test_a_slice_narrows(small):
    ids = small.select(task=["t0", "t1"])
    stats = compute_stats(add_slice(small.path, "some", ids, {}), slice="some")
    assert stats.slice == "some"
    assert stats.tasks_seen == (0,)
    assert stats.fields["observations"]["max"].tolist() == [8, 7]
    assert stats.fields["rewards"]["count"].tolist() == [3]


def test_nothing_to_look_at(small):
    added = add_slice(small.path, "test", small.select(task="t1"), {})
    with pytest.raises(DataError, match=r"a\.h5:test: no episode of a training task"):
        compute_stats(added, slice="test")
    with pytest.raises(UsageError, match="unknown slice"):
        compute_stats(small, slice="none")


def test_written_and_read_back(small):
    with h5py.File(small.path, "r+") as file:
        write_stats(file, compute_stats(small))
        seal(file)
    again = open_dataset(small.path)
    assert again.stats["observations"]["max"].tolist() == [22, 7]
    assert again.stats_info.tasks_seen == (0, 2)
    assert again.stats_info.constant["observations"] == (1,)
    assert again.content_hash == small.content_hash


def test_inside_the_writers_finish(tmp_path):
    made = write(tmp_path / "b.h5", [episode(0, 0, [[1, 2], [3, 4]], [5])], ("train",),
                 finish=lambda d: Additions({"all": Slice(d.select(), {})},
                                            compute_stats(d)))  # fmt: skip
    assert made.stats["observations"]["mean"].tolist() == [2, 3]
    assert made.stats["returns"]["mean"].tolist() == [5]


def test_they_are_the_numbers_of_numpy_on_everything(tmp_path):
    """The slow twin: gather all rows of the training tasks in RAM and ask numpy once."""
    rng = np.random.default_rng(0)
    lengths = (1, 2, 30, 7, 90)
    tasks = (0, 0, 1, 2, 2)
    episodes = [
        episode(task, row, rng.normal(size=(n + 1, 2)) * [1, 100], rng.normal(size=n))
        for row, (task, n) in enumerate(zip(tasks, lengths, strict=True))
    ]
    made = write(tmp_path / "a.h5", episodes, ("train", "test", "train"))
    kept = [e for e in episodes if e.task != 1]
    rows = np.concatenate([e.observations for e in kept]).astype(np.float64)
    wanted = {"mean": rows.mean(0), "std": rows.std(0), "min": rows.min(0), "max": rows.max(0),
              "q01": np.quantile(rows, 0.01, 0), "q90": np.quantile(rows, 0.9, 0)}  # fmt: skip
    found = compute_stats(made).fields["observations"]
    for name, values in wanted.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12)
