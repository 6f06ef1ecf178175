"""replay: a share of the episodes, simulated again from seed, goal and stored actions, gives the
stored bytes.

No policy acts, so neither weights nor BLAS matter: what is shown is that the simulator of this
machine gives the stored observations, rewards and flags for the stored actions. `amount.py` says
which episodes these are.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.lock.file import decisive_packages
from mpdt.data.lock.fingerprint import other_versions
from mpdt.data.lock.keeper import MACHINE
from mpdt.data.sim.batch import BatchEnv, Play
from mpdt.data.sim.simulators import make_batch
from mpdt.data.sim.stored import play_stored
from mpdt.data.spec.family import Family, definition
from mpdt.data.store import provenance
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.origin import again_hint
from mpdt.data.verify.amount import Amount, chosen
from mpdt.data.verify.finding import Fault, Finding, Outcome, fault, judge, nothing
from mpdt.data.verify.material import Material
from mpdt.data.verify.one_step import with_one_step
from mpdt.data.verify.seeds import Seeds
from mpdt.data.workers.processes import map_blocks
from mpdt.errors import DataError, MpdtError, UsageError, quoted
from mpdt.pace import Pace

ID = "replay"
ROWS = 50  # episodes side by side
WORTH_IT_S = 4.0
"""Seconds of stepping from which on processes are started for it, which takes one or two."""
NOTHING = "asked for, but nothing was replayed"


@dataclass(frozen=True)
class Replayed:
    """One episode that was simulated again.

    Args:
        place: its position in the sequence that was asked for.
        differing: names of the arrays that are not byte-equal.
        largest: largest difference of an observation.
    """

    place: int
    num_steps: int
    differing: tuple[str, ...]
    largest: float


@dataclass(frozen=True)
class _Some:
    """Episodes of one task that are played side by side, and their places in the sequence."""

    task: int
    places: tuple[int, ...]
    episodes: tuple[Episode, ...]

    @property
    def num_steps(self) -> int:
        return sum(episode.length for episode in self.episodes)


@dataclass(eq=False)
class _Player:
    """Plays and compares; the same in this process and in another one."""

    family: Family
    options: dict[str, Any]
    horizon: int
    seeds: Seeds
    seconds: float = 0.0
    """Spent on stepping, here."""
    _env: tuple[tuple[int, int], BatchEnv] | None = field(default=None, repr=False)

    def __call__(self, some: _Some) -> list[Replayed]:
        wanted = some.task, len(some.places)
        if self._env is None or self._env[0] != wanted:  # building one takes a while
            tasks = [self.family.tasks[some.task]] * len(some.places)
            self._env = wanted, make_batch(self.family, tasks, self.options)
        keys = [self.seeds.key(episode) for episode in some.episodes]
        began = time.monotonic()
        play = play_stored(self._env[1], some.episodes, keys)
        self.seconds += time.monotonic() - began
        return [
            _compare(self.family, place, some.episodes[row], play, row, self.horizon)
            for row, place in enumerate(some.places)
        ]


def replay(
    dataset: Dataset, episodes: Sequence[Episode], horizon: int, seed: Any, workers: int = 0
) -> Iterator[Replayed]:
    """Simulate `episodes` of `dataset` again, task by task; results as they come.

    Args:
        horizon: steps after which an episode of these is truncated; 0 = nobody said.
        seed: the root seed, as the file says it; what an import was begun with stands in its spec.
        workers: processes for what would take this one longer than `WORTH_IT_S`; below two none.
            In a script they need `if __name__ == "__main__":`.
    Raises: DataError for episodes without seed; UsageError for a family or goal that cannot be
        simulated; SimulatorError.
    """
    family = dataset.contract()
    seeds = Seeds.of(dataset, seed)
    by_task: dict[int, list[int]] = {}
    for place, episode in enumerate(episodes):
        seeds.check(episode)
        by_task.setdefault(episode.task, []).append(place)
    waiting = deque(
        _Some(task, tuple(places[i : i + ROWS]), tuple(episodes[p] for p in places[i : i + ROWS]))
        for task, places in sorted(by_task.items())
        for i in range(0, len(places), ROWS)
    )
    player, steps = _Player(family, dict(dataset.spec.get("env") or {}), horizon, seeds), 0
    while waiting:
        left = sum(some.num_steps for some in waiting)
        if workers > 1 and len(waiting) > 1 and left * player.seconds > WORTH_IT_S * steps:
            others = replace(player, _env=None)
            with closing(map_blocks(others, waiting, workers)) as done:
                for found in done:
                    yield from found
            return
        steps += waiting[0].num_steps
        yield from player(waiting.popleft())


def _compare(
    family: Family, place: int, episode: Episode, play: Play, row: int, horizon: int
) -> Replayed:
    length = episode.length
    observations = play.observations[row, : length + 1].astype(np.float32)
    observations[:, list(family.hidden_columns)] = 0.0
    found = {
        "observations": observations,
        "rewards": play.rewards[row, :length].astype(np.float32),
        "terminations": play.terminations[row, :length],
    }
    if horizon:
        found["truncations"] = np.arange(1, length + 1) == horizon
    if episode.successes is not None and play.successes is not None:
        found["successes"] = play.successes[row, :length]
    differing = tuple(
        name for name, array in found.items() if array.tobytes() != getattr(episode, name).tobytes()
    )
    largest = float(np.abs(observations - episode.observations).max()) if differing else 0.0
    return Replayed(place, length, differing, largest)


@dataclass
class _Tally:
    episodes: int = 0
    steps: int = 0
    equal: int = 0
    largest: float = 0.0
    faults: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def add(self, done: Replayed, track: str, id: int) -> None:
        self.episodes += 1
        self.steps += done.num_steps
        self.equal += not done.differing
        self.largest = max(self.largest, done.largest)
        if done.differing:
            what = f"other {' and '.join(done.differing)} when simulated again"
            self.faults.setdefault((what, track), []).append(id)


def check_replay(
    material: Material,
    amount: Amount,
    say: Callable[[str], None],
    workers: int = 0,
    asked: bool = False,
) -> Finding:
    """What `amount` of the file shows.

    Args:
        workers: as `replay`.
        asked: somebody wants this very check: that it cannot be made is a failure.
    """
    data, tally = material.dataset, _Tally()
    names = decisive_packages(data.family)
    other = other_versions(data.packages, provenance.packages(), names)
    machine = other_versions(data.platform, provenance.machine(), MACHINE[:2])
    excuse = ", ".join(part for part in (_other_family(material), other, machine) if part)
    began, pace = time.monotonic(), Pace()
    inexact = _is_inexact(material)
    try:
        for track, ids, episodes, horizon in [] if inexact else chosen(material, amount):
            of = f" of {track}" if track else ""
            say(f"replay   {len(ids):,} episodes{of}")
            first = tally.episodes
            for done in replay(data, episodes, horizon, _seed(data, track), workers):
                tally.add(done, track, ids[done.place])
                if pace.is_time():
                    say(f"replay   {tally.episodes - first:,}/{len(ids):,} episodes{of}  "
                        f"{tally.steps / (time.monotonic() - began):,.0f} steps/s")  # fmt: skip
    except MpdtError as error:
        hint = error.hint or "--skip replay leaves this check out"
        # A file of our own whose goals or seeds the simulator refuses is damaged.
        ours = material.family is not None and not material.is_imported and not excuse
        damaged = ours and isinstance(error, UsageError | DataError)
        outcome = Outcome.FAIL if damaged or asked else Outcome.WARN
        what = "not simulated" if damaged else "not checked"
        if asked:
            after = f"stopped after {tally.episodes:,} episodes"
            what = after if tally.episodes else NOTHING
        return Finding(ID, outcome, f"{what}: {error.message()}", hint=hint)
    if tally.episodes:
        seconds = max(time.monotonic() - began, 1e-9)
        say(f"replay   {tally.steps:,} steps in {seconds:.1f} s: {tally.steps / seconds:,.0f} "
            "steps/s")  # fmt: skip
    else:
        why = f"{data.family} says exact: false" if inexact else "no episode has a seed"
        bare = nothing(ID, why if len(data.episodes) else "no episodes")
        if asked and len(data.episodes):
            text = f"{NOTHING}: {why}"
            bare = Finding(ID, Outcome.FAIL, text, hint="--skip replay leaves this check out")
        return with_one_step(bare, material)
    faults = [
        fault(what, sorted(ids), track, doubt=bool(excuse))
        for (what, track), ids in tally.faults.items()
    ]
    if faults and excuse:
        faults.insert(0, Fault(
            f"{tally.equal}/{tally.episodes} episodes byte-equal, observations off by up to "
            f"{tally.largest:.1e}; made with others ({excuse})", is_doubt=True))  # fmt: skip
    passed = (
        f"{tally.episodes:,} episodes, {tally.steps:,} steps byte-equal "
        f"(mujoco {provenance.packages().get('mujoco', 'absent')})"
    )
    hint = f"mpdt-data verify {quoted(material.path)} --only replay --replay all; "
    hint += f"then {again_hint(material.dataset)}"
    return judge(ID, faults, passed, "" if excuse else hint)


def _seed(data: Dataset, track: str) -> Any:
    """The file's root seed; a set that an import got says its own."""
    rule = data.tta[track.removeprefix("tta ")].rule if track else {}
    return data.spec.get("seed", rule.get("seed"))


def _is_inexact(material: Material) -> bool:
    """Whether a simulator is here of which the family says that no seed decides it."""
    family = material.family
    return family is not None and family.simulates and not family.exact


def _other_family(material: Material) -> str:
    """How one's own family differs from the one that made the file, or nothing."""
    told, family = material.dataset.definition, material.family
    if not told or family is None or not family.simulates:
        return ""
    if told["version"] != family.version:
        return f"{family.name} {told['version']} -> {family.version}"
    same = told["fingerprint"] == definition(family)["fingerprint"]
    return "" if same else f"another definition of {family.name} {family.version}"
