"""Slow twins: windows, returns-to-go and the sampler's order as plain Python loops.

The fast paths must give the same bytes for episodes of length 1, 2, K-1, K and the horizon.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpdt.data.slices import windows as windows_module
from mpdt.data.slices.sampler import WindowSampler, _Table
from mpdt.data.slices.windows import RewardReturns, cover, gather_windows
from mpdt.seeding import generator_at

HORIZON = 40  # several of the sums that `RewardReturns` keeps


def slow_returns_to_go(rewards):
    """Python floats are float64; summed from the last step backwards."""
    total, result = 0.0, []
    for reward in reversed(rewards.tolist()):
        total += reward
        result.insert(0, np.float32(total))
    return result


def slow_window(source, rewards, episode, start, K):
    """One window as lists of K rows, pads first."""
    first = int(source.episodes.start[episode])
    obs_first = int(source.episodes.obs_start[episode])
    length = int(source.episodes.length[episode])
    to_go = slow_returns_to_go(rewards[first : first + length])
    D, A = source.steps.observations.shape[1], source.steps.actions.shape[1]
    rows = []
    for t in range(start, min(start + K, length)):
        previous = source.steps.actions[first + t - 1] if t > 0 else np.zeros(A, np.float32)
        rows.append((source.steps.observations[obs_first + t], previous,
                     source.steps.actions[first + t], to_go[t], t, True))  # fmt: skip
    pad = (np.zeros(D, np.float32), np.zeros(A, np.float32), np.zeros(A, np.float32), 0, 0, False)
    return [pad] * (K - len(rows)) + rows


def slow_draw(source, ids_of_task, tasks, K, M, seed, start_bias, step):
    """(slot, episode, start) of every window of one update, in order."""
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, step])))
    drawn = []
    for slot, task in enumerate(tasks):
        owner = [i for i in ids_of_task[task] for _ in range(source.episodes.length[i])]
        picks = [owner[j] for j in generator.integers(len(owner), size=M)]
        starts = generator.integers([-start_bias] * M, [source.episodes.length[i] for i in picks])
        drawn += [(slot, i, max(int(s), 0)) for i, s in zip(picks, starts, strict=True)]
    return drawn


def make_source(lengths, seed, D=3, A=2):
    generator = np.random.Generator(np.random.PCG64(seed))
    lengths = np.array(lengths)
    N, E = int(lengths.sum()), len(lengths)
    steps = SimpleNamespace(
        observations=generator.standard_normal((N + E, D)).astype(np.float32),
        actions=generator.standard_normal((N, A)).astype(np.float32),
        rewards=generator.standard_normal(N).astype(np.float32),
    )
    start = np.cumsum(lengths) - lengths
    episodes = SimpleNamespace(start=start, obs_start=start + np.arange(E), length=lengths)
    return SimpleNamespace(steps=steps, episodes=episodes)


windows = st.integers(1, 6)
edge_lengths = st.lists(st.sampled_from([1, 2, 3, 4, 5, 6, HORIZON]), min_size=1, max_size=6)


@settings(max_examples=60, deadline=None)
@given(lengths=edge_lengths, K=windows, seed=st.integers(0, 99), data=st.data())
@pytest.mark.parametrize("kept_steps", [1 << 26, 0])
def test_gather_equals_its_slow_twin(kept_steps, lengths, K, seed, data):
    source = make_source(lengths, seed)
    ids = np.array([[data.draw(st.integers(0, len(lengths) - 1)) for _ in range(3)]])
    starts = np.array([[data.draw(st.integers(0, lengths[i] - 1)) for i in ids[0]]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(windows_module, "KEPT_STEPS", kept_steps)
        returns = RewardReturns(source, source.steps.rewards)
    fast = gather_windows(source, ids, starts, K, returns)
    for m in range(3):
        slow = slow_window(source, source.steps.rewards, ids[0, m], int(starts[0, m]), K)
        columns = (fast.observations, fast.previous_actions, fast.actions,
                   fast.returns_to_go, fast.timesteps, fast.mask)  # fmt: skip
        for column, expected in zip(columns, zip(*slow, strict=True), strict=True):
            np.testing.assert_array_equal(column[0, m], np.array(expected))


@settings(max_examples=40, deadline=None)
@given(lengths=edge_lengths, K=windows, seed=st.integers(0, 99))
def test_windows_never_cross_episodes(lengths, K, seed):
    """Every observation row carries its episode's number; no window may hold two of them."""
    source = make_source(lengths, seed)
    owner = np.repeat(np.arange(len(lengths)), np.array(lengths) + 1).astype(np.float32)
    source.steps.observations = np.stack([owner, np.zeros_like(owner)], axis=1)
    sampler = WindowSampler(source, {0: np.arange(len(lengths))}, [0], K, 8, seed, start_bias=4)
    batch = sampler.batch(seed)
    seen = batch.observations[..., 0]
    np.testing.assert_array_equal(
        seen[batch.mask], np.broadcast_to(batch.episodes[..., None], seen.shape)[batch.mask]
    )
    assert batch.mask.any(axis=-1).all()
    assert (batch.timesteps.max(axis=-1) < source.episodes.length[batch.episodes]).all()


@settings(max_examples=40, deadline=None)
@given(lengths=edge_lengths, K=windows, seed=st.integers(0, 99), bias=st.integers(0, 5))
def test_sampler_order_equals_its_slow_twin(lengths, K, seed, bias):
    source = make_source(lengths * 2, seed)
    half = len(lengths)
    ids = {4: np.arange(half), 9: np.arange(half, 2 * half)}
    batch = WindowSampler(source, ids, [4, 9], K, 5, seed, start_bias=bias).batch(3)
    expected = slow_draw(source, ids, [4, 9], K, 5, seed, bias, 3)
    flat = zip(np.repeat(batch.slots, 5), batch.episodes.ravel(), batch.starts.ravel(), strict=True)
    assert [tuple(map(int, row)) for row in flat] == [tuple(map(int, row)) for row in expected]


@settings(max_examples=40, deadline=None)
@given(lengths=edge_lengths, K=windows)
def test_cover_holds_each_step_exactly_once(lengths, K):
    source = make_source(lengths, 0)
    order = np.arange(len(lengths))
    ids, starts = cover(source.episodes.length, order, K)
    batch = gather_windows(source, ids[None], starts[None], K,
                           RewardReturns(source, source.steps.rewards))  # fmt: skip
    seen = sorted(
        (int(i), int(t))
        for i, steps, mask in zip(ids, batch.timesteps[0], batch.mask[0], strict=True)
        for t in steps[mask]
    )
    assert seen == [(i, t) for i in order for t in range(lengths[i])]


def test_drawn_at_once_is_what_numpy_draws_or_nothing():
    """Ranges of nearly 2^32, where numpy throws away every third word or so, and small ones."""
    large, small = np.array([1 << 30, 7, (1 << 31) - 5]), np.array([3, 500, 41])
    for lengths, bias in ((large, 0), (large, 9), (small, 0), (small, 3)):
        table = _Table([np.array([0, 2]), np.array([1])], lengths, bias)
        slots, answered = np.arange(2), 0
        for step in range(200):
            at_once = table.draw_at_once(generator_at(1, step), slots, 2)
            if at_once is not None:
                answered += 1
                for fast, slow in zip(at_once, table.draw(generator_at(1, step), slots, 2),
                                      strict=True):  # fmt: skip
                    np.testing.assert_array_equal(fast, slow)
        assert 5 < answered < 195 if lengths is large else answered == 200
    assert (
        _Table([np.array([0])], np.array([1]), 0).draw_at_once(generator_at(1, 0), [0], 2) is None
    )
