"""Round trips and refusals of the writer. The hand-made file is drawn in conftest.py."""

from __future__ import annotations

from dataclasses import fields, replace

import h5py
import numpy as np
import pytest

from mpdt.data.reference import Reference, References
from mpdt.data.store.digest import episode_digest
from mpdt.data.store.tables import Additions, Slice, Stats
from mpdt.data.store.writer import EpisodeSource, write_file
from mpdt.errors import DataError, ShapeError, UsageError

STATS = ("count", "mean", "std", "min", "max", "q01", "q10", "q50", "q90", "q99")


KNOWN = References({"random": Reference(1.5, 0.5, 8, 0.25, "local")}, (0.5,))


def stats(tasks_seen=(0, 1)) -> Stats:
    widths = {"observations": 2, "actions": 1, "rewards": 1, "returns": 1}
    tables = {f: {s: np.full(w, float(i)) for i, s in enumerate(STATS)} for f, w in widths.items()}
    return Stats(tables, "", tasks_seen, {"actions": (0,)})


def assert_same(left, right):
    for column in fields(left):
        one, other = getattr(left, column.name), getattr(right, column.name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other)
        else:
            assert one == other, column.name


def test_round_trip_of_lengths_1_2_3_1(made, kit):
    assert (made.num_episodes, made.num_steps) == (4, 7)
    for i, episode in enumerate(kit.episodes):
        assert_same(made.episode(i), episode)


def test_episode_columns_by_hand(made):
    columns = made.episodes
    assert columns.task.tolist() == [0, 0, 0, 1]
    assert columns.length.tolist() == [1, 2, 3, 1]
    assert columns.start.tolist() == [0, 1, 3, 6]
    assert columns.obs_start.tolist() == [0, 2, 5, 9]  # one more row per episode before
    assert columns.policy.tolist() == [0, 0, 1, 2]  # (task, hash): the last is task 1's uniform
    assert columns.goal.tolist() == [0, 0, 0, 1]
    assert columns.quality.tolist() == [0, 0, 2, 0]
    assert columns.progress.tolist() == [0, 0, 1, 0]
    assert columns.returns.tolist() == [1, 3, 6, 1]
    assert columns.seed_key.tolist()[1] == [0, 0, 0, 0, 1]
    assert columns.source is None


def test_next_observations_never_cross_episodes(made):
    i = 1  # observations 200..205, two steps
    start, length = made.episodes.obs_start[i], made.episodes.length[i]
    following = made.steps.observations[start + 1 : start + 1 + length]
    assert following.tolist() == [[202, 203], [204, 205]]


def test_header_and_small_tables(made, kit):
    assert (made.family, made.name, made.version) == ("cheetah_dir", "hand-made", "1.0.0")
    assert (made.license, made.spec["seed"], made.parent) == ("CC0-1.0", 3, "")
    assert made.tasks.names == ("forward", "backward")
    assert made.tasks.indices == (0, 1)
    assert made.tasks.envs[0] == {"entry_point": "x:y", "kwargs": {"task": "forward"}}
    assert made.tasks.roles.tolist() == [2, 2]
    assert np.isnan(made.tasks.ref_zero[0])
    assert made.tasks.references == (References(), kit.header.tasks[1].references)
    assert made.goals.values.tolist() == [[1.0], [-1.0], [0.5]]  # the last one of the TTA set
    assert made.policy_infos() == list(kit.header.policies)
    assert {"mpdt", "python", "numpy", "h5py", "hdf5", "mujoco"} <= set(made.packages)
    assert set(made.platform) == {"os", "arch", "cpu", "blas"}


def test_spec_and_digests_are_hashed(made, kit):
    names = made.tasks.names
    for i, episode in enumerate(kit.episodes):
        assert made.episodes.digest[i].tobytes() == episode_digest(episode, names[episode.task])
    assert len(made.content_hash) == len(made.spec_hash) == 64


def test_arrays_are_contiguous_aligned_and_little_endian(made):
    with h5py.File(made.path) as file:
        arrays = []
        file.visititems(lambda _, item: arrays.append(item))
        for item in arrays:
            if isinstance(item, h5py.Dataset) and item.size and item.dtype.kind != "O":
                assert item.chunks is None
                assert item.id.get_offset() % 64 == 0
                assert item.dtype.newbyteorder("<") == item.dtype
        assert file["steps/terminations"].id.get_storage_size() == 7  # one byte per flag


