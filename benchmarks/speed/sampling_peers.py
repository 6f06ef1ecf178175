"""What sampling.py compares with: other packages' ways of drawing windows, each made ready once."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import rounds

K, HORIZON = 20, 500


@dataclass(frozen=True)
class Drawn:
    """What a batch is made of: the first tasks of training, so many windows of each."""

    family: str
    tasks: int
    per_task: int
    episodes: int  # of each task in the file
    batches: int  # of ours in a round

    @property
    def windows(self) -> int:
        return self.tasks * self.per_task

    def rows(self, dataset: Any) -> list[int]:
        return list(dataset.tasks.train_rows)[: self.tasks]


LOOP, SLICES = "loop as in Prompt-DT", "torchrl SliceSampler"


def dictionaries(dataset: Any, drawn: Drawn) -> list[list[dict[str, Any]]]:
    """Episodes of each task as Prompt-DT keeps them."""
    found = []
    for row in drawn.rows(dataset):
        episodes = [dataset.episode(int(i)) for i in dataset.select(task=row, quality="expert")]
        found.append([{"observations": e.observations[:-1].copy(), "actions": e.actions.copy(),
                       "rewards": e.rewards.copy(), "terminals": e.terminations.copy()}
                      for e in episodes])  # fmt: skip
    return found


def prompt_dt_loop(dataset: Any, drawn: Drawn) -> Callable[[], float]:
    """One batch, window after window. Written after mxu34/prompt-dt, `get_batch`."""
    import torch

    tasks = dictionaries(dataset, drawn)
    mean, std = (dataset.stats["observations"][name] for name in ("mean", "std"))
    std = np.maximum(std, 1e-6)
    generator = np.random.default_rng(0)
    columns, size = dataset.observation_size, dataset.action_size

    def to_go(rewards: Any) -> Any:
        sums = np.zeros_like(rewards)
        sums[-1] = rewards[-1]
        for t in reversed(range(len(rewards) - 1)):
            sums[t] = rewards[t] + sums[t + 1]
        return sums

    def run() -> float:
        for episodes in tasks:
            lengths = np.array([len(e["rewards"]) for e in episodes])
            chosen = generator.choice(len(episodes), drawn.per_task, p=lengths / lengths.sum())
            s, a, r, rtg, steps, masks = [], [], [], [], [], []
            for i in chosen:
                episode = episodes[i]
                first = int(generator.integers(len(episode["rewards"])))
                seen = episode["observations"][first : first + K].reshape(1, -1, columns)
                pad = K - seen.shape[1]
                seen = np.concatenate([np.zeros((1, pad, columns)), seen], axis=1)
                s.append((seen - mean) / std)
                part = episode["actions"][first : first + K].reshape(1, -1, size)
                a.append(np.concatenate([np.ones((1, pad, size)) * -10.0, part], axis=1))
                part = episode["rewards"][first : first + K].reshape(1, -1, 1)
                r.append(np.concatenate([np.zeros((1, pad, 1)), part], axis=1))
                sums = to_go(episode["rewards"][first:])[:K].reshape(1, -1, 1)
                rtg.append(np.concatenate([np.zeros((1, pad, 1)), sums], axis=1))
                clock = np.arange(first, first + K - pad).reshape(1, -1)
                steps.append(np.concatenate([np.zeros((1, pad)), clock], axis=1))
                masks.append(np.concatenate([np.zeros((1, pad)), np.ones((1, K - pad))], axis=1))
            for parts in (s, a, r, rtg, steps, masks):
                torch.from_numpy(np.concatenate(parts, axis=0)).to(torch.float32)
        return float(drawn.windows)

    return run


def h5py_slices(path: Path, dataset: Any, windows: int) -> Callable[[], float]:
    file = h5py.File(path, "r")
    steps, generator = file["steps"], np.random.default_rng(0)
    table = dataset.episodes

    def run() -> float:
        for i in generator.integers(len(table), size=windows):
            first = int(generator.integers(HORIZON - K))
            at, seen = int(table.start[i]) + first, int(table.obs_start[i]) + first
            _ = steps["observations"][seen : seen + K]
            _ = steps["actions"][at : at + K]
            _ = steps["rewards"][at : at + K]
        return float(windows)

    return run


def minari_sample(work: Path, dataset: Any, windows: int) -> Callable[[], float]:
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    os.environ["MINARI_DATASETS_PATH"] = str(work / "minari")
    buffers = [
        EpisodeBuffer(id=i, observations=np.array(e.observations), actions=np.array(e.actions),
                      rewards=np.array(e.rewards), terminations=np.array(e.terminations),
                      truncations=np.array(e.truncations), infos={})
        for i, e in ((i, dataset.episode(i)) for i in range(100))
    ]  # fmt: skip
    shapes = dataset.observation_size, dataset.action_size
    boxes = [spaces.Box(-np.inf, np.inf, (n,), np.float32) for n in shapes]
    stored = minari.create_dataset_from_buffers(
        "bench/windows-v0",
        buffers,
        observation_space=boxes[0],
        action_space=boxes[1],
        algorithm_name="x",
        author="x",
        author_email="x",
        code_permalink="x",
        description="x",
    )
    generator = np.random.default_rng(0)

    def run() -> float:
        for episode in stored.sample_episodes(windows):
            first = int(generator.integers(HORIZON - K))
            _ = episode.observations[first : first + K], episode.actions[first : first + K]
        return float(windows)

    return run


def torchrl_slices(dataset: Any, windows: int) -> Callable[[], float]:
    import torch
    from tensordict import TensorDict
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    from torchrl.data.replay_buffers.samplers import SliceSampler

    steps, count = dataset.steps, len(dataset.steps.actions)
    starts = dataset.episodes.start
    rows = np.repeat(dataset.episodes.obs_start - starts, dataset.episodes.length)
    data = TensorDict(
        {"observation": torch.from_numpy(np.array(steps.observations[np.arange(count) + rows])),
         "action": torch.from_numpy(np.array(steps.actions)),
         "reward": torch.from_numpy(np.array(steps.rewards)),
         "episode": torch.from_numpy(np.repeat(np.arange(len(starts)), dataset.episodes.length))},
        batch_size=[count])  # fmt: skip
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(count), batch_size=windows * K,
        sampler=SliceSampler(slice_len=K, traj_key="episode", cache_values=True))  # fmt: skip
    buffer.extend(data)

    def run() -> float:
        buffer.sample()
        return float(windows)

    return run


def d3rlpy_slices(dataset: Any, windows: int) -> Callable[[], float]:
    import d3rlpy

    episodes = [
        d3rlpy.dataset.Episode(np.array(e.observations[:-1]), np.array(e.actions),
                               np.array(e.rewards)[:, None], False)
        for e in (dataset.episode(i) for i in range(200))
    ]  # fmt: skip
    buffer = d3rlpy.dataset.create_infinite_replay_buffer(episodes)

    def run() -> float:
        buffer.sample_trajectory_batch(windows, K)
        return float(windows)

    return run


def peers(work: Path, dataset: Any, windows: int) -> list[rounds.Way]:
    """Those that are installed."""
    found = []
    with rounds.without_output():
        if rounds.have("minari"):
            run = minari_sample(work, dataset, 20)
            found.append(rounds.Way("minari sample_episodes", "peer", run, 0))
        if rounds.have("torchrl"):
            found.append(rounds.Way(SLICES, "peer", torchrl_slices(dataset, windows), 0))
        if rounds.have("d3rlpy"):
            found.append(
                rounds.Way("d3rlpy ReplayBuffer", "peer", d3rlpy_slices(dataset, windows), 0)
            )
    return found
