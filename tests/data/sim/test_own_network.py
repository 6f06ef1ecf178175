"""Behaviour of one's own families: trained networks, and noise on a script's actions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from own_families import LINE, forgotten, line, make

import mpdt
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.sim.actors import Rows
from mpdt.data.sim.mixed import script_policy
from mpdt.data.sim.pretrain import pretrain
from mpdt.data.sim.vecenv import FamilyVecEnv
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.verify.verify import verify
from mpdt.errors import FormatError, SimulatorError, SpecError, UsageError
from mpdt.seeding import Quality, SeedKey

TINY = {"steps": 400, "rows": 5, "steps_per_update": 40, "minibatch": 50, "hidden": 8,
        "snapshots": 2, "num_rungs": 3, "judge_episodes": 2, "threads": 1,
        "learning_rate": 0.01, "early": 4}  # fmt: skip


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


def test_rows_that_start_anew_are_batches_of_one(tmp_path: Path) -> None:
    """The quick way and the slow one: the same numbers, ends before the horizon too."""

    def ending(task: mpdt.Task) -> Any:
        return make(task, ends=True)

    def vector(tasks: Any) -> Any:
        return SyncVectorEnv([lambda task=task: ending(task) for task in tasks])

    quick, slow = (
        FamilyVecEnv(family, 4, 7, 1)
        for family in (line(env=ending), line(env=None, vector=vector))
    )
    assert (quick.reset() == slow.reset()).all()
    ended = 0
    for step in range(30):
        actions = np.full((4, 1), 0.9 if step % 9 else -0.4, np.float32)
        quick.step_async(actions)
        slow.step_async(actions)
        one, two = quick.step_wait(), slow.step_wait()
        for here, there in zip(one[:3], two[:3], strict=True):
            assert (here == there).all()
        assert [info.get("episode") for info in one[3]] == [info.get("episode") for info in two[3]]
        ended += int(sum(one[2]))
    lengths = [info["episode"]["l"] for info in one[3] if info]
    assert ended > 15 and all(length < 8 for length in lengths)
    assert (quick._goals == slow._goals).all() and quick._goals[2, 0] == 4.0


def test_a_network_of_ones_own_family(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mpdt.register_family(line(pretrain=TINY))
    lines: list[str] = []
    pretrain("line", output=tmp_path)
    pretrain("line", output=tmp_path, steps=1200, on_progress=lines.append)
    assert any("resuming at step 400" in text for text in lines)
    record = json.loads((tmp_path / "line.json").read_text())
    steps = [point["step"] for point in record["curve"]]
    assert steps[:3] == [0, 200, 400] and record["settings"]["early"] == 4  # updates of 200 steps
    assert (record["robot"], record["reward"]) == ("line", "1.0.0")
    assert set(record["rungs"][-1]["levels"].values()) == {1.0} and len(record["curve"]) >= 3
    spec = DatasetSpec(
        name="mine", version="1.0.0", family="line", horizon=8, seed=3, block=2, license="CC0-1.0",
        behaviour=Behaviour(network="./line", rungs=2, noise=0.1), reference=2,
        episodes=EpisodeCounts(random=2, expert=2, history=2),
    )  # fmt: skip
    data = collect(make_job(spec), tmp_path / "mine.h5", workers=0).dataset
    assert data.num_episodes == 3 * 6
    found = {one.id: one.outcome.value for one in verify(data.path, replay="all").findings}
    assert found["replay"] == "PASS"
    mpdt.register_family(line(version="2.0.0", pretrain=TINY))
    with pytest.raises(SpecError, match=r"trained for another family; expected line/2.0.0"):
        make_job(spec)
    with pytest.raises(FormatError, match=r"checkpoint of another run; expected scene line/2.0.0"):
        pretrain("line", output=tmp_path)


@pytest.mark.parametrize(
    ("said", "what"),
    [
        ({"step": 10}, "pretrain: unknown key 'step' .did you mean 'steps'"),
        ({"steps": 1.5}, "pretrain: steps is a whole number, found 1.5"),
        ({"learning_rate": 0}, "pretrain: learning_rate is above 0, found 0"),
        ({"num_rungs": 1}, "pretrain: num_rungs is at least 2, found 1"),
        ({"rows": 10**9}, "pretrain: rows is at most 100,000, found 1000000000"),
        ({"discount": float("nan")}, "pretrain: discount is a number, found nan"),
        ({"threads": True}, "pretrain: threads is a whole number, found True"),
        (3, "pretrain: settings by name, found int"),
    ],
)
def test_settings_that_are_none(said: Any, what: str) -> None:
    with pytest.raises(SpecError, match=what):
        mpdt.register_family(line(pretrain=said))


def test_what_cannot_be_trained_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown behaviour network 'ml10'"):
        pretrain("ml10", output=tmp_path)
    flat = {**TINY, "steps": 200}

    class Flat(type(make(LINE["tasks"][0]))):  # type: ignore[misc]
        def step(self, action: Any) -> Any:
            observation, _, *rest = super().step(action)
            return (observation, 1.0, *rest)

    mpdt.register_family(line(env=lambda task: Flat(1.0), pretrain=flat))
    with pytest.raises(SimulatorError, match="no better than uniform actions in 3 of 3 tasks"):
        pretrain("line", output=tmp_path)
    assert not (tmp_path / "line.json").exists()


def test_noise_makes_a_script_differ_and_is_part_of_who_acts() -> None:
    family = line()
    task, still = family.tasks[1], SeedKey(3, family.id, 1, Quality.EXPERT, 0, 0)
    keys = [still, still.at_row(1)]
    seen = np.zeros((2, 2))

    def acts(noise: float, horizon: int = 4, rate: float = 0.0) -> Any:
        policy = script_policy(family, "there", task, rate, noise=noise)
        policy.begin(Rows(keys, [np.array([2.0])] * 2, horizon))
        return np.stack([policy.act(step, seen) for step in range(4)]), policy.info.hash

    plain, hash_of_plain = acts(0.0)
    noisy, hash_of_noisy = acts(0.1)
    assert (plain == 1.0).all() and hash_of_plain != hash_of_noisy
    assert (noisy != plain).all() and (noisy[:, 0] != noisy[:, 1]).all()
    assert abs(noisy - plain).std() < 0.3
    assert (acts(0.1, horizon=40)[0] == noisy).all()  # a shorter episode begins a longer one
    coins = [key.generator(1).random(4) < 0.5 for key in keys]
    mixed, uniform = acts(0.1, rate=0.5)[0], acts(0.0, rate=0.5)[0]
    for row, coin in enumerate(coins):
        assert (mixed[coin, row] == uniform[coin, row]).all() and coin.any()
    with pytest.raises(SpecError, match=r"behaviour.noise: the scripts of ml10 take none"):
        DatasetSpec(name="x", version="1.0.0", family="ml10", horizon=9, seed=0, block=1,
                    behaviour=Behaviour(script="metaworld", noise=0.1),
                    episodes=EpisodeCounts(expert=1), license="CC0-1.0")  # fmt: skip