def test_goals_of_different_sizes_are_padded(tmp_path, kit):
    episodes = (
        replace(kit.episode(1), goal=np.zeros(0)),
        replace(kit.episode(1, row=1), goal=np.array([1.0, 2.0])),
        replace(kit.episode(1, row=2), goal=np.array([0.0, 0.0])),
    )
    made = write_file(tmp_path / "a.h5", kit.header, kit.source(episodes))
    assert made.goals.values.tolist() == [[0, 0], [1, 2], [0, 0]]
    assert made.goals.dims.tolist() == [0, 2, 2]
    for i, episode in enumerate(episodes):
        assert_same(made.episode(i), episode)


def test_a_goal_belongs_to_its_task(tmp_path, kit):
    same = np.array([1.0])
    episodes = (replace(kit.episode(1), goal=same), replace(kit.episode(1, task=1), goal=same))
    made = write_file(tmp_path / "a.h5", kit.header, kit.source(episodes))
    assert made.goals.tasks.tolist() == [0, 1]
    assert made.episodes.goal.tolist() == [0, 1]


def test_successes_are_kept_per_step(tmp_path, kit):
    episodes = (kit.episode(2, success=True), kit.episode(2, row=1, success=False))
    header = replace(kit.header, has_success=True)
    made = write_file(tmp_path / "a.h5", header, kit.source(episodes))
    assert made.steps.successes.tolist() == [False, True, False, False]
    assert made.episodes.success.tolist() == [True, False]
    with pytest.raises(ShapeError, match="successes do not fit the header"):
        write_file(tmp_path / "b.h5", kit.header, kit.source(episodes))


def test_no_episodes_at_all(tmp_path, kit):
    made = write_file(tmp_path / "a.h5", kit.header, kit.source(()))
    assert (made.num_episodes, made.num_steps) == (0, 0)
    assert made.steps.observations.shape == (0, 2)
    assert made.select().tolist() == []


def test_a_constant_action_of_another_size_is_refused(tmp_path, kit):
    header = replace(kit.header, tasks=(replace(kit.header.tasks[0], references=References(
        {}, (0.5, 0.5))), kit.header.tasks[1]))  # fmt: skip
    with pytest.raises(ShapeError, match="wrong constant action"):
        write_file(tmp_path / "a.h5", header, kit.source())


def test_reference_columns_by_hand(made):
    """What is not known is NaN, 0 episodes and no text; `backward` is drawn in conftest.py."""
    with h5py.File(made.path) as file:
        tasks = file["tasks"]
        assert tasks["ref_expert"][1] == 9.0 and tasks["ref_expert_error"][1] == 0.5
        assert tasks["ref_expert_episodes"][:].tolist() == [0, 64]
        assert tasks["ref_expert_success"][1] == 0.75 and np.isnan(tasks["ref_zero_success"][1])
        assert tasks["ref_expert_source"].asstr()[:].tolist() == ["", "collected"]
        assert tasks["ref_constant_action"][:].tolist()[1] == [0.5]
        assert np.isnan(tasks["ref_constant_action"][0]).all() and np.isnan(tasks["ref_zero"][0])


def test_content_hash_is_of_the_episodes_alone(tmp_path, made, kit):
    other = replace(kit.header, name="b", version="2.0.0", spec={}, packages={"mpdt": "9"})
    finish = lambda dataset: Additions(  # noqa: E731
        {"train": Slice(np.array([0]), {"rule": "x"})}, stats(), {"forward": KNOWN}
    )
    again = write_file(tmp_path / "b.h5", other, kit.source(), finish=finish)
    assert again.content_hash == made.content_hash
    assert again.spec_hash != made.spec_hash
    fewer = write_file(tmp_path / "c.h5", kit.header, kit.source(kit.episodes[:3]))
    assert fewer.content_hash != made.content_hash


