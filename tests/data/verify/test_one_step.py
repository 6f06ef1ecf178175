"""One step from stored states: zero for our own episodes, and what is not of this simulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.exchange import formats
from mpdt.data.exchange.incoming import store
from mpdt.data.exchange.selection import Selection
from mpdt.data.exchange.treatment import Rules
from mpdt.data.slices.standard import standard_additions
from mpdt.data.spec.catalog import shipped_catalog
from mpdt.data.spec.entry import EpisodeCounts
from mpdt.data.spec.smoke import smoke
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.dataset import Dataset
from mpdt.data.verify import one_step
from mpdt.data.verify.finding import Finding, Outcome
from mpdt.data.verify.one_step import Differences, differences, with_one_step
from mpdt.data.verify.verify import verify


def made(name: str, folder: Path) -> Dataset:
    spec = smoke(shipped_catalog().get(name))
    few = EpisodeCounts(random=1, expert=1)
    spec = msgspec.structs.replace(spec, episodes=few, tta={}, tasks=(0, 1), horizon=40)
    return collect(make_job(spec), folder / f"{name}.h5", workers=0).dataset


def imported(data: Dataset, folder: Path, family: str) -> Dataset:
    """As a foreign file: no seeds, no references."""
    formats.write("d4rl", Selection(data, np.arange(data.num_episodes), ""), folder / "flat")
    rules = Rules("d4rl", get_family(family), 40, any_length=True)
    found = formats.read("d4rl", [folder / "flat"], rules, "theirs")
    return store(found, folder / "theirs.h5", standard_additions)


@pytest.mark.parametrize("name", ["cheetah_vel", "ant_dir"])
def test_our_own_steps_come_back(name: str, tmp_path: Path) -> None:
    found = differences(made(name, tmp_path), most=50)
    assert found is not None and found.steps == 50
    assert 0 < found.observation[0] < 1e-5 and found.observation[1] < 1e-2
    assert found.reward[1] < 1e-3


def test_an_import_is_told_of_its_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = imported(made("cheetah_dir", tmp_path), tmp_path, "cheetah_dir")
    found = {one.id: one for one in verify(data.path, only=("replay",)).findings}["replay"]
    assert found.outcome.value == "NONE" and "no episode has a seed; one step of our" in found.text
    assert "from 160 stored states" in found.text  # 2 tasks, 2 episodes, 40 steps
    episode = data.episode(0)
    spoilt = episode.rewards + np.float32(9)
    monkeypatch.setattr(type(data), "episode", lambda self, i: _Other(episode, spoilt))
    found = {one.id: one for one in verify(data.path, only=("replay",)).findings}["replay"]
    assert found.outcome.value == "WARN" and "another reward, or another robot" in found.text
    assert differences(data).reward[0] == pytest.approx(9, abs=1e-3)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("off", "spread", "before", "after"),
    [
        (0.09, 0.5, Outcome.NONE, Outcome.NONE),
        (0.11, 0.5, Outcome.NONE, Outcome.WARN),
        (0.3, 2.0, Outcome.NONE, Outcome.NONE),
        (float("nan"), 0.5, Outcome.NONE, Outcome.WARN),
        (0.11, 0.5, Outcome.FAIL, Outcome.FAIL),
    ],
)
def test_a_fifth_of_the_rewards_spread_is_another_reward(
    monkeypatch: pytest.MonkeyPatch, off: float, spread: float, before: Outcome, after: Outcome
) -> None:
    found = Differences(1, (0.0, 0.0), (off, off), spread)
    monkeypatch.setattr(one_step, "differences", lambda data: found)
    material: Any = SimpleNamespace(
        is_imported=True, family="any", dataset=SimpleNamespace(episodes=[0])
    )
    assert with_one_step(Finding("replay", before, "no seeds"), material).outcome is after


def test_where_an_observation_does_not_tell_the_state_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of Meta-World, whose joints, speeds and mocap body no column has."""
    data = imported(made("cheetah_dir", tmp_path), tmp_path, "cheetah_dir")
    family = replace(data.contract(), one_step=None)
    monkeypatch.setattr(type(data), "contract", lambda self: family)
    (found,) = verify(data.path, only=("replay",)).findings
    said = "nor is one step compared: an observation of cheetah_dir does not tell its simulator's"
    assert found.outcome.value == "NONE" and f"no episode has a seed; {said}" in found.text
    monkeypatch.setattr(type(data), "contract", lambda self: replace(family, batch=None))
    (found,) = verify(data.path, only=("replay",)).findings
    assert found.text.endswith("no episode has a seed")


class _Other:
    """An episode with rewards that are not its own."""

    def __init__(self, episode: object, rewards: object) -> None:
        self._episode, self.rewards = episode, rewards

    def __getattr__(self, name: str) -> object:
        return getattr(self._episode, name)
