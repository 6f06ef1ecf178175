"""Our rewards and successes against the published ones on scenes that no physics made.

The simulator's arrays are written by hand: the object anywhere between its start and the target,
the fingers around it or near it, so that every branch of a reward is met within 200 scenes.
"""

from __future__ import annotations

import numpy as np
import pytest

from mpdt.data.sim.lockstep.rows import TaskRows
from mpdt.data.sim.lockstep.tasks import RULES
from mpdt.data.sim.metaworld import MetaworldEnv, quiet

SCENES = 200
# Precisions that mix, prisms, walls, tilts, what is remembered of a first step, goal lines.
SAMPLE = ["shelf-place", "peg-insert-side", "push-wall", "assembly", "bin-picking", "soccer"]
INSIDE = {
    "peg-insert-side": ("pegHead", "bottom_right_corner_collision_box_1",
                        "top_left_corner_collision_box_1"),
}  # fmt: skip
"""A site that has to lie between two others now and then."""
HAND = ("hand", "claw", "pad", "EndEffector")


def compare(name):
    """How many rewards of the scenes differ from each other."""
    generator = np.random.default_rng(3)
    env = MetaworldEnv(name)
    rows = TaskRows(name, env.inner, env.reset, SCENES)
    goal, inner, data = env.draw(1), env.inner, env.scene[1]
    rows.reset([goal] * SCENES)
    physics = rows._physics
    place = inner._get_pos_objects()[:3].copy()
    base = {key: getattr(data, key).copy() for key in ("xpos", "site_xpos", "geom_xpos", "qpos")}
    fingers = (inner._tips[0] + inner._tips[1]) / 2.0
    parts = {"xpos": ("body", env.scene[0].nbody), "site_xpos": ("site", env.scene[0].nsite),
             "geom_xpos": ("geom", env.scene[0].ngeom)}  # fmt: skip
    of_hand = {
        key: np.array([any(word in getattr(data, kind)(i).name for word in HAND) for i in range(n)])
        for key, (kind, n) in parts.items()
    }
    actions = generator.uniform(-1.2, 1.2, (SCENES, 4)).astype(np.float32)
    actions[::5, 3] = 1.0
    wanted = []
    for row in range(SCENES):
        share = generator.choice([0.0, generator.random(), 1.0])
        moved = share * (inner._target_pos - place) + generator.normal(0, 0.02, 3)
        moved[2] += generator.choice([0.0, 0.03, 0.1])
        near = generator.normal(size=3) * generator.choice([0.001, 0.004, 0.03, 0.1])
        reached = place + moved + near - fingers
        for key in parts:
            way = np.where(of_hand[key][:, None], reached, moved)
            loose = generator.choice([0.0, 0.02], (len(way), 1)) * ~of_hand[key][:, None]
            getattr(data, key)[:] = base[key] + way + loose * generator.normal(size=way.shape)
        if name in INSIDE and row % 2:
            inner_site, *corners = (data.site(site).xpos for site in INSIDE[name])
            inner_site[:] = corners[0] + generator.random(3) * (corners[1] - corners[0])
        data.qpos[:] = base["qpos"] + generator.normal(size=base["qpos"].shape) * 0.3
        physics.positions[row] = data.qpos
        physics.answers[row] = touching = bool(generator.integers(2))
        inner.touching_object = lambda geom, answer=touching: answer
        inner._target_to_obj_init = None  # bin-picking's, of the first step of an episode
        for view, kept in zip(physics._views, physics.arrays.values(), strict=True):
            kept[row] = view
        space = inner.sawyer_observation_space
        with quiet():
            seen = inner._get_obs().clip(space.low, space.high)
            reward, info = inner.evaluate_state(seen, actions[row])
        wanted.append((float(reward), bool(info["success"])))
    physics.step = lambda: None
    _, rewards, successes = rows.step(actions)
    found = list(zip(rewards.tolist(), successes.tolist(), strict=True))
    differing = [
        (row, a, b) for row, (a, b) in enumerate(zip(found, wanted, strict=True)) if a != b
    ]
    assert not differing, differing[:3]
    return len(set(found))


@pytest.mark.parametrize("name", SAMPLE)
def test_rewards_have_the_published_bits_in_every_branch(name):
    assert compare(name) > 50


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(RULES))
def test_rewards_of_every_task_have_the_published_bits(name):
    assert compare(name) > 10
