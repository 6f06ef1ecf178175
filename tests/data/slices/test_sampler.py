"""The sampler: same numbers for the same (seed, step), chances ∝ length, clear refusals."""

import dataclasses
import os
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from makers import make_episode, make_header, source_of

import mpdt
from mpdt.data.slices.sampler import SamplerSettings, WindowSampler
from mpdt.data.store.writer import write_file
from mpdt.errors import DataError, UsageError


def source(lengths):
    lengths = np.array(lengths)
    N, E = int(lengths.sum()), len(lengths)
    start = np.cumsum(lengths) - lengths
    return SimpleNamespace(
        steps=SimpleNamespace(
            observations=np.arange(N + E, dtype=np.float32)[:, None],
            actions=np.arange(N, dtype=np.float32)[:, None],
            rewards=np.ones(N, np.float32),
        ),
        episodes=SimpleNamespace(start=start, obs_start=start + np.arange(E), length=lengths),
    )


def sampler(lengths=(10, 10, 10), tasks=(0, 1, 2), seed=0, **options):
    ids = {task: np.array([task]) for task in tasks}
    return WindowSampler(source(lengths), ids, tasks, 4, 3, seed, **options)


def test_batch_is_a_function_of_seed_and_step():
    first, again = sampler().batch(5), sampler().batch(5)
    other_step, other_seed = sampler().batch(6), sampler(seed=1).batch(5)
    np.testing.assert_array_equal(first.starts, again.starts)
    np.testing.assert_array_equal(first.observations, again.observations)
    assert (first.starts != other_step.starts).any()
    assert (first.starts != other_seed.starts).any()


def test_drawing_does_not_touch_the_global_generator():
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - the very thing that must not move
    sampler().batch(0)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_episodes_are_drawn_in_proportion_to_their_length():
    """Lengths 1 and 9: chance 0.1 of the short one. 4000 draws: 400 +- 5 sigma (95)."""
    windows = WindowSampler(source([1, 9]), {0: np.array([0, 1])}, [0], 4, 4000, 0).batch(0)
    assert abs(int((windows.episodes == 0).sum()) - 400) < 95


def test_starts_are_uniform_to_the_last_step_and_biased_on_request():
    """10 starts: 1 in 10 is 0. With 10 virtual ones before them 11 in 20 are."""
    ids = {0: np.array([0])}
    plain = WindowSampler(source([10]), ids, [0], 4, 4000, 0).batch(0).starts
    biased = WindowSampler(source([10]), ids, [0], 4, 4000, 0, start_bias=10).batch(0).starts
    assert plain.min() == 0 and plain.max() == 9 and biased.max() == 9
    assert abs(int((plain == 0).sum()) - 400) < 95
    assert abs(int((biased == 0).sum()) - 2200) < 158


def test_tasks_keep_their_row_and_their_slot():
    batch = WindowSampler(
        source([5, 5, 5]), {7: np.array([2]), 3: np.array([0])}, [7, 3], 2, 2, 0
    ).batch(0)
    assert batch.tasks.tolist() == [7, 3] and batch.slots.tolist() == [0, 1]
    assert batch.episodes.tolist() == [[2, 2], [0, 0]]


def test_sub_sampled_tasks():
    random = [sampler(tasks_per_update=2).batch(step).slots.tolist() for step in range(30)]
    assert {tuple(slots) for slots in random} == {(0, 1), (0, 2), (1, 2)}
    in_turn = [sampler(tasks_per_update=2, order="sequential").batch(s).slots.tolist()
               for s in range(3)]  # fmt: skip
    assert in_turn == [[0, 1], [0, 2], [1, 2]]  # 0 1 | 2 0 | 1 2, each ascending
    assert sampler(tasks_per_update=99).batch(0).slots.tolist() == [0, 1, 2]


def test_a_task_without_episodes_is_refused():
    with pytest.raises(DataError, match="task row 1: no episode to train on"):
        WindowSampler(source([5]), {0: np.array([0])}, [0, 1], 2, 2, 0)


@pytest.mark.parametrize(
    "wrong", [{"window": 0}, {"per_task": 0}, {"tasks_per_update": -1}, {"start_bias": -1}]
)
def test_settings_out_of_range(wrong):
    with pytest.raises(UsageError, match=f"sampler.{next(iter(wrong))}: setting out of range"):
        SamplerSettings(**wrong)


def test_a_worker_gets_the_same_batches_and_no_copy_of_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    episodes = [make_episode(400, float(i), (40, 8), row=i) for i in range(20)]
    data = write_file(tmp_path / "a.h5", make_header(episodes), source_of(episodes))
    made = mpdt.windows(data, window=5, per_task=3, seed=4)
    made.batch(0)
    text = pickle.dumps(made)
    assert len(text) < 4096 < data.num_bytes / 100
    again = pickle.loads(text)
    for step in (0, 7):
        for field in dataclasses.fields(made[step]):
            one, two = (getattr(drawn[step], field.name) for drawn in (made, again))
            assert one.dtype == two.dtype and one.tobytes() == two.tobytes(), field.name


@pytest.mark.slow
def test_two_spawned_workers_of_a_data_loader(tmp_path):
    """In the order of the steps, whoever made them; a worker holds maps of the file."""
    torch = pytest.importorskip("torch.utils.data")
    episodes = [make_episode(400, float(i), (40, 8), row=i) for i in range(20)]
    data = write_file(tmp_path / "a.h5", make_header(episodes), source_of(episodes))
    made = mpdt.windows(data, window=5, per_task=3, seed=4)
    loader = torch.DataLoader(made, batch_size=None, sampler=range(12), num_workers=2,
                              prefetch_factor=2, multiprocessing_context="spawn")  # fmt: skip
    for step, batch in enumerate(loader):
        assert batch.observations.tobytes() == made.batch(step).observations.tobytes()
    assert step == 11
