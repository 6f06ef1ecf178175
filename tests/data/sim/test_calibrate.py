from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from mpdt.data.sim import calibrate as module
from mpdt.data.sim.calibrate import (
    RATES,
    RULE,
    Probe,
    calibrate,
    calibrate_task,
    find_rate,
    settle,
)
from mpdt.data.sim.calibration import (
    LOCAL_FILE,
    Measurement,
    load_calibrations,
    save_calibrations,
)
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.errors import DataError, SpecError, StorageError


def interpolated(*points):
    """A level curve through (rate, level), and the list of what was asked."""
    rates, levels = zip(*sorted(points), strict=True)
    asked = []

    def level(rate, careful):
        asked.append((rate, careful))
        return float(np.interp(rate, rates, levels))

    return level, asked


def test_rates_walk_from_random_to_script():
    assert RATES[:3] == (1.0, 0.95, 0.9) and RATES[-2:] == (0.05, 0.0) and len(RATES) == 21


def test_straight_curve_is_crossed_in_its_middle():
    level, asked = interpolated((0.0, 1.0), (1.0, 0.0))
    assert find_rate(level) == 0.5
    # walked 0.95 .. 0.5 coarsely, then 0.5, 0.55 and the half step 0.525 carefully
    assert asked == [(rate, False) for rate in RATES[1:11]] + [
        (0.5, True),
        (0.55, True),
        (0.525, True),
    ]


def test_a_step_inside_the_grid_is_halved():
    # level 0.5 at rate 0.53: nearest multiple of 0.025 is 0.525, not 0.50 or 0.55
    level, _ = interpolated((0.0, 1.0), (0.5, 0.65), (0.56, 0.35), (1.0, 0.0))
    assert find_rate(level) == 0.525


def test_a_turning_curve_gives_the_first_crossing_from_the_random_side():
    # Crosses 0.5 at 0.8, falls under it at 0.5, rises again to the script.
    level, _ = interpolated((0, 1), (0.4, 0.3), (0.5, 0.4), (0.7, 1.3), (0.8, 0.5), (1, 0))
    assert find_rate(level) == 0.8


def test_a_lucky_coarse_level_does_not_stop_the_walk():
    honest, _ = interpolated((0.0, 1.0), (1.0, 0.0))

    def level(rate, careful):
        return 0.9 if rate == 0.9 and not careful else honest(rate, careful)

    assert find_rate(level) == 0.5


def test_an_unlucky_coarse_level_is_walked_back():
    honest, _ = interpolated((0.0, 1.0), (1.0, 0.0))

    def level(rate, careful):
        return honest(rate, careful) if careful or rate < 0.4 else 0.0

    assert find_rate(level) == 0.5


def test_only_the_clean_script_is_good():
    level, _ = interpolated((0.0, 0.1), (1.0, 0.0))
    assert find_rate(level) in (0.025, 0.0)  # as far as the grid goes; the band refuses it


def visited(levels, start):
    seen = []
    answer = settle(lambda rate: seen.append(rate) or levels[rate], start)
    return answer, seen


def test_settling_walks_towards_one_half_and_takes_the_nearest():
    assert visited({0.5: 0.52}, 0.5) == (0.5, [0.5])  # close enough
    # too low: less random, until it is close
    assert visited({0.5: 0.4, 0.475: 0.46, 0.45: 0.48}, 0.5) == (0.45, [0.5, 0.475, 0.45])
    # too high: more random; here one step goes past the half, and the nearer one stays
    assert visited({0.5: 0.56, 0.525: 0.45}, 0.5) == (0.525, [0.5, 0.525])
    assert visited({0.5: 0.54, 0.525: 0.45}, 0.5) == (0.5, [0.5, 0.525])
    assert visited({0.025: 0.2}, 0.025) == (0.025, [0.025])  # rate 0 is expert, not medium


