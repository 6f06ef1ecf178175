"""Measure: play every reference policy until its mean return is known, and keep what was found.

    episodes   20 -> 40 -> 80 .. 1280     doubled until the standard error of the mean is under
                                          2 % of the span, expert - random
    round      the next doubling of every policy that needs one, in portions of at most 40

Portions are joined in the order of their rows, so neither workers nor interruptions change a
digit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from mpdt.data.sim.book import versions
from mpdt.data.sim.portions import ROWS, Player, Portion, expert_ladder, kind_of
from mpdt.data.sim.record import (
    LOCAL_FILE,
    Entry,
    Place,
    Score,
    check_target,
    constant_names,
    expert_name,
    load_entries,
    load_shipped,
    place_of,
    save_entries,
)
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.tasks import Task, get_family
from mpdt.data.workers.processes import map_blocks
from mpdt.disk import holding
from mpdt.pace import Pace

FIRST = 20  # episodes before the first decision
CAP = 1280
PRECISION = 0.02  # of the span
KINDS = ("random", "expert", "zero", "constant")
SAVE_EVERY_S = 10.0
RULE = (
    f"{FIRST} episodes per policy, doubled until the standard error of the mean return is under "
    f"{PRECISION} of |expert - random| or {CAP} are played; --most ends it earlier, and every "
    "score says after how many. constant+i and constant-i are +1 and -1 along action axis i, and "
    "zero is a candidate too. std is that of one episode (ddof 1)."
)


def episodes_wanted(score: Score | None, span: float | None, cap: int = CAP) -> int:
    """How many episodes a policy should have in all before it is looked at again.

    FIRST at least; a doubling that was interrupted is finished; doubled while the mean is not
    known to PRECISION and the cap allows. Without a span FIRST is all that can be asked for.
    """
    if score is None:
        return min(FIRST, cap)
    goal = FIRST
    while goal < score.episodes:
        goal *= 2
    if goal == score.episodes and span is not None and score.error > PRECISION * abs(span):
        goal *= 2
    return max(score.episodes, min(goal, cap))


@dataclass
class Campaign:
    """What is known of the tasks of a spec, and what is still to be played.

    `entries` holds a row for every task and horizon; `take` fills them.
    """

    spec: DatasetSpec
    horizons: tuple[int, ...]
    entries: dict[Place, Entry]
    kinds: Sequence[str] = KINDS
    cap: int = CAP
    _early: dict[tuple[Task, str], dict[int, dict[int, Score]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ladder = expert_ladder(self.spec)
        constants = constant_names(get_family(self.spec.family).action_size)
        self.policies = {
            task: ("random", expert_name(ladder, task), *constants)
            for task in self.spec.resolve_tasks()
        }

    def score(self, task: Task, policy: str, horizon: int) -> Score | None:
        return self.entries[place_of(self.spec, task, horizon)].scores.get(policy)

    def done(self, task: Task, policy: str, horizon: int) -> int:
        """Episodes played so far."""
        score = self.score(task, policy, horizon)
        return score.episodes if score else 0

    def span(self, task: Task, horizon: int) -> float | None:
        """expert - random; None before both are known."""
        random, expert = (self.score(task, name, horizon) for name in self.policies[task][:2])
        return expert.mean - random.mean if random and expert else None

    def wanted(self, task: Task, policy: str, horizon: int) -> int:
        """Episodes in all after the next round."""
        score, kind = self.score(task, policy, horizon), kind_of(policy)
        if kind in self.kinds:
            return episodes_wanted(score, self.span(task, horizon), self.cap)
        # The others need a rough span: it decides how many episodes are enough.
        return FIRST if kind in ("random", "expert") else 0

    def portions(self) -> list[Portion]:
        """The next round; empty when everything is known."""
        return [
            portion
            for task, policies in self.policies.items()
            for policy in policies
            for portion in self._portions(task, policy)
        ]

    def _portions(self, task: Task, policy: str) -> Iterator[Portion]:
        done = {horizon: self.done(task, policy, horizon) for horizon in self.horizons}
        goal = {horizon: self.wanted(task, policy, horizon) for horizon in self.horizons}
        short = [horizon for horizon in self.horizons if done[horizon] < goal[horizon]]
        if not short:
            return
        first = min(done[horizon] for horizon in short)
        together = tuple(horizon for horizon in short if done[horizon] == first)
        last = max(goal[horizon] for horizon in together)
        for row in range(first, last, ROWS):
            yield Portion(task, policy, together, row, min(ROWS, last - row))

    def take(self, portion: Portion, scores: dict[int, Score]) -> None:
        """Add a played portion; one that comes before its turn waits."""
        task, policy, horizon = portion.task, portion.policy, portion.horizons[0]
        early = self._early.setdefault((task, policy), {})
        early[portion.first] = scores
        while (found := early.pop(self.done(task, policy, horizon), None)) is not None:
            for steps, score in found.items():
                place = place_of(self.spec, task, steps)
                entry = self.entries[place]
                known = entry.scores.get(policy)
                joined = {policy: known.joined(score) if known else score}
                self.entries[place] = msgspec.structs.replace(entry, scores=entry.scores | joined)

    def steps_left(self) -> int:
        """Env steps that what is known so far lets expect."""
        return sum(
            max(self._left(task, policy, horizon) * horizon for horizon in self.horizons)
            for task, policies in self.policies.items()
            for policy in policies
        )

    def _left(self, task: Task, policy: str, horizon: int) -> int:
        score, span = self.score(task, policy, horizon), self.span(task, horizon)
        goal = self.wanted(task, policy, horizon)
        if goal and score and span:
            enough = math.ceil((score.std / (PRECISION * span)) ** 2)
            while goal < min(enough, self.cap):
                goal *= 2
        return max(0, min(goal, self.cap) - self.done(task, policy, horizon))


def measure(
    spec: DatasetSpec,
    target: Path | None = None,
    *,
    horizons: Sequence[int] = (),
    kinds: Sequence[str] = KINDS,
    seed: int = 1,
    cap: int = CAP,
    workers: int = 1,
    restart: bool = False,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Campaign:
    """Measure the reference policies of every task of a spec, or go on where it was stopped.

    Args:
        target: file to add to; default LOCAL_FILE in the working folder, which a collection
            prefers to what is shipped.
        horizons: default the spec's own.
        kinds: some of KINDS; of random and expert the others need at least FIRST episodes.
        workers: processes; 0 = this one, which then should have one BLAS thread.
        restart: count nothing that is already on record.
        on_progress: called with a line now and then; what it tells of is on the disk by then.

    Returns: the finished campaign; its `entries` are what `target` holds of this spec.

    Raises: DataError for a target that is no record, StorageError, SpecError: all before
        anything is played.
    """
    target = target or Path(LOCAL_FILE)
    check_target(target)
    book, steps = load_entries(target), tuple(horizons) or (spec.horizon,)
    known = {} if restart else _joined(*(_valid(b, seed) for b in (load_shipped(), book)))
    entries = {}
    for task in spec.resolve_tasks():
        for horizon in steps:
            place = place_of(spec, task, horizon)
            entries[place] = known.get(place) or Entry(
                scene=place[0], horizon=horizon, env=dict(spec.env), scores={},
                seed=seed, versions=versions(),
            )  # fmt: skip
    campaign = Campaign(spec, steps, entries, kinds, cap)
    player, number, clock = Player(spec, seed), 0, _Clock()
    while portions := campaign.portions():
        number += 1
        with closing(map_blocks(player, portions, workers)) as answers:
            try:
                for count, (portion, scores) in enumerate(answers, 1):
                    campaign.take(portion, scores)
                    clock.steps += portion.steps
                    if clock.pace.is_time(anyway=count == len(portions)):
                        book = _save(target, book, campaign, seed)
                        left = clock.text(campaign.steps_left())
                        on_progress(
                            f"round {number}  {count}/{len(portions)} portions  {left}  "
                            f"{portion.task.name} {portion.policy[:12]}"
                        )
            finally:  # an interrupt must not lose what has been played
                book = _save(target, book, campaign, seed)
    return campaign


def _save(
    target: Path, before: dict[Place, Entry], campaign: Campaign, seed: int
) -> dict[Place, Entry]:
    """Put the campaign's entries beside what is on record, and say what is there now.

    Args:
        before: what was there last; what differs now, another process wrote meanwhile.
    """
    with holding(target, amends=True):
        found = load_entries(target)
        others = {
            place: entry for place, entry in found.items()
            if place in campaign.entries and entry != before.get(place)
        }  # fmt: skip
        found |= _joined(_valid(others, seed), campaign.entries)
        save_entries(target, found.values(), RULE)
    return found


def _valid(book: dict[Place, Entry], seed: int) -> dict[Place, Entry]:
    """Entries that today's packages and this seed would give again."""
    return {
        place: entry
        for place, entry in book.items()
        if (entry.seed, entry.versions) == (seed, versions())
    }


def _joined(one: dict[Place, Entry], other: dict[Place, Entry]) -> dict[Place, Entry]:
    """Both; of a policy that is in both, what `other` says."""
    joined = one | other
    for place in one.keys() & other.keys():
        scores = one[place].scores | other[place].scores
        joined[place] = msgspec.structs.replace(other[place], scores=scores)
    return joined


@dataclass
class _Clock:
    """Steps per second, and when it is time to save and say so."""

    steps: int = 0
    start: float = field(default_factory=time.monotonic)
    pace: Pace = field(default_factory=lambda: Pace(SAVE_EVERY_S))

    def text(self, steps_left: int) -> str:
        rate = self.steps / max(1e-9, time.monotonic() - self.start)
        minutes = steps_left / max(rate, 1e-9) / 60
        return f"{rate:,.0f} steps/s  about {minutes:.0f} min left"
