"""OGBench's .npz files: a pair of them per task and quality, to train on and to validate on.

    <family>-<task>-<quality>-v<major>.npz, ...-val.npz
    row            0    1    2  |  3    4      one more row than steps per episode
    observations  o_0  o_1  o_2 | o_0  o_1     (N, D) float32
    actions       a_0  a_1   0  | a_0   0      (N, A) float32; the loader leaves the last one out
    rewards       r_0  r_1   0  | r_0   0      (N,) float32; the loader reads none
    terminals      0    0    1  |  0    1      (N,) bool: the last row of every episode

Every tenth episode is in the second file, its first one included, so that it has the best and the
worst policies of history, too; where there is one episode alone both have it.
Source: OGBench 1.2.2, utils.load_dataset and make_env_and_datasets.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mpdt.data.exchange.foreign import quality_name
from mpdt.data.exchange.minari_claims import safe
from mpdt.data.exchange.selection import Run, Selection
from mpdt.data.store.tables import Int64

LOST = (
    "seeds, policies, success, progress, goals, licence, which end was a time limit, and, for its "
    "loader, rewards"
)
HELD_OUT = 10


def write(selection: Selection, folder: Path) -> None:
    """A pair per task and quality in `folder`. Memory holds one of them. Raises: OSError."""
    for run in selection.runs():
        held_out = run.ids[::HELD_OUT]
        kept = np.setdiff1d(run.ids, held_out) if len(run.ids) > 1 else run.ids
        name = _name(selection, run)
        _write(selection, kept, folder / f"{name}.npz")
        _write(selection, held_out, folder / f"{name}-val.npz")


def _name(selection: Selection, run: Run) -> str:
    family, major = selection.header.family, selection.header.version.partition(".")[0]
    return safe(f"{family}-{run.task.name}-{quality_name(run.quality)}-v{major}")


def _write(selection: Selection, ids: Int64, path: Path) -> None:
    data = selection.dataset
    num_rows = int(data.episodes.length[ids].sum()) + len(ids)
    observations = np.zeros((num_rows, data.observation_size), np.float32)
    actions = np.zeros((num_rows, data.action_size), np.float32)
    rewards, terminals = np.zeros(num_rows, np.float32), np.zeros(num_rows, bool)
    first = 0
    for i in ids.tolist():
        episode = selection.episode(i)
        last = first + episode.length
        observations[first : last + 1] = episode.observations
        actions[first:last], rewards[first:last] = episode.actions, episode.rewards
        terminals[last] = True
        first = last + 1
    with path.open("xb") as file:
        np.savez(file, observations=observations, actions=actions, rewards=rewards,
                 terminals=terminals)  # fmt: skip
