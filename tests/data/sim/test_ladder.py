from __future__ import annotations

import msgspec
import pytest

from mpdt.data.sim.actors import UniformPolicy
from mpdt.data.sim.calibrate import RULE
from mpdt.data.sim.calibration import (
    LOCAL_FILE,
    Calibration,
    Measurement,
    load_calibrations,
    load_local,
    save_calibrations,
)
from mpdt.data.sim.ladder import ScriptLadder, load_ladder
from mpdt.data.sim.scripted import ScriptedPolicy
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.spec.tasks import get_family
from mpdt.errors import SpecError, UsageError

ML10 = get_family("ml10")
REACH, PUSH = ML10.task("reach"), ML10.task("push")
STRIDE = 65536


def make_spec(**changes):
    spec = DatasetSpec(
        name="tiny",
        version="1.0.0",
        family="ml10",
        tasks=("reach", "push"),
        horizon=123,
        seed=1,
        block=10,
        behaviour=Behaviour(script="metaworld", rungs=5),
        episodes=EpisodeCounts(random=1, medium=1, expert=1),
        license="MIT",
    )
    return msgspec.structs.replace(spec, **changes)


@pytest.fixture
def folder(tmp_path):
    """Calibrations at horizon 123, as no shipped one has: reach 0.7, push 0.35."""

    def measured(rate, level):
        return Measurement(rate, 10, 100 * level, 0.0, level, 0.02)

    entries = [
        Calibration(
            task=task,
            horizon=123,
            rate=rate,
            level=0.48,
            random=measured(1.0, 0.0),
            medium=measured(rate, 0.48),
            expert=measured(0.0, 1.0),
            monotone=True,
            curve=(measured(0.5, 0.7),),
            seed=1,
            versions={},
        )
        for task, rate in (("reach", 0.7), ("push", 0.35))
    ]
    save_calibrations(tmp_path / LOCAL_FILE, entries, RULE)
    return tmp_path


def test_who_acts_for_each_quality(folder):
    ladder = load_ladder(make_spec(), folder)
    random, progress = ladder.policy(REACH, "random", 3)
    assert isinstance(random, UniformPolicy) and progress == 0.0 and random.scale == 1.0
    medium, progress = ladder.policy(REACH, "medium", 3)
    assert isinstance(medium, ScriptedPolicy) and medium.mix_rate == 0.7 and progress == 0.48
    assert (medium.info.level, medium.info.mix_rate, medium.info.name) == (
        0.48,
        0.7,
        "script+u0.70",
    )
    # 5 rungs have rates 1, .75, .5, .25, 0: 0.7 is nearest the second, 0.35 the fourth
    assert medium.info.rung == 1
    assert ladder.policy(PUSH, "medium", 0)[0].info.rung == 3
    expert, progress = ladder.policy(PUSH, "expert", 3)
    assert isinstance(expert, ScriptedPolicy) and expert.mix_rate == 0.0 and progress == 1.0
    assert expert.task_names == ("push",) and expert.info.task == PUSH.index
    with pytest.raises(UsageError, match=r"unknown quality 'expret' \(did you mean 'expert'"):
        ladder.policy(PUSH, "expret", 0)


def test_history_spreads_rates_evenly_by_the_rung_in_the_block_number(folder):
    ladder = load_ladder(make_spec(), folder)
    rows = [ladder.policy(REACH, "history", rung * STRIDE + 2) for rung in range(5)]
    assert [policy.info.mix_rate for policy, _ in rows] == [1.0, 0.75, 0.5, 0.25, 0.0]
    assert [progress for _, progress in rows] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert [policy.info.rung for policy, _ in rows] == [0, 1, 2, 3, 4]
    # measured at 1, .7, .5, 0: (0, .48, .7, 1); .75 is 5/6 of the way from 1 to .7
    levels = [policy.info.level for policy, _ in rows]
    assert levels == pytest.approx([0.0, 0.4, 0.7, 0.85, 1.0])
    assert isinstance(rows[0][0], UniformPolicy)
    assert rows[0][0].info.hash == ladder.policy(REACH, "random", 0)[0].info.hash
    assert rows[4][0].info.hash == ladder.policy(REACH, "expert", 0)[0].info.hash