class FakeProbe:
    """Returns 100 at rate 1 and 500 at rate 0, straight in between, +-4 by row.

    Task "rare" has an outlier of +100 in its first episode at rate 0.5 only.
    """

    def __init__(self, task_name, horizon, seed):
        self.task, self.horizon, self.seed = SimpleNamespace(name=task_name), horizon, seed
        self.slope = {"good": 400.0, "bad": -10.0}.get(task_name, 400.0)
        self.jump = task_name == "jump"

    def outcomes(self, rate, num_episodes):
        share = float(rate < 0.31) if self.jump else 1 - rate
        noise = 4.0 * (-1.0) ** np.arange(num_episodes)
        if self.task.name == "rare" and rate == 0.5:
            noise[0] += 100.0
        return 100.0 + self.slope * share + noise, np.full(num_episodes, float(rate < 0.5))


def test_calibrate_task_measures_the_level_it_reports(monkeypatch):
    monkeypatch.setattr(module, "Probe", FakeProbe)
    found = calibrate_task("good", 500, coarse=2, careful=4)
    assert (found.rate, found.level) == (0.5, 0.5)
    assert [m.mean_return for m in (found.random, found.medium, found.expert)] == [100, 300, 500]
    assert found.medium.episodes == 4 and found.curve[0].episodes == 2
    assert found.expert.success == 1.0 and found.random.success == 0.0
    # std of (4, -4, 4, -4) with ddof 1 is 4.6188; / 400 / sqrt(4)
    assert found.medium.level_error == pytest.approx(0.0058, abs=5e-5)
    assert found.monotone and len(found.curve) == 19
    assert found.versions["metaworld"] == "3.1.1"
    # level of an unmeasured rate: half way between 0.30 (0.70) and 0.35 (0.65)
    assert found.level_at(0.325) == pytest.approx(0.675)
    assert (found.level_at(1.0), found.level_at(0.0)) == (0.0, 1.0)


def test_noisy_rates_get_more_episodes_up_to_a_limit(monkeypatch):
    monkeypatch.setattr(module, "Probe", FakeProbe)
    found = calibrate_task("rare", 500, coarse=2, careful=4)
    assert found.random.episodes == found.expert.episodes == 4
    probe = FakeProbe("rare", 500, 1)
    # (104, -4, 4, -4, ...): std / sqrt(n) is 26.4, 13.1, 8.8 for n = 4, 8, 12; 0.025 * 400 = 10
    assert module._enough(probe, 0.5, 400.0, 4) == 12
    assert module._enough(probe, 0.5, 40.0, 4) == 16  # never more than four portions
    assert module._enough(probe, 0.4, 400.0, 4) == 4
    assert found.level == pytest.approx(0.5, abs=0.03)


def test_a_script_below_random_or_without_a_middle_is_refused(monkeypatch):
    monkeypatch.setattr(module, "Probe", FakeProbe)
    with pytest.raises(DataError, match="earns no more than uniform actions"):
        calibrate_task("bad", 500, coarse=2, careful=4)
    with pytest.raises(DataError, match=r"no mixing rate .* a level in \[0.4, 0.6\]"):
        calibrate_task("jump", 500, coarse=2, careful=4)


def point(rate, level, error=0.01):
    return Measurement(rate, 6, 0.0, 0.0, level, error)


def test_monotone_allows_a_tenth_and_two_errors_and_no_more():
    rising = [point(0.9, 0.5), point(0.5, 0.39), point(0.1, 1.11)]  # room 0.1 + 2 * 0.01
    assert module.is_monotone(rising, 0.0)
    assert not module.is_monotone([point(0.9, 0.5), point(0.5, 0.37), point(0.1, 0.9)], 0.0)
    above = [point(0.9, 0.5), point(0.5, 1.13), point(0.1, 1.1)]
    assert not module.is_monotone(above, 0.0)
    assert module.is_monotone(above, 0.02)  # the script itself is known no better
    assert module.is_monotone([point(0.9, 0.5), point(0.5, 1.13, error=0.02)], 0.0)


def test_probe_repeats_itself_and_tells_rates_apart():
    first, again = Probe("reach", 30, seed=3), Probe("reach", 30, seed=3)
    returns, successes = first.outcomes(0.5, 2)
    # asked in another order and in two portions: the same numbers
    again.outcomes(0.0, 1)
    again.outcomes(0.5, 1)
    np.testing.assert_array_equal(again.outcomes(0.5, 2)[0], returns)
    assert returns[0] != returns[1] and successes.tolist() == [0.0, 0.0]
    assert (first.outcomes(0.0, 2)[0] > first.outcomes(1.0, 2)[0]).all()


