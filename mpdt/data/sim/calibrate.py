"""Calibrate: which mixing rate makes a Meta-World script `medium`, measured per task.

    level(u) = (R(u) - R(1)) / (R(0) - R(1))     u = chance per step of a uniform action

      level
       1.0 |                    o  script, u = 0     One answer although a curve may turn:
           |        x  x     x                       walk from the random side and stop at
       0.5 |.....x........x.....                     the first crossing of 0.5, then halve
           |  x                                      the step around it.
       0.0 o  random, u = 1

Where a noisy script beats the clean one (lever-pull) the level passes 1 later on; the first
crossing lies before that, so random < medium < expert holds by construction.

All rates of a task are measured on the same goals, coins and uniform actions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np

from mpdt.data.sim.batch import BatchEnv, FloatArray
from mpdt.data.sim.calibration import (
    Calibration,
    Measurement,
    check_target,
    local_path,
    save_calibrations,
)
from mpdt.data.sim.collect import run_block
from mpdt.data.sim.policies import ScriptedPolicy
from mpdt.data.sim.simulators import make_batch
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.tasks import get_family
from mpdt.errors import DataError, SpecError
from mpdt.seeding import Quality, SeedKey

STEP = 0.05  # of the walk over rates
RATES = tuple(round(1 - STEP * i, 6) for i in range(round(1 / STEP) + 1))  # 1, 0.95 .. 0
FINEST = 0.025  # where halving stops
SLACK = 0.1  # a curve may turn by this much and count as monotone
ERROR = 0.025  # standard error of the level that ends the careful measurement
PORTIONS = 4  # at most so many times the careful number of episodes
CLOSE = 0.03  # a level this near 0.5 is not improved further
BAND = (0.40, 0.60)  # a medium outside is refused; `levels.py` allows [0.35, 0.65]


RULE = (
    f"Mixing rates are walked from 1 (uniform) to 0 (script) in steps of {STEP}. Around the "
    "first level >= 0.5 that stands up to the larger number of episodes the step is halved "
    f"down to {FINEST}. The nearest rate is measured again with up to {PORTIONS} times the "
    f"episodes, until the level is known to {ERROR}, and moved by {FINEST} while it is more "
    f"than {CLOSE} from 0.5; it must end in [{BAND[0]}, {BAND[1]}]. Where the curve turns "
    "(monotone: false) only this first crossing counts, so random < medium < expert in return."
)


def find_rate(level: Callable[[float, bool], float]) -> float:
    """Rate of `medium`: the first crossing of level 0.5, seen from the random side.

    Args:
        level: (rate, careful) -> level; `careful` asks for more episodes. Level 0 at rate 1
            and 1 at rate 0 hold by definition and are not asked for.

    Returns: the carefully measured rate nearest 0.5, a multiple of FINEST; of two equally
        near ones the more random.
    """
    careful: dict[float, float] = {1.0: 0.0, 0.0: 1.0}

    def passes(rate: float) -> bool:
        if rate not in careful:
            careful[rate] = level(rate, True)
        return careful[rate] >= 0.5

    walk = list(RATES)
    between = walk[1:-1]
    place = next(
        (i for i, rate in enumerate(between, 1) if level(rate, False) >= 0.5), len(walk) - 1
    )
    # The walk used few episodes, so ask again with more on both sides of the crossing.
    while not passes(walk[place]):
        place += 1
    while passes(walk[place - 1]):
        place -= 1
    script_side, random_side = walk[place], walk[place - 1]
    while random_side - script_side > FINEST + 1e-9:
        middle = round((script_side + random_side) / 2, 6)
        if passes(middle):
            script_side = middle
        else:
            random_side = middle
    return min(sorted(careful, reverse=True), key=lambda rate: abs(careful[rate] - 0.5))


def settle(level: Callable[[float], float], start: float) -> float:
    """Walk from `start` towards level 0.5 in steps of FINEST, until CLOSE or past it.

    Args:
        level: rate -> level, known to about ERROR.

    Returns: the visited rate nearest 0.5.
    """
    seen = {start: level(start)}
    rate = start
    while abs(seen[rate] - 0.5) > CLOSE:
        rate = round(rate + (FINEST if seen[rate] > 0.5 else -FINEST), 6)
        if rate in seen or not 0.0 < rate < 1.0:
            break
        seen[rate] = level(rate)
    return min(sorted(seen, reverse=True), key=lambda visited: abs(seen[visited] - 0.5))


class Probe:
    """Measures mixing rates of one task, every rate on the same episodes' keys."""

    def __init__(self, task_name: str, horizon: int, seed: int) -> None:
        # mt50 holds every task, so a calibration does not depend on the family that asked.
        self._family = get_family("mt50")
        self.task = self._family.task(task_name)
        self.horizon, self.seed = horizon, seed
        self._env: BatchEnv = make_batch(self._family, [self.task])
        self._seen: dict[float, list[tuple[float, bool]]] = {}

    def outcomes(self, rate: float, num_episodes: int) -> tuple[FloatArray, FloatArray]:
        """Returns and successes (0 or 1) of the first `num_episodes` episodes, (N,) each."""
        seen = self._seen.setdefault(rate, [])
        policy = ScriptedPolicy([self.task.name], rate)
        for row in range(len(seen), num_episodes):
            place = (self._family.id, self.task.index, Quality.CALIBRATION, 0, row)
            key = SeedKey(self.seed, *place)
            (episode,) = run_block(
                self._env, policy, [key], horizon=self.horizon, quality=-1, progress=-1.0
            )
            seen.append((episode.episode_return, episode.success))
        returns, successes = zip(*seen[:num_episodes], strict=True)
        return np.array(returns), np.array(successes, dtype=np.float64)


