from __future__ import annotations

import numpy as np
import pytest
from metaworld import sawyer_xyz_env
from metaworld.envs import sawyer_push_v3
from metaworld.utils import reward_utils

from mpdt.data.sim.metaworld import MetaworldEnv
from mpdt.data.sim.rotation import QuickRotation
from mpdt.data.sim.sawyer import quick_class, tolerance


def test_tolerance_by_hand():
    """0.3 above the upper bound is once the margin: there the value is value_at_margin."""
    assert tolerance(1.3, (0, 1), 0.3, "long_tail", 0.25) == pytest.approx(0.25)
    assert tolerance(0.5, (0, 1), 0.3, "long_tail") == 1.0


def test_tolerance_has_the_bits_of_the_published_one():
    generator = np.random.default_rng(0)
    for x, low, width, margin in generator.normal(size=(3000, 4)) ** 2:
        for value in (float(x), np.float64(x)):
            arguments = (value, (low, low + width), margin, "long_tail")
            assert tolerance(*arguments) == reward_utils.tolerance(*arguments)


@pytest.mark.parametrize("kind", ["gaussian", "hyperbolic", "reciprocal", "tanh_squared"])
def test_other_sigmoids_arrays_and_margins_are_handed_on(kind):
    x = np.array([0.1, 2.0])
    np.testing.assert_array_equal(
        tolerance(x, (0, 1), 0.5, kind), reward_utils.tolerance(x, (0, 1), 0.5, kind)
    )
    assert tolerance(2.0, (0, 1), 0.0, "long_tail") == 0.0
    with pytest.raises(ValueError, match="margin"):
        tolerance(2.0, (0, 1), -1.0, "long_tail")
    with pytest.raises(ValueError, match="Lower bound"):
        tolerance(2.0, (1, 0), 1.0, "long_tail")


def test_metaworld_itself_stays_as_it_was():
    before = dict(vars(sawyer_push_v3)), dict(vars(sawyer_xyz_env.SawyerXYZEnv))
    published = sawyer_push_v3.SawyerPushEnvV3
    made = quick_class(published)
    quick = vars(made)["_get_quat_objects"].__globals__
    assert quick["Rotation"] is QuickRotation and quick["reward_utils"].tolerance is tolerance
    assert published._get_quat_objects.__globals__["Rotation"] is not QuickRotation
    assert (dict(vars(sawyer_push_v3)), dict(vars(sawyer_xyz_env.SawyerXYZEnv))) == before


@pytest.mark.parametrize("name", ["door-open", "window-close"])
def test_second_goals_on_used_envs_have_the_published_bytes(name):
    """The hand does not move home in the first of a reset's two model resets; nothing shows it."""
    quick, plain = MetaworldEnv(name), MetaworldEnv(name, quick=False)
    generator = np.random.default_rng(0)
    for seed in (1, 2):
        goal = quick.draw(seed)
        assert quick.reset(goal).tobytes() == plain.reset(goal).tobytes()
        for action in generator.uniform(-1.5, 1.5, (40, 4)).astype(np.float32):
            (seen, *rest), (expected, *expected_rest) = quick.step(action), plain.step(action)
            assert seen.tobytes() == expected.tobytes() and rest == expected_rest


@pytest.mark.parametrize(("name", "ways"), [("push", 1), ("drawer-open", 2)])
def test_the_hands_way_home_is_kept_by_where_bodies_are_fixed(name, ways):
    """Push's goal is a mark on the table, drawer-open's moves the drawer."""
    env = MetaworldEnv(name)
    goals = [env.draw(seed) for seed in (1, 2)]
    first = [env.reset(goal).tobytes() for goal in (*goals, *goals)]
    assert len(env.inner._ways_home) == ways
    assert first[:2] == first[2:]
