"""Flat HDF5 as in D4RL: steps of one task and quality, episodes one after another.

    <family>-<task>-<quality>.hdf5
        row            0     1     2  |  3     4
        observations  o_0   o_1   o_2 | o_0   o_1
        next_obs...   o_1   o_2   o_3 | o_1   o_2     the last one is the final observation
        terminals      0     0     0  |  0     1      the task's own end
        timeouts       0     0     1  |  0     0      its time limit
        actions, rewards, infos/goal, infos/success

The layout has no room for seeds, policies and progress. Files of D4RL itself may end within an
episode, and older ones do not flag time limits. Source: Fu et al. 2020 (D4RL), its README.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mpdt.data.exchange import foreign, hdf5
from mpdt.data.exchange.claims import Said, named
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import Source, quality_code, quality_name
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.selection import Run, Selection
from mpdt.data.exchange.treatment import RawEpisode, Rules, joined
from mpdt.errors import DataError, UsageError

LOST = "seeds, policies, progress and references"

_NAMES = ("family", "task", "quality")
_THEIR_NAME = re.compile(r"[a-z0-9]+_(?P<quality>random|medium|expert)-v\d+")
"""As `halfcheetah_medium-v2`; mixtures such as `medium_expert` have no word here."""


# ---- out ----


def write(selection: Selection, folder: Path) -> None:
    """One file per task and quality. Memory holds one episode. Raises: OSError."""
    for run in selection.runs():
        words = (selection.header.family, run.task.name, quality_name(run.quality))
        with hdf5.created(folder / f"{'-'.join(words)}.hdf5") as file:
            file.attrs.update(dict(zip(_NAMES, words, strict=True)))
            file.attrs["license"] = selection.header.license
            _write_run(file, selection, run)


def _write_run(file: h5py.File, selection: Selection, run: Run) -> None:
    data = selection.dataset
    count = int(data.episodes.length[run.ids].sum())
    first = 0
    for i in run.ids.tolist():
        episode = selection.episode(i)
        rows: dict[str, NDArray[Any]] = {
            "observations": episode.observations[:-1],
            "next_observations": episode.observations[1:],
            "actions": episode.actions,
            "rewards": episode.rewards,
            "terminals": episode.terminations,
            "timeouts": episode.truncations,
        }
        if len(episode.goal):
            rows["infos/goal"] = np.tile(episode.goal, (episode.length, 1))
        if episode.successes is not None:
            rows["infos/success"] = episode.successes
        for name, values in rows.items():
            shape = (count, *values.shape[1:])
            array = file.require_dataset(name, shape, values.dtype, exact=True)
            array[first : first + episode.length] = values
        first += episode.length


# ---- in ----


@dataclass(frozen=True)
class _Bounds:
    """Where the episodes of a file are.

    Args:
        rows: first row, and row after the last, of each complete episode.
        left_over: steps after the last complete one.
    """

    rows: tuple[tuple[int, int], ...]
    left_over: int
    has_timeouts: bool


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """Flat files of one task and quality each.

    Task and quality are those of the attributes and names that our own exports have, and else
    those of `rules`. An episode that the file's end cuts off is left out, and that is recorded.

    Raises: UsageError, FormatError, DataError, ShapeError naming file and episode; DataError where
        `rules` say otherwise than the file.
    """
    rules = foreign.given(rules)
    files = files_below(paths, ".hdf5", ".h5")
    sources, remarks = [], left_out(paths, files)
    for path in files:
        with hdf5.opened(path) as file:
            said = Said.of(file.attrs, "its attributes")
            bounds = episode_bounds(file, rules.horizon, str(path))
        said = said.and_also(_named(path.stem), str(path)).settled(rules, str(path))
        if not said.task:
            raise UsageError(f"of which task is {path}?", where="--task")
        notes = {}
        if bounds.left_over:
            notes["incomplete_steps_left_out"] = bounds.left_over
            remarks.append(f"{path}: left out the last {bounds.left_over} steps, an episode "
                           "that the file cuts off")  # fmt: skip
        sources.append(
            Source(path, rules.family.task(said.task), quality_code(said.quality or "unknown"),
                   partial(foreign_episodes, path, bounds), said.license, notes=notes)
        )  # fmt: skip
    return foreign.incoming(sources, rules, name, remarks)


def _named(stem: str) -> Said:
    """What the name of a file of ours or of D4RL says."""
    if theirs := _THEIR_NAME.fullmatch(stem):
        return Said(quality=theirs["quality"], by="its name")
    return named(stem, "its name")


def episode_bounds(file: h5py.File, horizon: int, where: str) -> _Bounds:
    ends = hdf5.array(file, "terminals", where).reshape(-1).astype(bool)
    has_timeouts = "timeouts" in file
    if has_timeouts:
        timeouts = hdf5.array(file, "timeouts", where).reshape(-1).astype(bool)
        if timeouts.shape != ends.shape:
            raise DataError("terminals and timeouts disagree", where=where,
                            expected=str(ends.shape), found=str(timeouts.shape))  # fmt: skip
        ends |= timeouts
    rows: list[tuple[int, int]] = []
    start = 0
    for end in [*(np.flatnonzero(ends) + 1).tolist(), len(ends)]:
        while not has_timeouts and end - start > horizon:
            rows.append((start, start + horizon))
            start += horizon
        is_whole = end > start and (ends[end - 1] or (not has_timeouts and end - start == horizon))
        if is_whole:
            rows.append((start, end))
            start = end
    return _Bounds(tuple(rows), len(ends) - start, has_timeouts)


def foreign_episodes(path: Path, bounds: _Bounds) -> Iterator[RawEpisode]:
    with hdf5.opened(path) as file:
        if "next_observations" not in file:
            raise DataError("no next_observations", where=str(path),
                            expected="the observation after each step",
                            hint="the last one of an episode is unknown without")  # fmt: skip
        for number, rows in enumerate(bounds.rows):
            yield _episode(file, rows, bounds.has_timeouts, f"{path}: episode {number}")


def _episode(file: h5py.File, rows: tuple[int, int], has_timeouts: bool, where: str) -> RawEpisode:
    def take(name: str) -> NDArray[Any]:
        return hdf5.array(file, name, where, rows)

    observations = joined(take("observations"), take("next_observations"), where)
    goal = None
    if "infos/goal" in file:
        goals = take("infos/goal").reshape(rows[1] - rows[0], -1).astype(np.float64)
        if (goals != goals[0]).any():
            raise DataError("the goal changes within the episode", where=where)
        goal = goals[0]
    ends = None
    if not has_timeouts:
        ends = take("terminals").reshape(-1).astype(bool)
        ends[-1] = True  # by its own flag, or by the horizon
    return RawEpisode(
        observations=observations, actions=take("actions"), rewards=take("rewards"), ends=ends,
        terminations=take("terminals") if has_timeouts else None,
        truncations=take("timeouts") if has_timeouts else None,
        successes=take("infos/success") if "infos/success" in file else None, goal=goal,
    )  # fmt: skip