def test_finish_sees_the_episodes_and_adds(tmp_path, kit):
    seen = []

    def finish(dataset):
        seen.append((dataset.path.name, dataset.num_episodes, dataset.steps.rewards.tolist()))
        ids = dataset.select(task="forward")
        return Additions({"train": Slice(ids, {"task": "forward"})}, stats(),
                         {"forward": KNOWN})  # fmt: skip

    made = write_file(tmp_path / "a.h5", kit.header, kit.source(), finish=finish)
    assert [one[1:] for one in seen] == [(4, [1, 1, 2, 1, 2, 3, 1])]
    assert seen[0][0].startswith(".a.h5.") and seen[0][0].endswith(".tmp")
    assert made.slices["train"].tolist() == [0, 1, 2]
    assert made.slice_rules["train"] == {"task": "forward"}
    assert made.tasks.ref_random.tolist() == [1.5, -1.0]
    assert np.isnan(made.tasks.ref_zero[0])
    assert made.tasks.references == (KNOWN, kit.header.tasks[1].references)
    assert made.stats["observations"]["q99"].tolist() == [9, 9]
    assert made.stats["returns"]["mean"].tolist() == [1]
    assert made.stats_info.tasks_seen == (0, 1)
    assert made.stats_info.constant["actions"] == (0,)
    with h5py.File(made.path) as file:
        assert file["slices/train"].attrs["parent"] == made.content_hash


def test_cut_out_files_keep_ids_and_parent(tmp_path, made, kit):
    ids = [1, 3]
    source = EpisodeSource([made.episode(i) for i in ids], 2, 3, source_ids=ids)
    cut = write_file(tmp_path / "b.h5", replace(kit.header, parent=made.content_hash), source)
    assert cut.parent == made.content_hash
    assert cut.episodes.source.tolist() == ids
    np.testing.assert_array_equal(cut.episodes.digest, made.episodes.digest[ids])
    with pytest.raises(DataError, match="source ids and episodes disagree"):
        write_file(tmp_path / "c.h5", kit.header, replace(kit.source(), source_ids=[1]))


def test_long_texts_outgrow_attributes(tmp_path, kit):
    spec = {"text": "é" * 40_000}  # 80 kB in UTF-8
    made = write_file(tmp_path / "a.h5", replace(kit.header, spec=spec), kit.source())
    assert made.spec == spec
    with h5py.File(made.path) as file:
        assert file["spec"].shape == ()


@pytest.mark.parametrize(
    ("order", "what"),
    [((1, 0), "found (0, 0, 0, 0) after (0, 0, 0, 1)"), ((2, 1), "(0, 0, 0, 1) after (0, 2, 0"),
     ((3, 0), "after (1, 0, 0, 0)"), ((0, 0), "found (0, 0, 0, 0) after (0, 0, 0, 0)")],
)  # fmt: skip
def test_canonical_order_is_demanded(tmp_path, kit, order, what):
    episodes = tuple(kit.episodes[i] for i in order)
    with pytest.raises(DataError, match="out of canonical order") as caught:
        write_file(tmp_path / "a.h5", kit.header, kit.source(episodes))
    assert what in str(caught.value)


@pytest.mark.parametrize(
    ("count", "steps", "found"), [(5, 7, "4 episodes of 7"), (4, 8, "4 episodes of 7"),
                                  (3, 7, "at least 4 episodes"), (4, 6, "4 episodes of 7")],
)  # fmt: skip
def test_announced_counts_must_come_true(tmp_path, kit, count, steps, found):
    with pytest.raises(DataError, match="not the announced number") as caught:
        write_file(tmp_path / "a.h5", kit.header, EpisodeSource(kit.episodes, count, steps))
    assert found in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_strangers_are_refused(tmp_path, kit):
    target = tmp_path / "a.h5"
    with pytest.raises(DataError, match=r"task the file does not have.*found 5"):
        write_file(target, kit.header, kit.source((kit.episode(1, task=5),)))
    with pytest.raises(DataError, match="policy the header does not list"):
        write_file(target, kit.header, kit.source((kit.episode(1, policy=bytes(32)),)))
    wide = replace(kit.episode(1), actions=np.zeros((1, 3), np.float32))
    with pytest.raises(ShapeError, match=r"wrong actions; expected rows of \(1,\), found \(3,\)"):
        write_file(target, kit.header, kit.source((wide,)))
    with pytest.raises(DataError, match="ascend by family index"):
        write_file(target, replace(kit.header, tasks=kit.header.tasks[::-1]), kit.source())
    with pytest.raises(UsageError, match="cannot be a name"):
        write_file(target, kit.header, kit.source(), {"a/b": kit.tta()})
    with pytest.raises(DataError, match="ascending episode ids"):
        write_file(target, kit.header, kit.source(),
                   finish=lambda _: Additions({"s": Slice(np.array([2, 1]), {})}))  # fmt: skip
    assert list(tmp_path.iterdir()) == []