def test_policies_list_what_can_act_once_each(folder):
    ladder = load_ladder(make_spec(), folder)
    names = [(info.task, info.name) for info in ladder.policies([REACH, PUSH])]
    assert names == [
        (REACH.index, "uniform"),
        (REACH.index, "script+u0.70"),
        (REACH.index, "script"),
        (PUSH.index, "uniform"),
        (PUSH.index, "script+u0.35"),
        (PUSH.index, "script"),
    ]
    counts = EpisodeCounts(random=1, medium=1, expert=1, history=5)
    infos = load_ladder(make_spec(episodes=counts), folder).policies([REACH])
    rates = [info.mix_rate for info in infos]
    assert rates == [1.0, 0.75, 0.7, 0.5, 0.25, 0.0]
    assert len({info.hash for info in infos}) == 6


def test_missing_calibration_says_how_to_make_one(folder, tmp_path):
    with pytest.raises(SpecError) as caught:
        load_ladder(make_spec(horizon=77), folder)
    assert caught.value.message() == (
        "tiny: 'reach' has no calibrated mixing rate for medium; "
        "expected a calibration at horizon 77, found horizons [123, 200, 500]"
    )
    assert caught.value.hint == "mpdt-data calibrate tiny"
    # without medium there is nothing to look up
    counts = EpisodeCounts(random=1, expert=1)
    ladder = load_ladder(make_spec(horizon=77, episodes=counts), folder)
    assert ladder.policy(REACH, "history", 2 * STRIDE)[0].info.level == -1.0


def test_a_rate_of_another_script_is_refused(folder):
    entry = load_local(folder)["reach", 123]
    own = ScriptedPolicy(["reach"]).info.hash.hex()
    save_calibrations(folder / LOCAL_FILE, [msgspec.structs.replace(entry, policy=own)], RULE)
    assert load_ladder(make_spec(), folder).policy(REACH, "medium", 0)[0].mix_rate == 0.7
    other = msgspec.structs.replace(entry, policy="ab" * 32)
    save_calibrations(folder / LOCAL_FILE, [other], RULE)
    with pytest.raises(SpecError, match=r"'reach' was calibrated with another script.*abababab"):
        load_ladder(make_spec(), folder)


def test_a_local_rate_wins_and_is_told(folder, tmp_path, monkeypatch):
    """Shipped for reach at 500 steps is another rate than 0.2; push stays the shipped one."""
    (entry, *_) = load_local(folder).values()
    shipped = load_calibrations(tmp_path / "nowhere")
    local = msgspec.structs.replace(entry, task="reach", horizon=500, rate=0.2, level=0.61)
    save_calibrations(folder / LOCAL_FILE, [local], RULE)
    spec = make_spec(horizon=500)
    ladder = load_ladder(spec, folder)
    assert ladder.policy(REACH, "medium", 0)[0].mix_rate == 0.2 != shipped["reach", 500].rate
    assert ladder.policy(PUSH, "medium", 0)[0].mix_rate == shipped["push", 500].rate
    assert ladder.notice == f"mixing rates of 1 task from {folder / LOCAL_FILE}"
    monkeypatch.chdir(folder)
    assert load_ladder(spec).notice == "mixing rates of 1 task from ./metaworld.calibration.json"
    assert load_ladder(make_spec(), folder).notice.startswith("mixing rates of 2 tasks")
    no_medium = make_spec(horizon=500, episodes=EpisodeCounts(random=1, expert=1))
    assert load_ladder(no_medium, folder).notice == ""


def test_scripts_are_for_metaworld_only():
    spec = make_spec(family="cheetah_dir", tasks="all", horizon=200)
    with pytest.raises(SpecError, match="found metaworld in cheetah_dir"):
        ScriptLadder(spec)
    with pytest.raises(SpecError, match="found walker in ml10"):
        ScriptLadder(make_spec(behaviour=Behaviour(script="walker")))


def test_shipped_ml10_ladder_loads_in_any_folder(tmp_path):
    ladder = load_ladder(make_spec(horizon=500, tasks="all"), tmp_path)
    for task in ML10.tasks:
        policy, progress = ladder.policy(task, "medium", 0)
        assert 0.35 <= progress <= 0.65 and policy.info.level == progress
