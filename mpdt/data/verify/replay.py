"""replay: a share of the episodes, simulated again from seed, goal and stored actions, gives the
stored bytes.

No policy acts, so neither weights nor BLAS matter: what is shown is that the simulator of this
machine gives the stored observations, rewards and flags for the stored actions. The episodes lie
evenly spaced in every run of one task and quality, at least one of each; where the first one lies
comes from the content hash, so that a file is looked at in the same places.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
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
from mpdt.data.store.ttaset import tta_episodes
from mpdt.data.verify.finding import Fault, Finding, Outcome, fault, judge, nothing
from mpdt.data.verify.material import Material, Track
from mpdt.errors import DataError, MpdtError, UsageError, quoted
from mpdt.seeding import UNKNOWN_SEED_KEY, SeedKey

ID = "replay"
ROWS = 50  # episodes side by side


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


def replay(
    dataset: Dataset, episodes: Sequence[Episode], horizon: int, seed: Any
) -> Iterator[Replayed]:
    """Simulate `episodes` of `dataset` again, task by task.

    Args:
        horizon: steps after which an episode of these is truncated.
        seed: the root seed, as the file says it.
    Raises: DataError for episodes without seed; UsageError for a family or goal that cannot be
        simulated; SimulatorError.
    """
    family = dataset.contract()
    if not isinstance(seed, int):
        raise DataError("its spec has no seed", where=str(dataset.path))
    by_task: dict[int, list[int]] = {}
    for place, episode in enumerate(episodes):
        if episode.seed_key == UNKNOWN_SEED_KEY:
            raise DataError("episodes without a seed cannot be simulated", where=str(dataset.path))
        by_task.setdefault(episode.task, []).append(place)
    for task, places in sorted(by_task.items()):
        env: BatchEnv | None = None  # kept while its width fits: building one takes a while
        for first in range(0, len(places), ROWS):
            some = places[first : first + ROWS]
            if env is None or env.num_rows != len(some):
                options = dict(dataset.spec.get("env") or {})
                env = make_batch(family, [family.tasks[task]] * len(some), options)
            chosen = [episodes[place] for place in some]
            keys = [SeedKey(seed, *episode.seed_key) for episode in chosen]
            play = play_stored(env, chosen, keys)
            for row, place in enumerate(some):
                yield _compare(family, place, chosen[row], play, row, horizon)


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
        "truncations": np.arange(1, length + 1) == horizon,
    }
    if episode.successes is not None and play.successes is not None:
        found["successes"] = play.successes[row, :length]
    differing = tuple(
        name for name, array in found.items() if array.tobytes() != getattr(episode, name).tobytes()
    )
    largest = float(np.abs(observations - episode.observations).max()) if differing else 0.0
    return Replayed(place, length, differing, largest)


@dataclass(frozen=True)
class Amount:
    """How many episodes: a share of each run, or a number in all."""

    share: float | None = None
    number: int | None = None

    @classmethod
    def parse(cls, text: str) -> Amount:
        """`2%`, `40` or `all`. Raises: UsageError."""
        word = text.strip()
        try:
            if word == "all":
                return cls(share=1.0)
            if word.endswith("%") and 0 < float(word[:-1]) <= 100:
                return cls(share=float(word[:-1]) / 100)
            if int(word) > 0:
                return cls(number=int(word))
        except ValueError:
            pass
        raise UsageError("cannot read the amount", where="--replay", found=text,
                         expected="2%, 40 or all", hint="--skip replay for none")  # fmt: skip

    def of(self, run: int, total: int) -> int:
        """Episodes of a run of `run` among `total`; at least one."""
        share = self.share if self.share is not None else (self.number or 0) / max(1, total)
        return min(run, max(1, math.ceil(run * share - 1e-9)))


@dataclass
class _Tally:
    episodes: int = 0
    steps: int = 0
    equal: int = 0
    largest: float = 0.0
    faults: dict[tuple[str, str], list[int]] = field(default_factory=dict)


def check_replay(material: Material, amount: Amount, say: Callable[[str], None]) -> Finding:
    data, tally = material.dataset, _Tally()
    names = decisive_packages(data.family)
    other = other_versions(data.packages, provenance.packages(), names)
    machine = other_versions(data.platform, provenance.machine(), MACHINE[:2])
    excuse = ", ".join(part for part in (_other_family(material), other, machine) if part)
    try:
        for track, ids, episodes, horizon in _chosen(material, amount):
            say(f"replay   {len(ids):,} episodes{f' of {track}' if track else ''}")
            for done in replay(data, episodes, horizon, _seed(data, track)):
                tally.episodes += 1
                tally.steps += done.num_steps
                tally.equal += not done.differing
                tally.largest = max(tally.largest, done.largest)
                if done.differing:
                    what = f"other {' and '.join(done.differing)} when simulated again"
                    tally.faults.setdefault((what, track), []).append(ids[done.place])
    except MpdtError as error:
        hint = error.hint or "--skip replay leaves this check out"
        # A file of our own whose goals or seeds the simulator refuses is damaged.
        ours = material.family is not None and not material.is_imported and not excuse
        damaged = ours and isinstance(error, UsageError | DataError)
        outcome = Outcome.FAIL if damaged else Outcome.WARN
        return Finding(ID, outcome, f"not simulated: {error.message()}", hint=hint)
    if not tally.episodes:
        return nothing(ID, "no episode has a seed" if len(data.episodes) else "no episodes")
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


def _other_family(material: Material) -> str:
    """How one's own family differs from the one that made the file, or nothing."""
    told, family = material.dataset.definition, material.family
    if not told or family is None or not family.simulates:
        return ""
    if told["version"] != family.version:
        return f"{family.name} {told['version']} -> {family.version}"
    same = told["fingerprint"] == definition(family)["fingerprint"]
    return "" if same else f"another definition of {family.name} {family.version}"


def _chosen(material: Material, amount: Amount) -> list[tuple[str, list[int], list[Episode], int]]:
    """(track, ids, episodes, horizon) of the file's own episodes and of each TTA set.

    Imported episodes never had seeds; in a file that was collected somebody took them away.
    """
    data = material.dataset
    tracks = material.tracks()
    if "import" in data.spec:
        tracks = [track for track in tracks if _has_seeds(track)]
    total = sum(len(track) for track in tracks)
    found = []
    for track in tracks:
        kinds = getattr(track.table, "quality", np.zeros(len(track), np.int8))
        runs: dict[tuple[int, int], list[int]] = {}
        for i, key in enumerate(zip(track.table.task.tolist(), kinds.tolist(), strict=True)):
            runs.setdefault(key, []).append(i)
        ids = sorted(
            i for run in runs.values() for i in _spread(run, amount, total, data.content_hash)
        )
        if not ids:
            continue
        if track.horizon is None:
            raise DataError("its spec has no horizon", where=str(material.path))
        if track.label:
            name = track.label.removeprefix("tta ")
            every = list(tta_episodes(data, name, *material.sim[name]))
            episodes = [every[i] for i in ids]
        else:
            episodes = [data.episode(i) for i in ids]
        found.append((track.label, ids, episodes, track.horizon))
    return found


def _has_seeds(track: Track) -> bool:
    return not (track.table.seed_key == np.array(UNKNOWN_SEED_KEY)).all()


def _spread(run: list[int], amount: Amount, total: int, content_hash: str) -> list[int]:
    count = amount.of(len(run), total)
    offset = int(content_hash[:8], 16) / 2**32
    return [run[int((k + offset) * len(run) / count)] for k in range(count)]