@dataclass(frozen=True)
class Scale:
    """What turns returns into levels: the mean return at rate 1, and up to rate 0."""

    low: float
    span: float

    @classmethod
    def of(cls, probe: Probe, num_random: int, num_script: int) -> Scale:
        low = float(probe.outcomes(1.0, num_random)[0].mean())
        return cls(low, float(probe.outcomes(0.0, num_script)[0].mean()) - low)

    def measure(self, probe: Probe, rate: float, num_episodes: int) -> Measurement:
        returns, successes = probe.outcomes(rate, num_episodes)
        error = returns.std(ddof=1) / self.span / np.sqrt(num_episodes)
        return Measurement(
            rate=rate,
            episodes=num_episodes,
            mean_return=round(float(returns.mean()), 3),
            success=round(float(successes.mean()), 4),
            level=round(float((returns.mean() - self.low) / self.span), 4),
            level_error=round(float(error), 4),
        )


def calibrate_task(
    task_name: str, horizon: int, *, seed: int = 1, coarse: int = 6, careful: int = 60
) -> Calibration:
    """Find the mixing rate of `medium` of one task; `coarse` and `careful` count episodes.

    Raises: DataError if the script is no better than uniform actions, or if no measured
        rate comes into BAND (more `careful` episodes may help).
    """
    probe = Probe(task_name, horizon, seed)
    first = Scale.of(probe, careful, careful)
    if first.span <= 0:
        raise DataError(
            "the script earns no more than uniform actions",
            where=f"{task_name}, horizon {horizon}",
            expected=f"a return above {first.low:.1f}",
            found=f"{first.low + first.span:.1f}",
        )

    def rough_level(rate: float, is_careful: bool) -> float:
        return first.measure(probe, rate, careful if is_careful else coarse).level

    start = find_rate(rough_level)
    return refine(probe, start, coarse=coarse, careful=careful)


def refine(probe: Probe, start: float, *, coarse: int, careful: int) -> Calibration:
    """From the rate `find_rate` answered to the calibration, with enough episodes."""
    span = Scale.of(probe, careful, careful).span
    scale = Scale.of(probe, *(_enough(probe, end, span, careful) for end in (1.0, 0.0)))

    def measure(rate: float) -> Measurement:
        return scale.measure(probe, rate, _enough(probe, rate, scale.span, careful))

    medium = measure(settle(lambda rate: measure(rate).level, start))
    if not BAND[0] <= medium.level <= BAND[1]:
        raise DataError(
            "no mixing rate of the grid gives half the script's return",
            where=f"{probe.task.name}, horizon {probe.horizon}",
            expected=f"a level in [{BAND[0]}, {BAND[1]}]",
            found=f"{medium.level} at rate {medium.rate}",
        )
    curve = tuple(scale.measure(probe, rate, coarse) for rate in RATES[1:-1])
    expert = measure(0.0)
    return Calibration(
        task=probe.task.name,
        horizon=probe.horizon,
        rate=medium.rate,
        level=medium.level,
        random=measure(1.0),
        medium=medium,
        expert=expert,
        monotone=is_monotone(curve, expert.level_error),
        curve=curve,
        seed=probe.seed,
        versions={name: metadata.version(name) for name in ("metaworld", "mujoco", "numpy")},
    )


def _enough(probe: Probe, rate: float, span: float, careful: int) -> int:
    """Episodes after which the level of `rate` is known to ERROR, in portions of `careful`."""
    for portion in range(1, PORTIONS + 1):
        returns, _ = probe.outcomes(rate, portion * careful)
        if returns.std(ddof=1) / np.sqrt(len(returns)) <= ERROR * span:
            break
    return portion * careful


def is_monotone(curve: Sequence[Measurement], script_error: float) -> bool:
    """Whether levels rise towards the script and end there, but for noise and SLACK.

    `curve` runs from the random side to the script's, whose own level has `script_error`.
    False if a level falls below an earlier one, or if one rises above 1, by more than SLACK
    and two standard errors of what is compared.
    """
    best = 0.0
    for point in curve:
        room = SLACK + 2 * point.level_error
        if point.level < best - room or point.level > 1 + room + 2 * script_error:
            return False
        best = max(best, point.level)
    return True


def calibrate(
    spec: DatasetSpec,
    target: Path | None = None,
    *,
    seed: int = 1,
    coarse: int = 6,
    careful: int = 60,
    on_progress: Callable[[Calibration], None] | None = None,
) -> Path:
    """Calibrate every task of a Meta-World spec at its horizon; about a minute per task.

    Args:
        target: file to add to; default LOCAL_FILE in the working folder, which the ladder
            prefers to what is shipped.
        on_progress: called with each result; each is on disk before the next one starts.

    Raises: SpecError for a spec whose behaviour is not the script; StorageError, and DataError
        for a target that is no calibration file, both before anything is measured.
    """
    if spec.behaviour.script != "metaworld":
        raise SpecError(
            "nothing to calibrate: only scripted behaviour has a mixing rate",
            where=f"{spec.name}.behaviour",
            hint=f"mpdt-data pretrain {spec.name}",
        )
    target = target or local_path()
    check_target(target)
    for task in spec.resolve_tasks():
        result = calibrate_task(task.name, spec.horizon, seed=seed, coarse=coarse, careful=careful)
        save_calibrations(target, [result], RULE)
        if on_progress is not None:
            on_progress(result)
    return target
