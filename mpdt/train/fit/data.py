"""What of a data file is trained on: tasks, episodes, returns, simulator options.

FILE[:slice] --quality-->  episodes of the training tasks (role train or both)
                           their range of returns-to-go and the return asked for
                           the test tasks (role test or both): names only
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.slices.sampler import SamplerSettings, WindowSampler
from mpdt.data.slices.several import open_ref
from mpdt.data.slices.windows import RewardReturns, WindowBatch, gather_windows
from mpdt.data.spec.goals import GoalSet
from mpdt.data.spec.tasks import Family, Task
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.origin import again_hint
from mpdt.errors import DataError, quoted, unknown_name
from mpdt.model.returns import ReturnTable
from mpdt.seeding import SeedKey, generator_at

Ids = NDArray[np.int64]
AUTO, ALL = "auto", "all"


@dataclass(frozen=True)
class Material:
    """An open file and the part of it that training may see.

    Attributes:
        quality: what was chosen, never `auto`.
        train_rows, test_rows: rows of /tasks; the order of the prompts.
        episode_ids: per training row, absolute ids.
        options, horizon: how the simulator of the data was set.
        validation_ids: per row, those that are looked at and not trained on; a row may be none of
            `train_rows`, where the task was held out whole.
    """

    dataset: Dataset
    slice: str | None
    quality: str
    family: Family
    train_rows: tuple[int, ...]
    test_rows: tuple[int, ...]
    episode_ids: Mapping[int, Ids]
    validation_ids: Mapping[int, Ids] = field(default_factory=dict)

    @property
    def options(self) -> Mapping[str, float | bool]:
        options: Mapping[str, float | bool] = self.dataset.spec.get("env", {})
        return options

    @property
    def horizon(self) -> int:
        return int(self.dataset.spec.get("horizon", self.family.horizon))

    @property
    def goals(self) -> GoalSet | None:
        """Numbered goals of the data, some held out; None: a goal of its own per episode."""
        found = self.dataset.spec.get("goals")
        return None if found is None else GoalSet(**found)

    @property
    def one_table(self) -> bool:
        """Whether test and training episodes are the same: same tasks, nothing held out."""
        return self.test_rows == self.train_rows and self.goals is None

    def goal_key(self, key: SeedKey, block: str) -> SeedKey:
        """What an evaluation episode's goal is drawn from: training or held-out ones in turn."""
        if self.goals is None:
            return key
        key = replace(key, seed=int(self.dataset.spec["seed"]))
        draw = self.goals.training_key if block == "train" else self.goals.held_out_key
        return draw(key, 1)

    def num_goals(self, block: str) -> int | None:
        """Goals of a task that `goal_key` takes in turn; None: as many as episodes."""
        if self.goals is None:
            return None
        held_out = self.goals.held_out
        return self.goals.count - held_out if block == "train" else held_out

    def tasks(self, rows: Sequence[int]) -> list[Task]:
        """The family's tasks behind rows of the file."""
        return [self.family.task(self.dataset.tasks.names[row]) for row in rows]

    def sampler(
        self, settings: SamplerSettings, seed: int, ids: Mapping[int, Ids] | None = None
    ) -> WindowSampler:
        """Windows of the training tasks.

        Args:
            ids: other episodes than those trained on, per training row.
        """
        return WindowSampler(
            self.dataset, ids or self.episode_ids, self.train_rows, settings.window,
            settings.per_task, seed, settings.start_bias, settings.tasks_per_update,
            settings.order,
        )  # fmt: skip

    def random_ids(self) -> dict[int, Ids]:
        """Random-quality episodes of the training tasks, wherever the slice ends.

        Raises: DataError if the file holds none.
        """
        ids = {row: self.dataset.select(task=row, quality="random") for row in self.train_rows}
        if not all(len(of_task) for of_task in ids.values()):
            raise DataError(
                "no random episodes of the training tasks",
                where=str(self.dataset.path),
                hint="use the family's whole file, or leave out `infer` and "
                "--statistics.source random; trials alone: --adapt.trials.infer world",
            )
        return ids


