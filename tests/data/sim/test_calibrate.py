from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from mpdt.data.sim import calibrate as module
from mpdt.data.sim.calibrate import (
    RATES,
    RULE,
    calibrate,
    calibrate_task,
    find_rate,
    first_crossing,
    script_hash,
)
from mpdt.data.sim.calibration import (
    LOCAL_FILE,
    Measurement,
    load_calibrations,
    save_calibrations,
)
from mpdt.data.sim.probe import Script
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.spec.tasks import get_family
from mpdt.errors import DataError, FormatError, SpecError, StorageError

METAWORLD = Script(get_family("mt50"), "metaworld")


def test_the_coarse_curve_leaves_out_its_known_ends():
    assert RATES == (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)


def test_a_straight_curve_is_crossed_in_its_middle():
    # level = 1 - rate; averaging neighbours changes no straight line
    assert first_crossing([1 - rate for rate in RATES]) == (0.5, pytest.approx(1.0))


def test_a_step_is_crossed_between_its_ends():
    # smoothed: 0.25 at rate 0.3 and 0.75 at 0.2
    assert first_crossing([0, 0, 0, 0, 0, 0, 0, 1, 1]) == (0.25, pytest.approx(5.0))


def test_a_turning_curve_gives_the_first_crossing_from_the_random_side():
    # smoothed: 0.3 at 0.9 and 0.775 at 0.8; 0.9 - 0.1 * 0.2 / 0.475 = 0.858
    found = first_crossing([0.2, 0.8, 1.3, 0.9, 0.4, 0.3, 0.6, 0.8, 0.9])
    assert found == (0.86, pytest.approx(4.75))


def test_one_lucky_level_is_outvoted_by_its_neighbours():
    # 0.7 at rate 0.8 becomes (0.1 + 1.4 + 0.3) / 4 = 0.45
    lucky = [1 - rate for rate in RATES]
    lucky[1] = 0.7
    assert first_crossing(lucky)[0] == 0.5


def visited(level, start, rise):
    seen = []
    answer = find_rate(lambda rate: seen.append(rate) or level(rate), start, rise)
    return answer, seen


def test_search_follows_the_slope_until_it_is_close():
    assert visited(lambda rate: 1 - rate, 0.47, 1.0) == (0.47, [0.47])  # 0.53 is close enough
    assert visited(lambda rate: 1 - rate, 0.44, 1.0) == (0.5, [0.44, 0.5])
    # 0.3 away by the slope, but one step goes 0.1 at most
    assert visited(lambda rate: 1 - rate, 0.8, 1.0)[1] == [0.8, 0.7, 0.6, 0.5]


def test_search_interpolates_between_both_sides():
    levels = {0.6: 0.2, 0.5: 0.7, 0.54: 0.5}  # 0.5 + 0.1 * (0.7 - 0.5) / (0.7 - 0.2)
    assert visited(levels.get, 0.6, 2.0) == (0.54, [0.6, 0.5, 0.54])


def test_search_ends_where_the_grid_does():
    # 0.9 up to rate 0.30 and 0.1 from 0.31 on: equally far, so the more random one
    answer, seen = visited(lambda rate: 0.9 if rate < 0.305 else 0.1, 0.3, 10.0)
    assert seen == [0.3, 0.34, 0.32, 0.31] and answer == 0.34
    # rate 0 is the expert and 1 is random, neither is medium
    assert visited(lambda rate: 0.1, 0.01, 10.0) == (0.01, [0.01])
    assert visited(lambda rate: 0.9, 0.99, 10.0) == (0.99, [0.99])


class FakeProbe:
    """Returns 100 at rate 1 and 500 at rate 0, straight in between, +-4 by row.

    Half of it at 200 steps. "bad" falls towards the script, "jump" has no middle.
    """

    def __init__(self, script, task_name, seed):
        self.task, self.seed, self.script = SimpleNamespace(name=task_name), seed, script

    def outcomes(self, rate, horizon, num_episodes):
        slope = -10.0 if self.task.name == "bad" else 400.0
        share = float(rate < 0.305) if self.task.name == "jump" else 1 - rate
        returns = 100.0 + slope * share + 4.0 * (-1.0) ** np.arange(num_episodes)
        scale = 0.5 if horizon == 200 else 1.0
        return scale * returns, np.full(num_episodes, float(rate < 0.5))


@pytest.fixture
def fake_probe(monkeypatch):
    monkeypatch.setattr(module, "Probe", FakeProbe)
    monkeypatch.setattr(module, "script_hash", lambda script, name: f"hash of {name}")


