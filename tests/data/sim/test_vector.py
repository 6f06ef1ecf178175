"""Registered ids, gymnasium's own checker, and the batched vector against single environments."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import mpdt.envs
from mpdt.data.sim.vector import LocomotionVector
from mpdt.errors import UsageError

FIRST = {"CheetahVel": "v0.075", "CheetahDir": "forward", "AntDir": "dir-00", "MetaWorld": "reach"}


@pytest.mark.parametrize("name", [*mpdt.envs.LOCOMOTION, "MetaWorld"])
@pytest.mark.filterwarnings("ignore::UserWarning")  # infinite bounds, no render modes
def test_gymnasiums_checker_passes_and_specs_are_text(name: str) -> None:
    env = gymnasium.make(f"mpdt/{name}-v0", task=FIRST[name], horizon=5)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.spec is not None
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    first, _ = again.reset(seed=3)
    assert np.array_equal(first, env.reset(seed=3)[0])
    ends = [env.step(env.action_space.sample())[3] for _ in range(5)]
    assert ends == [False] * 4 + [True]


@pytest.mark.parametrize("name", [*mpdt.envs.LOCOMOTION])
def test_the_vector_equals_single_environments_bit_for_bit(name: str) -> None:
    """Three episodes of 7 steps with autoreset; the ant also falls and is reset alone."""
    options: dict[str, Any] = {"task": FIRST[name], "horizon": 7}
    if name == "AntDir":
        options |= {"terminate": True, "horizon": 60}
    batched = gymnasium.make_vec(f"mpdt/{name}-v0", num_envs=3, **options)
    single = gymnasium.make_vec(f"mpdt/{name}-v0", 3, vectorization_mode="sync", **options)
    assert isinstance(batched, LocomotionVector)
    for space in ("observation_space", "action_space", "single_observation_space"):
        assert getattr(batched, space) == getattr(single, space)
    generator = np.random.Generator(np.random.PCG64(3))
    fell = reset = 0
    for seed in (5, None):
        assert np.array_equal(batched.reset(seed=seed)[0], single.reset(seed=seed)[0])
        for _ in range(120 if name == "AntDir" else 20):
            actions = generator.uniform(-1, 1, batched.action_space.shape).astype(np.float32)
            ours, theirs = batched.step(actions), single.step(actions)
            for one, other in zip(ours[:4], theirs[:4], strict=True):
                assert one.dtype == other.dtype and np.array_equal(one, other)
            fell, reset = fell + int(ours[2].sum()), reset + int(ours[3].sum())
    assert reset and (fell > 0) == (name == "AntDir")


def test_rows_may_have_tasks_of_their_own() -> None:
    envs = LocomotionVector(2, "cheetah_dir", ["forward", "backward"])
    envs.reset(seed=[1, 1])
    _, rewards, *_ = envs.step(np.full((2, 6), 0.5, np.float32))
    cost = 0.05 * 6 * 0.25
    assert rewards[0] + cost == pytest.approx(-(rewards[1] + cost)) and rewards[0] != rewards[1]


def test_mistakes() -> None:
    with pytest.raises(UsageError, match="expected one task, or 2, found 1"):
        LocomotionVector(2, "cheetah_dir", ["forward"])
    envs = LocomotionVector(2, "cheetah_dir", "forward")
    with pytest.raises(UsageError, match="seeds and rows disagree"):
        envs.reset(seed=[1])
    with pytest.raises(UsageError, match="no such reset option"):
        envs.reset(options={"reset_mask": None})


@pytest.mark.parametrize(
    "code",
    [
        "import mpdt.envs, gymnasium; gymnasium.spec('mpdt/AntDir-v0')",
        "import gymnasium, mpdt; gymnasium.spec('mpdt/MetaWorld-v0')",
    ],
)
def test_registering_loads_no_simulator(code: str) -> None:
    code += "; import sys; assert not {'mujoco', 'metaworld', 'torch'} & set(sys.modules)"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_an_id_may_name_the_module_that_registers_it() -> None:
    env = gymnasium.make("mpdt.envs:mpdt/CheetahDir-v0", task="backward")
    assert env.reset(seed=0)[0].shape == (20,)