def load_material(ref: str, quality: str, validation: str | None = None) -> Material:
    """Open `FILE` or `FILE:slice` and choose the episodes to train on.

    Args:
        quality: random, medium, expert, history, policy; `all`; `auto` = expert where there is
            some, else the only quality present (a cut-out such as ml10-medium.h5).
        validation: a slice whose episodes are not trained on.
    Raises: UsageError for unknown names; DataError if a training task has no such episode or
        the file has no statistics; whatever `open_dataset` raises.
    """
    known = [*QUALITY_CODES, ALL, AUTO]
    if quality not in known:
        raise unknown_name("quality", quality, known, where="--quality")
    dataset, slice_name = open_ref(ref)
    path = dataset.path
    if slice_name is not None and slice_name not in dataset.slices:
        raise unknown_name("slice", slice_name, dataset.slices, where=str(path))
    train_rows = tuple(dataset.tasks.train_rows)
    if not train_rows:
        raise DataError("no training task in this file", where=str(path),
                        expected="a task of role train or both",
                        hint="cut-outs of test tasks cannot be trained on")  # fmt: skip
    if "observations" not in dataset.stats:
        raise DataError(
            "no statistics of the training tasks", where=str(path), hint=again_hint(dataset)
        )
    chosen = _choose_quality(dataset, slice_name, train_rows, quality)
    ids = {
        row: dataset.select(task=row, quality=None if chosen == ALL else chosen, slice=slice_name)
        for row in train_rows
    }
    held: dict[int, Ids] = {}
    if validation is not None:
        ids, held = _without(dataset, ids, validation)
        train_rows = tuple(ids)
    for row, of_task in ids.items():
        if not len(of_task):
            present = ", ".join(_qualities(dataset, slice_name, row)) or "nothing"
            raise DataError(
                f"no {chosen} episodes of training task {dataset.tasks.names[row]}",
                where=ref, found=present,
                hint="choose another --quality, or another slice",
            )  # fmt: skip
    return Material(
        dataset=dataset, slice=slice_name, quality=chosen, family=dataset.contract(),
        train_rows=train_rows, test_rows=tuple(dataset.tasks.test_rows), episode_ids=ids,
        validation_ids=held,
    )  # fmt: skip


def _without(
    dataset: Dataset, ids: Mapping[int, Ids], name: str
) -> tuple[dict[int, Ids], dict[int, Ids]]:
    """What is trained on and what is looked at, by row; a row without any is in neither.

    Raises: UsageError for an unknown slice; DataError for one that holds test tasks or nothing of
        what was chosen, or that leaves nothing.
    """
    where = f"{dataset.path}:{name}"
    chosen = dataset.select(slice=name)
    tested = set(dataset.episodes.task[chosen].tolist()) - set(dataset.tasks.train_rows)
    if tested:
        names = [dataset.tasks.names[row] for row in sorted(tested)]
        raise DataError("a validation slice must not hold tasks that are only tested on",
                        where=where, found=", ".join(names[:3]),
                        hint=f"mpdt-data split {quoted(dataset.path)} --validation 0.1 makes one"
                        )  # fmt: skip
    held = {row: np.intersect1d(own, chosen) for row, own in ids.items()}
    left = {row: np.setdiff1d(own, chosen) for row, own in ids.items()}
    for what, found in (("no episode to validate on", held), ("nothing left to train on", left)):
        if not any(map(len, found.values())):
            raise DataError(f"{what} among those chosen by --data and --quality", where=where,
                            hint="choose another --validation, or make it of all qualities"
                            )  # fmt: skip
    whole = {row for row in ids if len(held[row]) and not len(left[row])}
    return (
        {row: own for row, own in left.items() if row not in whole},
        {row: own for row, own in held.items() if len(own)},
    )