def test_calibrate_task_measures_the_level_it_reports(fake_probe):
    found, short = calibrate_task(METAWORLD, "good", [200, 500], coarse=2, careful=4)
    assert (found.horizon, found.rate, found.level) == (500, 0.5, 0.5)
    assert [m.mean_return for m in (found.random, found.medium, found.expert)] == [100, 300, 500]
    assert found.medium.episodes == 4 and found.curve[0].episodes == 2
    assert found.expert.success == 1.0 and found.random.success == 0.0
    # std of (4, -4, 4, -4) with ddof 1 is 4.6188; / 400 / sqrt(4)
    assert found.medium.level_error == pytest.approx(0.0058, abs=5e-5)
    assert found.monotone and len(found.curve) == 9
    assert found.versions["metaworld"] == "3.1.1" and found.policy == "hash of good"
    # level of an unmeasured rate: half way between 0.30 (0.70) and 0.40 (0.60)
    assert found.level_at(0.35) == pytest.approx(0.65)
    assert (found.level_at(1.0), found.level_at(0.0)) == (0.0, 1.0)
    assert (short.horizon, short.expert.mean_return, short.level) == (200, 250, 0.5)


def test_a_script_below_random_or_without_a_middle_is_refused(fake_probe):
    with pytest.raises(DataError, match="earns no more than uniform actions"):
        calibrate_task(METAWORLD, "bad", [500], coarse=2, careful=4)
    with pytest.raises(DataError, match=r"no mixing rate .* a level in \[0.4, 0.6\]"):
        calibrate_task(METAWORLD, "jump", [500], coarse=2, careful=4)


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


def test_calibrate_goes_on_where_it_was_stopped(fake_probe, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    said = []
    path = calibrate(make_spec(horizon=77), on_progress=said.append)
    assert path.name == LOCAL_FILE and [line[:13] for line in said] == [
        "1/2  reach 77",
        "2/2  push 77 ",
    ]
    assert set(load_calibrations(tmp_path)) >= {("reach", 77), ("push", 77)}
    # another horizon is new, the first one is kept
    said.clear()
    calibrate(make_spec(), horizons=[77, 33], on_progress=said.append)
    assert said[0] == f"in {LOCAL_FILE} already: push 77, reach 77"
    assert [line[:13] for line in said[1:]] == ["1/2  reach 33", "2/2  push 33 "]
    # another seed or script, or --restart, is measured again
    for change in ({"seed": 2}, {"seed": 2, "restart": True}):
        said.clear()
        calibrate(make_spec(horizon=77), on_progress=said.append, **change)
        assert len(said) == 2
    monkeypatch.setattr(module, "script_hash", lambda script, name: f"better {name}")
    said.clear()
    calibrate(make_spec(horizon=77), seed=2, on_progress=said.append)
    assert len(said) == 2
    assert load_calibrations(tmp_path)["reach", 77].policy == "better reach"
    with pytest.raises(SpecError, match="nothing to calibrate"):
        calibrate(make_spec(script=None))


def test_one_task_that_fails_does_not_stop_the_others(fake_probe, monkeypatch, tmp_path):
    real = module.calibrate_task

    def fails(script, name, horizons, *, seed):
        return real(script, "jump" if name == "reach" else name, horizons, seed=seed)

    monkeypatch.setattr(module, "calibrate_task", fails)
    with pytest.raises(DataError, match="not calibrated:\n  jump, horizon 500: no mixing rate"):
        calibrate(make_spec(), tmp_path / "rates.json")
    assert list(module.read_calibrations(tmp_path / "rates.json")) == [("push", 500)]


def test_file_is_sorted_merged_strict_and_above_the_shipped_one(fake_probe, tmp_path):
    (one,) = calibrate_task(METAWORLD, "reach", [500], coarse=2, careful=4)
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


SHIPPED = [(task.name, horizon) for task in get_family("mt50").tasks for horizon in (200, 500)]


@pytest.mark.parametrize("place", SHIPPED, ids=lambda place: f"{place[0]}-{place[1]}")
def test_shipped_calibration_puts_medium_between_random_and_expert(place):
    entry = load_calibrations()[place]
    returns = [m.mean_return for m in (entry.random, entry.medium, entry.expert)]
    assert returns[0] < returns[1] < returns[2]
    level = (returns[1] - returns[0]) / (returns[2] - returns[0])
    assert level == pytest.approx(entry.level, abs=1e-4)
    assert 0.40 <= level <= 0.60
    assert (entry.random.rate, entry.medium.rate, entry.expert.rate) == (1.0, entry.rate, 0.0)
    assert 0.0 < entry.rate < 1.0
    assert entry.medium.level_error <= 0.055 and entry.medium.episodes >= 20
    assert entry.versions["mujoco"] == "3.3.0" and entry.versions["metaworld"] == "3.1.1"
    assert entry.policy == script_hash(METAWORLD, entry.task)  # measured with the expert of today


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
    with pytest.raises(FormatError, match="a folder, not a file"):
        load_calibrations(tmp_path)
