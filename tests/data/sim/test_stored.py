"""Stored actions played again: natively or step by step, the episodes come back byte for byte."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mpdt.data.sim.actors import UniformPolicy
from mpdt.data.sim.batch import HasScene, PlaysAhead
from mpdt.data.sim.locomotion import LocomotionBatch
from mpdt.data.sim.metaworld import MetaworldBatch
from mpdt.data.sim.play import run_block
from mpdt.data.sim.stored import play_stored, watch_stored
from mpdt.data.spec.tasks import get_family
from mpdt.seeding import Quality, SeedKey

ANT = get_family("ant_dir")
KEYS = [SeedKey(1, ANT.id, 0, Quality.RANDOM, 0, row) for row in range(6)]


class Stepwise:
    """A batch that can only step."""

    def __init__(self, batch: LocomotionBatch) -> None:
        for name in ("reset", "step", "action_size", "observation_size"):
            setattr(self, name, getattr(batch, name))


def ants() -> LocomotionBatch:
    return LocomotionBatch(ANT, [ANT.tasks[0]] * len(KEYS))


@pytest.fixture(scope="module")
def episodes() -> list[Any]:
    policy = UniformPolicy(8, -1.0, 1.0)
    return run_block(ants(), policy, KEYS, horizon=200, quality=0, progress=0.0)


@pytest.mark.parametrize("native", [True, False])
def test_episodes_of_several_lengths_come_back(episodes: list[Any], native: bool) -> None:
    env: Any = ants() if native else Stepwise(ants())
    assert isinstance(env, PlaysAhead) == native
    play = play_stored(env, episodes, KEYS)
    assert len({episode.length for episode in episodes}) > 1, "some ants fall"
    for row, episode in enumerate(episodes):
        length = episode.length
        observations = play.observations[row, : length + 1].astype(np.float32)
        assert observations.tobytes() == episode.observations.tobytes()
        assert play.rewards[row, :length].astype(np.float32).tobytes() == episode.rewards.tobytes()
        assert play.terminations[row, :length].tolist() == episode.terminations.tolist()


def test_success_is_played_too_and_a_camera_sees_every_step() -> None:
    family = get_family("ml10")
    key = SeedKey(1, family.id, 0, Quality.RANDOM, 0, 0)
    env, policy = MetaworldBatch([family.task("reach")]), UniformPolicy(4, -1.0, 1.0)
    (episode,) = run_block(env, policy, [key], horizon=3, quality=0, progress=0.0)
    play = play_stored(env, [episode], [key])
    assert play.successes is not None and episode.successes is not None
    assert play.successes[0].tolist() == episode.successes.tolist()
    assert isinstance(env, HasScene)
    hands = []
    for step, seen in enumerate(watch_stored(env, episode, key)):
        assert seen.astype(np.float32).tobytes() == episode.observations[step].tobytes()
        hands.append(env.scene(0)[1].body("hand").xpos.copy())
    assert len(hands) == 4 and not np.array_equal(hands[0], hands[3])


def test_a_scene_is_the_row_as_it_stands(episodes: list[Any]) -> None:
    env = ants()
    model, before = env.scene(2)
    play_stored(env, episodes, KEYS)
    _, after = env.scene(2)
    assert model.nq == 15 and not np.array_equal(before.qpos, after.qpos)
    assert after.qpos[2:].tolist() == env.observations()[2, :13].tolist()
    np.testing.assert_allclose(after.body("torso").xpos, after.qpos[:3])