def return_table(
    material: Material, kind: Literal["none", "family", "task"], quantile: float
) -> ReturnTable:
    """Range, scale and target of each training task, from the episodes trained on.

    low, high: over the returns-to-go of all steps. scale: the largest magnitude of them
    (`task`) or the family's published one. target: the `quantile` of the *episode returns*
    (`task`) or the family's. The largest return-to-go would not do as a target: where rewards
    are negative it is the 0 of an episode's last step, which no first step ever shows.
    `none`: nothing is shown, so nothing is read; the table only says how many tasks there are.
    """
    n = len(material.train_rows)
    if kind == "none":
        one, zero = torch.ones(n), torch.zeros(n)
        return ReturnTable(scale=one, low=zero, high=zero, target=zero)
    ranges = [_range_and_returns(material, row) for row in material.train_rows]
    low, high = [low for low, _, _ in ranges], [high for _, high, _ in ranges]
    size = [max(abs(a), abs(b)) or 1.0 for a, b in zip(low, high, strict=True)]
    target = [float(np.quantile(returns, quantile)) for _, _, returns in ranges]
    if kind == "family":
        size, target = [material.family.return_scale] * n, [material.family.return_target] * n
    return ReturnTable(*(torch.tensor(x, dtype=torch.float32) for x in (size, low, high, target)))


def sample_demonstrations(
    material: Material,
    steps: int,
    seed: int,
    rows: Sequence[int] | None = None,
    each: int = 64,
) -> WindowBatch:
    """`each` stretches of `steps` steps for every task row, (N, each, steps, ...), no pads.

    Training tasks (`rows` None) show what they are trained on, others their expert. Episodes
    uniformly, then starts uniformly among those with enough steps behind them.

    Raises: DataError if a task's episodes are all shorter than that.
    """
    dataset, episodes, starts = material.dataset, [], []
    lengths = np.asarray(dataset.episodes.length, np.int64)
    for row in material.train_rows if rows is None else rows:
        own = material.dataset.select(task=row, quality="expert")
        own = own if rows is not None else material.episode_ids[row]
        generator = generator_at(seed, row)
        long = own[lengths[own] >= steps]
        if not len(long):
            raise DataError(f"no episode of {dataset.tasks.names[row]} is as long as a prompt",
                            where=str(dataset.path), expected=f"{steps} steps",
                            hint="lower --prompts.length")  # fmt: skip
        episodes.append(generator.choice(long, size=each))
        starts.append(generator.integers(lengths[episodes[-1]] - steps + 1))
    return gather_windows(
        dataset, np.stack(episodes), np.stack(starts), steps,
        RewardReturns(dataset, dataset.steps.rewards),
    )  # fmt: skip


def _range_and_returns(material: Material, row: int) -> tuple[float, float, list[float]]:
    """Smallest and largest return-to-go of a task's episodes, and the return of each.

    One episode in memory at a time.
    """
    rewards, episodes = material.dataset.steps.rewards, material.dataset.episodes
    low, high, returns = math.inf, -math.inf, []
    for i in material.episode_ids[row]:
        first = int(episodes.start[i])
        own = np.asarray(rewards[first : first + int(episodes.length[i])], np.float64)
        to_go = np.cumsum(own[::-1])
        low, high = min(low, float(to_go.min())), max(high, float(to_go.max()))
        returns.append(float(to_go[-1]))
    return low, high, returns


def _qualities(dataset: Dataset, slice_name: str | None, rows: int | Sequence[int]) -> list[str]:
    """Names of the qualities present for these task rows, in the order of their codes."""
    codes = set(dataset.episodes.quality[dataset.select(task=rows, slice=slice_name)].tolist())
    return [name for name, code in QUALITY_CODES.items() if code in codes]


def _choose_quality(
    dataset: Dataset, slice_name: str | None, rows: Sequence[int], quality: str
) -> str:
    if quality != AUTO:
        return quality
    present = _qualities(dataset, slice_name, list(rows))
    if "expert" in present:
        return "expert"
    if not present:
        return ALL  # imported files of unknown quality
    if len(present) > 1:
        raise DataError("several qualities and no expert among them", where=str(dataset.path),
                        found=", ".join(present), hint="choose one with --quality")  # fmt: skip
    return present[0]
