"""Pickles in the layout of Prompt-DT: lists of dicts, one file per task and quality.

    data/<env>/<env>-<i>-<quality>.pkl            every episode
    data/<env>/<env>-<i>-prompt-<quality>.pkl     five of them
    config/<env>/config_<env>_task<i>.pkl         [{'velocity': 0.225}], or goal, or direction
    config/<env>/<env>_<n>.json                   which of the n tasks are train_tasks, test_tasks

    observations, next_observations (T, D), actions (T, A) float32, rewards (T, 1) float32,
    terminals (T, 1) bool: true on the last row, also where it is the time limit

Source: the public pickles and code of Xu et al. 2022 (Prompt-DT). The layout has no room for
seeds, policies, success and the difference between the two kinds of end.
"""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.exchange import foreign
from mpdt.data.exchange.claims import Said
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import Source, quality_code, quality_name
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.pickle_machine import kind_of
from mpdt.data.exchange.selection import Selection
from mpdt.data.exchange.treatment import RawEpisode, Rules, joined
from mpdt.data.exchange.unpickle import load_pickle
from mpdt.data.spec.tasks import FAMILIES, Family
from mpdt.errors import DataError, FormatError, ShapeError

LOST = "seeds, policies, success, licence, and which end was a time limit"
NUM_PROMPTS = 5

_DATA = re.compile(
    r"(?P<env>.+?)-(?P<index>\d+)(?:-prompt)?-(?P<quality>expert|medium|random|history|policy|unknown)\.pkl"
)
_CONFIG = re.compile(r"config_(?P<env>.+)_task(?P<index>\d+)\.pkl")
_GOAL_KEYS = {"cheetah_dir": "direction", "cheetah_vel": "velocity", "ant_dir": "goal"}
_ML1 = re.compile(r"ML1-(?P<task>.+)-v\d")


# ---- in ----


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """Pickles of one family, with their goals where config files lie among `paths`.

    Raises: FormatError for what is not allowed in a pickle; UsageError, DataError, ShapeError
        naming file and episode.
    """
    rules, files = foreign.given(rules), files_below(paths, ".pkl")
    goals = _goals(files, rules.family)
    splits = [path for folder in paths if folder.is_dir()
              for path in folder.glob("**/config/*/*.json")]  # fmt: skip
    sources, remarks = [], left_out(paths, [*files, *splits])  # the family says what is a test task
    for path in files:
        if _CONFIG.fullmatch(path.name):
            continue
        match = _DATA.fullmatch(path.name)
        if match is None:
            remarks.append(f"skipped {path}: not named <env>-<i>-<quality>.pkl")
            continue
        said = _said(path, match["env"], int(match["index"]), match["quality"], rules.family)
        said = said.and_also(_folder(path), str(path)).settled(rules, str(path))
        if not said.task:
            raise DataError("a file of another family", where=str(path), expected=rules.family.name,
                            found=match["env"], hint="--task to say what it is")  # fmt: skip
        task, code = rules.family.task(said.task), quality_code(said.quality or "unknown")
        goal = goals.get(task.index)
        sources.append(Source(path, task, code, partial(_episodes, path, goal)))
    return foreign.incoming(sources, rules, name, remarks)


def _said(path: Path, env: str, index: int, quality: str, family: Family) -> Said:
    """What the name says. A name of no family and no task of ours says nothing of either.

    Raises: DataError for an index that the family does not have.
    """
    by = "its name"
    if single := _ML1.fullmatch(env):  # fifty goals of one task
        known = "metaworld" in family.packages and single["task"] in {t.name for t in family.tasks}
        return Said("" if known else env, single["task"], quality, by=by)
    if env not in FAMILIES:
        return Said(quality=quality, by=by)
    if env == family.name and index >= len(family.tasks):
        raise DataError(f"no task {index} in {env}", where=str(path),
                        expected=f"0 to {len(family.tasks) - 1}")  # fmt: skip
    task = family.tasks[index].name if env == family.name else ""
    return Said(env, task, quality, by=by)


def _folder(path: Path) -> Said:
    """What the folder `data/<env>` says."""
    env, above = path.absolute().parts[-2], path.absolute().parts[-3:-2]
    return Said(env, by="its folder") if env in FAMILIES and above == ("data",) else Said()


def _goals(files: Sequence[Path], family: Family) -> dict[int, NDArray[np.float64]]:
    """Task index -> goal of its config file, which has to be the goal that the family knows."""
    goals: dict[int, NDArray[np.float64]] = {}
    for path in files:
        match = _CONFIG.fullmatch(path.name)
        if match is None or match["env"] != family.name or not family.tasks[0].goal:
            continue
        value = load_pickle(path)
        try:
            goal = np.asarray(value[0][_GOAL_KEYS[family.name]], np.float64).reshape(1)
            known = np.array(family.tasks[int(match["index"])].goal)
        except (TypeError, KeyError, IndexError, ValueError) as error:
            raise FormatError("not a goal of " + family.name, where=str(path),
                              expected=f"[{{'{_GOAL_KEYS[family.name]}': number}}]",
                              found=kind_of(value)) from error  # fmt: skip
        if not np.allclose(goal, known, rtol=0, atol=1e-6):
            raise DataError("another goal than the family's", where=str(path),
                            expected=str(known[0]), found=str(goal[0]))  # fmt: skip
        goals[int(match["index"])] = goal
    return goals


