from __future__ import annotations

import hashlib

import numpy as np
import pytest

from mpdt.data.sim.actors import ConstantPolicy, Rows, UniformPolicy, ZeroPolicy, definition_hash
from mpdt.data.sim.metaworld import MetaworldEnv, find_class
from mpdt.data.sim.scripted import ScriptedPolicy
from mpdt.errors import UsageError
from mpdt.seeding import SeedKey, Stream

KEYS = [SeedKey(7, 3, 0, 1, 0, row) for row in range(3)]
GOALS = [np.zeros(3)] * 3
BLANK = np.zeros((3, 39))


def run(policy, keys, horizon, observations=BLANK):
    policy.begin(Rows(keys, GOALS[: len(keys)], horizon))
    return np.stack([policy.act(t, observations[: len(keys)]) for t in range(horizon)], axis=1)


def test_definition_hash_is_sha256_of_canonical_json():
    expected = hashlib.sha256(b'{"a":[1,2.5],"b":"x"}').digest()
    assert definition_hash({"b": "x", "a": [1, 2.5]}) == expected


def test_uniform_row_is_its_keys_own_stream():
    actions = run(UniformPolicy(4, -1.0, 1.0), KEYS, 6)
    for row, key in enumerate(KEYS):
        expected = key.generator(Stream.UNIFORM).uniform(-1.0, 1.0, (6, 4))
        np.testing.assert_array_equal(actions[row], expected)
    assert not np.array_equal(actions[0], actions[1])


def test_uniform_shorter_horizon_is_a_prefix_and_width_does_not_matter():
    wide = run(UniformPolicy(4, -1.0, 1.0), KEYS, 20)
    narrow = run(UniformPolicy(4, -1.0, 1.0), KEYS[1:2], 8)
    np.testing.assert_array_equal(wide[1:2, :8], narrow)


def test_uniform_scale_widens_the_box():
    plain = run(UniformPolicy(4, -1.0, 1.0), KEYS, 50)
    wide = run(UniformPolicy(4, -1.0, 1.0, 3.0), KEYS, 50)
    np.testing.assert_allclose(wide, 3.0 * plain, rtol=1e-12)
    # Two thirds of a uniform draw from [-3, 3] lie outside [-1, 1]; 600 draws, 4 sigma = .077
    assert abs((np.abs(wide) > 1).mean() - 2 / 3) < 0.08


def test_zero_policy():
    assert run(ZeroPolicy(4), KEYS, 2).tolist() == np.zeros((3, 2, 4)).tolist()


def test_constant_policy_repeats_its_action():
    policy = ConstantPolicy(np.array([0.0, -1.0], np.float32))
    policy.begin(Rows(KEYS, horizon=4))
    assert policy.all_actions().shape == (3, 4, 2)
    assert (policy.all_actions() == [0.0, -1.0]).all()
    assert policy.act(2, np.zeros((3, 5))).tolist() == [[0.0, -1.0]] * 3
    assert policy.info.hash != ConstantPolicy(np.array([0.0, 1.0], np.float32)).info.hash


def test_hashes_tell_policies_apart_and_nothing_else():
    same = {
        UniformPolicy(4, -1.0, 1.0).info.hash,
        UniformPolicy(4, -1, 1, 1, task=3).info.hash,
    }
    assert len(same) == 1
    policies = [
        UniformPolicy(4, -1.0, 1.0),
        UniformPolicy(4, -1.0, 1.0, 3.0),
        UniformPolicy(6, -1.0, 1.0),
        ZeroPolicy(4),
        ScriptedPolicy(["reach"], 0.0),
        ScriptedPolicy(["reach"], 0.5),
        ScriptedPolicy(["push"], 0.5),
    ]
    assert len({policy.info.hash for policy in policies}) == len(policies)
    assert all(len(policy.info.hash) == 32 for policy in policies)
    names = [policy.info.name for policy in policies]
    assert names[:2] == ["uniform", "uniform*3"] and names[4:6] == ["script", "script+u0.50"]


