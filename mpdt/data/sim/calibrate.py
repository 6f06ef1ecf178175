"""Calibrate: which mixing rate makes a script `medium`, measured per task.

    level(u) = (R(u) - R(1)) / (R(0) - R(1))     u = chance per step of a uniform action

      level
       1.0 |                    o  script, u = 0     One answer although a curve may turn:
           |        x  x     x                       the coarse curve (x), smoothed, is walked
       0.5 |.....x........x.....                     from the random side to its first crossing
           |  x                                      of 0.5; the search starts there.
       0.0 o  random, u = 1

Where a noisy script beats the clean one the level passes 1 later on; the first crossing lies
before that, so random < medium < expert holds by construction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from mpdt.data.sim.book import versions
from mpdt.data.sim.calibration import (
    Calibration,
    Measurement,
    Place,
    check_target,
    local_path,
    read_calibrations,
    save_calibrations,
)
from mpdt.data.sim.ladder import load_ladder
from mpdt.data.sim.probe import Gauge, Probe, Script
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts
from mpdt.data.spec.tasks import get_family
from mpdt.data.workers.processes import map_blocks
from mpdt.errors import DataError, Lines, SpecError, quoted

STEP = 0.1  # of the coarse curve
RATES = tuple(round(1 - STEP * i, 6) for i in range(1, round(1 / STEP)))  # 0.9, 0.8 .. 0.1
FINEST = 0.01  # rates of medium are multiples of it
SLACK = 0.1  # a curve may turn by this much and count as monotone
ERROR = 0.025  # standard error of the level that ends a careful measurement
PORTIONS = 5  # at most so many times `careful` episodes
CLOSE = 0.05  # a level this near 0.5 is not improved further
TRIES = 8  # rates measured carefully
STRIDE = 0.1  # longest step of the search while only one side of 0.5 is known
BAND = (0.40, 0.60)  # a medium outside is refused; `levels.py` allows [0.35, 0.65]

RULE = (
    f"A coarse curve of levels at rates {RATES[0]} to {RATES[-1]} in steps of {STEP}, each "
    "averaged with its neighbours (weights 1 2 1), is walked from rate 1 (uniform) to 0 (script) "
    "to its first crossing of 0.5. From there rates are measured carefully, with up to "
    f"{PORTIONS} portions of episodes until the level is known to {ERROR}, and moved in "
    f"multiples of {FINEST} until the level is within {CLOSE} of 0.5; it must end in "
    f"[{BAND[0]}, {BAND[1]}]. Where the curve turns (monotone: false) only this first crossing "
    "counts, so random < medium < expert in return."
)


def first_crossing(levels: Sequence[float]) -> tuple[float, float]:
    """Where the smoothed coarse curve first passes 0.5 from the random side.

    Args:
        levels: at RATES; level 0 at rate 1 and 1 at rate 0 are added.

    Returns: the rate, a multiple of FINEST strictly between 0 and 1; and how much the level
        rises there per unit of rate towards the script, kept within [1, 10].
    """
    rates = np.array([1.0, *RATES, 0.0])
    raw = np.array([0.0, *levels, 1.0])
    smooth = raw.copy()
    smooth[1:-1] = (raw[:-2] + 2 * raw[1:-1] + raw[2:]) / 4
    after = int(np.argmax(smooth >= 0.5))  # exists: the last one is 1
    before = after - 1
    rise = (smooth[after] - smooth[before]) / STEP
    rate = rates[before] - (0.5 - smooth[before]) / rise
    return _on_grid(float(rate)), float(np.clip(rise, 1.0, 10.0))


def find_rate(level: Callable[[float], float], start: float, rise: float) -> float:
    """From `start` to a rate whose level is within CLOSE of 0.5, or to the nearest one met.

        level known on one side of 0.5:   go (0.5 - level) / rise, at most STRIDE
        on both sides:                    go where the straight line between them says

    Args:
        level: rate -> level, measured carefully.
        rise: of the level per unit of rate towards the script.
    """
    seen: dict[float, float] = {}
    rate = start
    while rate not in seen and len(seen) < TRIES:
        seen[rate] = level(rate)
        if abs(seen[rate] - 0.5) <= CLOSE:
            break
        rate = _next_rate(seen, rate, rise)
    return min(sorted(seen, reverse=True), key=lambda visited: abs(seen[visited] - 0.5))


def _next_rate(seen: dict[float, float], rate: float, rise: float) -> float:
    too_good = [known for known, level in seen.items() if level >= 0.5]
    too_bad = [known for known, level in seen.items() if level < 0.5]
    if not too_good or not too_bad:
        wish = (0.5 - seen[rate]) / rise
        return _on_grid(rate - float(np.clip(wish, -STRIDE, STRIDE)), away_from=rate)
    # The first crossing from the random side lies above the highest rate that is too good.
    inner = max(too_good)
    outer = min((known for known in too_bad if known > inner), default=inner)
    if outer - inner < 1.5 * FINEST:
        return inner  # nothing of the grid in between: known, so the search ends
    share = (seen[inner] - 0.5) / (seen[inner] - seen[outer])
    middle = _on_grid(inner + share * (outer - inner))
    return float(np.clip(middle, inner + FINEST, outer - FINEST).round(6))


def _on_grid(rate: float, away_from: float | None = None) -> float:
    """Nearest multiple of FINEST in (0, 1); at least one step from `away_from`."""
    if away_from is not None and abs(rate - away_from) < FINEST:
        rate = away_from + float(np.copysign(FINEST, rate - away_from))
    place = min(max(round(rate / FINEST), 1), round(1 / FINEST) - 1)
    return round(place * FINEST, 6)


def calibrate_task(
    script: Script,
    task_name: str,
    horizons: Iterable[int],
    *,
    seed: int = 1,
    coarse: int = 4,
    careful: int = 20,
) -> list[Calibration]:
    """Find the rate of `medium` of one task at each horizon, the longest first.

    Args:
        coarse: episodes per rate of the coarse curve.
        careful: episodes per portion of a careful measurement.

    Raises: DataError if the script is no better than uniform actions, or if no measured
        rate comes into BAND (more `careful` episodes may help).
    """
    probe = Probe(script, task_name, seed)
    return [
        _calibrate(probe, horizon, coarse, careful) for horizon in sorted(horizons, reverse=True)
    ]


def _calibrate(probe: Probe, horizon: int, coarse: int, careful: int) -> Calibration:
    gauge = Gauge(probe, horizon, portion=careful, portions=PORTIONS, error=ERROR)
    where = f"{probe.task.name}, horizon {horizon}"
    if gauge.span <= 0:
        raise DataError(
            "the script earns no more than uniform actions",
            where=where,
            expected=f"a return above {gauge.low:.1f}",
            found=f"{gauge.low + gauge.span:.1f}",
        )
    curve = tuple(gauge.measure(rate, coarse) for rate in RATES)
    start, rise = first_crossing([point.level for point in curve])
    rate = find_rate(lambda rate: gauge.judge(rate, CLOSE).level, start, rise)
    medium, expert = gauge.measure(rate), gauge.measure(0.0)
    if not BAND[0] <= medium.level <= BAND[1]:
        raise DataError(
            "no mixing rate of the grid gives half the script's return",
            where=where,
            expected=f"a level in [{BAND[0]}, {BAND[1]}]",
            found=f"{medium.level} at rate {medium.rate}",
        )
    return Calibration(
        task=probe.task.name,
        horizon=horizon,
        rate=medium.rate,
        level=medium.level,
        random=gauge.measure(1.0),
        medium=medium,
        expert=expert,
        monotone=is_monotone(curve, expert.level_error),
        curve=curve,
        seed=probe.seed,
        versions=versions(),
        policy=script_hash(probe.script, probe.task.name),
        env=dict(probe.script.env),
    )


def script_hash(script: Script, task_name: str) -> str:
    """What a calibration holds for: the hash of the expert whose actions are mixed."""
    return script.policy(task_name).info.hash.hex()


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
    horizons: Sequence[int] = (),
    seed: int = 1,
    workers: int = 0,
    restart: bool = False,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Path:
    """Calibrate every task of a spec with a script; two minutes each where it is Meta-World's.

    What the target holds already, of the same script, seed and package versions, is kept.

    Args:
        target: file to add to; default LOCAL_FILE in the working folder, which the ladder
            prefers to what is shipped.
        horizons: default the spec's own.
        workers: processes, one task each at a time; 0: this one.
        restart: measure again what the target holds already.
        on_progress: called with a line per result; each is on disk by then.

    Raises: SpecError for a spec whose behaviour is not the script; StorageError, and DataError
        for a target that is no calibration file, both before anything is measured; DataError
        at the end, naming the tasks that cannot be calibrated.
    """
    if spec.behaviour.network is not None:
        raise SpecError(
            "nothing to calibrate: only a script or a trained policy has a mixing rate",
            where=f"{spec.name}.behaviour",
            hint=f"mpdt-data pretrain {quoted(spec.name)}",
        )
    load_ladder(msgspec.structs.replace(spec, episodes=EpisodeCounts()))  # the script is there
    script, family = Script.of(spec), get_family(spec.family)
    rates = family.rates or family.name if script.bundle is None else script.bundle.rates
    target = target or local_path(None, rates)
    check_target(target)
    names = [task.name for task in spec.resolve_tasks()]
    wanted = [(name, horizon) for name in names for horizon in horizons or (spec.horizon,)]
    known = set() if restart else _still_valid(script, target, wanted, seed)
    if known:
        on_progress(f"in {target} already: " + ", ".join(f"{n} {h}" for n, h in sorted(known)))
    jobs = [
        (script, name, tuple(h for n, h in wanted if n == name and (n, h) not in known), seed)
        for name in names
    ]
    jobs = [job for job in jobs if job[2]]
    faults: list[DataError] = []
    for number, answer in enumerate(map_blocks(_do, jobs, workers), 1):
        if isinstance(answer, DataError):
            faults.append(answer)
            on_progress(f"{number}/{len(jobs)}  {answer}")
            continue
        save_calibrations(target, answer, RULE)
        for found in answer:
            on_progress(
                f"{number}/{len(jobs)}  {found.task} {found.horizon}  rate {found.rate:.3f}  "
                f"level {found.level:.2f} +- {found.medium.level_error:.3f}"
            )
    if faults:
        raise DataError(Lines.of("not calibrated:", *map(str, faults)), where=str(target))
    return target


def _do(job: tuple[Script, str, tuple[int, ...], int]) -> list[Calibration] | DataError:
    """One task in a worker; its failure must not end the others."""
    script, name, horizons, seed = job
    try:
        return calibrate_task(script, name, horizons, seed=seed)
    except DataError as error:
        return error


def _still_valid(script: Script, target: Path, wanted: Sequence[Place], seed: int) -> set[Place]:
    """Those places whose entry in `target` rests on today's script, options, packages and seed."""
    entries = read_calibrations(target) if target.exists() else {}
    return {
        place
        for place in wanted
        if (entry := entries.get(place)) is not None
        and (entry.policy, entry.env) == (script_hash(script, place[0]), dict(script.env))
        and (entry.versions, entry.seed) == (versions(), seed)
    }