def make_spec(script="metaworld", horizon=500, **kwargs):
    return DatasetSpec(
        name="tiny",
        version="1.0.0",
        family="ml10" if script else "cheetah_dir",
        tasks=("reach", "push") if script else "all",
        horizon=horizon,
        seed=1,
        block=1,
        behaviour=Behaviour(script=script, network=None if script else "cheetah_dir"),
        episodes=EpisodeCounts(random=1, medium=1, expert=1),
        license="MIT",
        **kwargs,
    )


def test_calibrate_writes_each_task_where_the_ladder_looks(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "Probe", FakeProbe)
    monkeypatch.chdir(tmp_path)
    done = []
    path = calibrate(make_spec(horizon=77), coarse=2, careful=4, on_progress=done.append)
    assert path.name == LOCAL_FILE and [entry.task for entry in done] == ["reach", "push"]
    found = load_calibrations(tmp_path)
    assert found["reach", 77] == done[0] and found["push", 77] == done[1]
    with pytest.raises(SpecError, match="nothing to calibrate"):
        calibrate(make_spec(script=None))


def test_file_is_sorted_merged_strict_and_above_the_shipped_one(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "Probe", FakeProbe)
    one = calibrate_task("reach", 500, coarse=2, careful=4)
    other = msgspec.structs.replace(one, task="a-task", horizon=3)
    path = tmp_path / LOCAL_FILE
    save_calibrations(path, [one], RULE)
    save_calibrations(path, [other], RULE)
    lines = path.read_text().splitlines()
    assert '"task":"a-task"' in lines[3] and '"task":"reach"' in lines[4] and len(lines) == 6
    found = load_calibrations(tmp_path)
    assert found["a-task", 3] == other
    # what was measured here wins over what is shipped
    shipped = load_calibrations(tmp_path / "nowhere")
    assert found["reach", 500] == one != shipped["reach", 500]
    assert found["push", 500] == shipped["push", 500]
    assert not list(tmp_path.glob("*.tmp"))
    path.write_text(path.read_text().replace("mpdt-calibration/1", "mpdt-calibration/9"))
    with pytest.raises(DataError, match="expected mpdt-calibration/1, found mpdt-calibration/9"):
        load_calibrations(tmp_path)
    path.write_text("{}")
    with pytest.raises(DataError, match="not a calibration file"):
        load_calibrations(tmp_path)


def test_shipped_calibration_puts_medium_between_random_and_expert():
    from mpdt.data.spec.tasks import get_family

    shipped = load_calibrations()
    for task in get_family("ml10").tasks:
        entry = shipped[task.name, 500]
        assert 0.40 <= entry.level <= 0.60, task.name
        assert 0.0 < entry.rate < 1.0
        returns = [m.mean_return for m in (entry.random, entry.medium, entry.expert)]
        assert returns == sorted(returns) and len(set(returns)) == 3, task.name
        level = (returns[1] - returns[0]) / (returns[2] - returns[0])
        assert level == pytest.approx(entry.level, abs=1e-4)
        assert entry.medium.episodes >= 20
        assert entry.versions["mujoco"] == "3.3.0" and entry.versions["metaworld"] == "3.1.1"


def test_a_target_that_cannot_be_written_is_refused_before_measuring(monkeypatch, tmp_path):
    def measured(*args, **options):
        raise AssertionError("measured first")

    monkeypatch.setattr(module, "calibrate_task", measured)
    (tmp_path / "notes.json").write_text("precious")
    for target, error, what in (
        (tmp_path / "no" / "rates.json", StorageError, "folder does not exist"),
        (tmp_path, StorageError, "a folder is in the way"),
        (tmp_path / ("x" * 253), StorageError, "cannot be written"),
        (tmp_path / "notes.json", DataError, "not a calibration file"),
    ):
        with pytest.raises(error, match=what) as caught:
            calibrate(make_spec(), target)
        assert caught.value.hint
    assert [path.name for path in tmp_path.iterdir()] == ["notes.json"]


def test_a_folder_in_place_of_the_local_file_is_refused(tmp_path):
    (tmp_path / LOCAL_FILE).mkdir()
    with pytest.raises(StorageError, match="cannot be read"):
        load_calibrations(tmp_path)