def _episodes(path: Path, goal: NDArray[np.float64] | None) -> Iterator[RawEpisode]:
    value = load_pickle(path)
    if not isinstance(value, list):
        raise FormatError("not a list of episodes", where=str(path), found=kind_of(value))
    for number, episode in enumerate(value):
        yield raw_episode(episode, goal, f"{path}: episode {number}")


def raw_episode(episode: Any, goal: NDArray[np.float64] | None, where: str) -> RawEpisode:
    """One dict of the pickles. Raises: FormatError, ShapeError, DataError."""
    if not isinstance(episode, dict):
        raise FormatError("not a dict of arrays", where=where, found=kind_of(episode))
    ends = "terminals" if "terminals" in episode else "dones"
    wanted = ("observations", "next_observations", "actions", "rewards", ends)
    if missing := [key for key in wanted if key not in episode]:
        raise ShapeError(f"no {', '.join(missing)}", where=where,
                         expected=", ".join(wanted))  # fmt: skip
    return RawEpisode(
        observations=joined(episode["observations"], episode["next_observations"], where),
        actions=episode["actions"], rewards=episode["rewards"], ends=episode[ends], goal=goal,
    )  # fmt: skip


# ---- out ----


def write(selection: Selection, folder: Path) -> None:
    """Data, prompt, goal and split files below `folder`. Readable by NumPy 1 and 2.

    Memory holds the episodes of one task and quality. Raises: StorageError.
    """
    family = selection.dataset.family
    _write_split(selection, folder / "config" / family)
    for run in selection.runs():
        place = folder / "data" / family
        place.mkdir(parents=True, exist_ok=True)
        quality = quality_name(run.quality)
        episodes = [_as_dict(selection.episode(i)) for i in run.ids.tolist()]
        _dump(episodes, place / f"{family}-{run.task.index}-{quality}.pkl")
        _dump(episodes[:NUM_PROMPTS], place / f"{family}-{run.task.index}-prompt-{quality}.pkl")
        if family in _GOAL_KEYS:  # elsewhere every episode has a goal of its own
            goals = folder / "config" / family
            goal = selection.episode(int(run.ids[0])).goal[0]
            _dump([{_GOAL_KEYS[family]: goal}], goals / f"config_{family}_task{run.task.index}.pkl")


def _write_split(selection: Selection, folder: Path) -> None:
    """The file that their main script opens first; n counts the tasks of the whole file."""
    family, num_tasks = selection.dataset.family, len(selection.dataset.tasks.names)
    tasks = {run.task.index: run.task for run in selection.runs()}
    split = {
        "env": family,
        "total_tasks": num_tasks,
        "train_tasks": [i for i, task in tasks.items() if task.role in ("train", "both")],
        "test_tasks": [i for i, task in tasks.items() if task.role in ("test", "both")],
    }
    folder.mkdir(parents=True)
    (folder / f"{family}_{num_tasks}.json").write_text(json.dumps(split) + "\n", encoding="utf-8")


def _as_dict(episode: Episode) -> dict[str, NDArray[Any]]:
    ends = episode.terminations | episode.truncations
    # Copies: a view of the file would be pickled as numpy's memmap.
    return {
        "observations": np.array(episode.observations[:-1]),
        "next_observations": np.array(episode.observations[1:]),
        "actions": np.array(episode.actions),
        "rewards": np.array(episode.rewards)[:, None],
        "terminals": np.array(ends)[:, None],
    }


class _OldNames(pickle._Pickler):  # the class in Python: only it has a method to override
    """Writes the module names that NumPy had before 2.0, which NumPy 2 still reads."""

    def save_global(self, obj: Any, name: str | None = None) -> None:
        module = getattr(obj, "__module__", None) or ""
        if not module.startswith("numpy._core"):
            super().save_global(obj, name)  # type: ignore[misc]
            return
        self.save(module.replace("numpy._core", "numpy.core"))  # type: ignore[attr-defined]
        self.save(name or obj.__qualname__)  # type: ignore[attr-defined]
        self.write(pickle.STACK_GLOBAL)  # type: ignore[attr-defined]
        self.memoize(obj)  # type: ignore[attr-defined]


def _dump(value: Sequence[Mapping[str, Any]], path: Path) -> None:
    with path.open("wb") as file:
        _OldNames(file, protocol=4).dump(value)
