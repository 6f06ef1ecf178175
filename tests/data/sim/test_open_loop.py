"""Random episodes run natively in one go: the same bytes as one step after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from mpdt.data.sim.actors import OpenLoopPolicy, Rows, UniformPolicy, ZeroPolicy
from mpdt.data.sim.locomotion import STRETCH, LocomotionBatch
from mpdt.data.sim.play import run_block
from mpdt.data.spec.tasks import get_family
from mpdt.seeding import Quality, SeedKey

FAMILIES = ["cheetah_dir", "cheetah_vel", "ant_dir"]


class Stepwise:
    """The same policy, its future hidden: the slow twin."""

    def __init__(self, policy: UniformPolicy | ZeroPolicy) -> None:
        self.info, self._policy = policy.info, policy

    def begin(self, rows: Rows) -> None:
        self._policy.begin(rows)

    def act(self, step: int, observations: Any, rewards: Any = None) -> npt.NDArray[np.float64]:
        return self._policy.act(step, observations)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("horizon", [1, STRETCH, 200])
@pytest.mark.parametrize("scale", [0.0, 1.0, 3.0])
def test_open_loop_equals_stepwise(name: str, horizon: int, scale: float) -> None:
    family = get_family(name)
    rows = 6
    tasks = [family.tasks[-1 - row % 2] for row in range(rows)]
    keys = [SeedKey(11, family.id, tasks[row].index, Quality.TTA, 0, row) for row in range(rows)]
    policy = (
        UniformPolicy(family.action_size, -1.0, 1.0, scale)
        if scale
        else ZeroPolicy(family.action_size)
    )
    assert isinstance(policy, OpenLoopPolicy)
    assert not isinstance(Stepwise(policy), OpenLoopPolicy)
    options: dict[str, Any] = {"horizon": horizon, "quality": 0, "progress": 0.0}
    options |= {"clip": scale == 1.0, "hidden_columns": (2,)}
    fast = run_block(LocomotionBatch(family, tasks), policy, keys, **options)
    slow = run_block(LocomotionBatch(family, tasks), Stepwise(policy), keys, **options)
    for one, other in zip(fast, slow, strict=True):
        for field in ("observations", "actions", "rewards", "terminations", "truncations"):
            assert np.array_equal(getattr(one, field), getattr(other, field)), field
    if name == "ant_dir" and horizon == 200 and scale:
        lengths = {episode.length for episode in fast}
        assert len(lengths) > 1, "some ants fall, at different steps"


def test_a_fall_ends_the_episode_and_nothing_follows_it() -> None:
    family = get_family("ant_dir")
    keys = [SeedKey(1, 2, 0, Quality.RANDOM, 0, row) for row in range(8)]
    batch = LocomotionBatch(family, [family.tasks[0]] * 8)
    batch.reset(keys, batch.draw_goals(keys))
    policy = UniformPolicy(8, -1.0, 1.0)
    policy.begin(Rows(keys, [], 200))
    play = batch.play(policy.all_actions().astype(np.float32))
    fallen = play.terminations.any(axis=1)
    assert fallen.any()
    for row in np.flatnonzero(fallen):
        step = int(play.terminations[row].argmax())
        height = play.observations[row, : step + 1, 0]
        assert ((height >= 0.2) & (height <= 1.0)).all()
        assert not 0.2 <= play.observations[row, step + 1, 0] <= 1.0
        after = -(-(step + 1) // STRETCH) * STRETCH  # the stretch is played to its end
        assert not play.rewards[row, after:].any()