@pytest.fixture(scope="module")
def reach():
    env = MetaworldEnv("reach")
    return env.reset(env.draw(5))


def test_rate_one_is_exactly_uniform(reach):
    observations = np.stack([reach] * 3)
    mixed = run(ScriptedPolicy(["reach"] * 3, 1.0), KEYS, 30, observations)
    np.testing.assert_array_equal(mixed, run(UniformPolicy(4, -1.0, 1.0), KEYS, 30))


def test_rate_zero_is_exactly_the_clipped_script(reach):
    observations = np.stack([reach] * 3)
    with pytest.warns(UserWarning, match="may be too high"):
        expected = np.clip(find_class("reach", "script")().get_action(reach), -1.0, 1.0)
    mixed = run(ScriptedPolicy(["reach"], 0.0), KEYS, 4, observations)  # one name for all rows
    for row in range(3):
        for step in range(4):
            np.testing.assert_array_equal(mixed[row, step], expected)
    # This start is far from the goal, so the script itself asks for more than 1.
    assert np.abs(expected).max() == 1.0


def test_mixing_replaces_where_the_coin_says_and_nests_over_rates(reach):
    observations = np.stack([reach] * 3)
    script = run(ScriptedPolicy(["reach"] * 3, 0.0), KEYS, 200, observations)
    uniform = run(UniformPolicy(4, -1.0, 1.0), KEYS, 200)
    for rate in (0.3, 0.7):
        mixed = run(ScriptedPolicy(["reach"] * 3, rate), KEYS, 200, observations)
        coins = np.stack([key.generator(Stream.POLICY).random(200) < rate for key in KEYS])
        np.testing.assert_array_equal(mixed, np.where(coins[..., None], uniform, script))
        # 600 coins: four standard errors are at most 0.08
        assert abs(coins.mean() - rate) < 0.08


def test_only_a_corrected_script_is_told_from_meta_worlds_own():
    """Data of uncorrected tasks made before there were corrections keep their hash."""
    plain = b'{"kind":"script","metaworld":"3.1.1","mix_rate":0.5,"tasks":["reach"]}'
    assert ScriptedPolicy(["reach"], 0.5).info.hash == hashlib.sha256(plain).digest()
    corrected = (
        b'{"corrections":{"window-open":{"rule":"touch_handle","version":1}},'
        b'"kind":"script","metaworld":"3.1.1","mix_rate":0.0,"tasks":["window-open"]}'
    )
    assert ScriptedPolicy(["window-open"]).info.hash == hashlib.sha256(corrected).digest()


@pytest.mark.parametrize("rate", [-0.1, 1.5, float("nan")])
def test_rate_outside_the_unit_interval_is_refused(rate):
    with pytest.raises(
        UsageError, match=r"mixing rate out of range; expected a number in \[0, 1\]"
    ):
        ScriptedPolicy(["reach"], rate)


def test_unknown_script_names_the_nearest():
    with pytest.raises(UsageError, match="did you mean 'reach'"):
        ScriptedPolicy(["reech"]).begin(Rows(KEYS[:1], GOALS[:1], 5))


def test_policies_that_act_at_once_answer_as_each_alone(reach):
    """Three rates, one of them the script alone, two tasks: the same bytes as one after another."""
    made = [("reach", 0.0), ("reach", 0.5), ("push", 0.3), ("reach", 1.0)]
    seen = [np.stack([reach + 0.01 * (n + row) for row in range(3)]) for n in range(len(made))]
    policies = [ScriptedPolicy([name], rate) for name, rate in made]
    for policy in policies:
        policy.begin(Rows(KEYS, GOALS, 20))
    for step in range(20):
        found = ScriptedPolicy.act_all(step, policies, seen)
        for policy, own, actions in zip(policies, seen, found, strict=True):
            assert actions.tobytes() == policy.act(step, own).tobytes()
    assert (found[0] != found[1]).any() and (found[0] != found[2]).any()
