"""Registered ids, gymnasium's own checker, and the batched vector against single environments."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import types
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import minari
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import mpdt.envs
from mpdt.data.sim.gym import MetaworldTask
from mpdt.data.sim.vector import LocomotionVector
from mpdt.errors import UsageError

FIRST = {"CheetahVel": "v0.075", "CheetahDir": "forward", "AntDir": "dir-00", "MetaWorld": "reach"}


@pytest.mark.parametrize("name", FIRST)
@pytest.mark.filterwarnings("ignore::UserWarning")  # infinite bounds
def test_gymnasiums_checker_passes_and_specs_are_text(name: str) -> None:
    env = gymnasium.make(f"mpdt/{name}-v0", task=FIRST[name], horizon=5)
    check_env(env.unwrapped, skip_render_check=True)  # rendering: see below
    assert env.spec is not None
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    first, _ = again.reset(seed=3)
    assert np.array_equal(first, env.reset(seed=3)[0])
    ends = [env.step(env.action_space.sample())[3] for _ in range(5)]
    assert ends == [False] * 4 + [True]


@pytest.mark.parametrize("name", FIRST)
def test_infos_have_the_same_keys_and_nothing_comes_before_reset(name: str) -> None:
    env = gymnasium.make(f"mpdt/{name}-v0", task=FIRST[name], disable_env_checker=True).unwrapped
    with pytest.raises(ResetNeeded, match=FIRST[name]):
        env.step(env.action_space.sample())
    with pytest.raises(ResetNeeded):
        env.render()
    _, before = env.reset(seed=1)
    *_, after = env.step(env.action_space.sample())
    assert before.keys() == after.keys()
    with pytest.raises(UsageError, match="no render mode"):
        env.render()


def tree_map(function: Any, first: Any, *others: Any) -> Any:
    """What Minari's collector takes of jax, which is large and needed for nothing else here."""
    if not isinstance(first, dict):
        return function(first, *others)
    assert all(first.keys() == other.keys() for other in others), "one structure at every step"
    return {key: tree_map(function, first[key], *(o[key] for o in others)) for key in first}


@pytest.mark.parametrize("name", FIRST)
def test_minari_collects_with_infos(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tree_util: Any = types.ModuleType("jax.tree_util")
    tree_util.tree_map = tree_map
    monkeypatch.setitem(sys.modules, "jax", types.ModuleType("jax"))
    monkeypatch.setitem(sys.modules, "jax.tree_util", tree_util)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    make, folders = tempfile.TemporaryDirectory, list[Any]()  # Minari leaves them behind
    monkeypatch.setattr(
        tempfile, "TemporaryDirectory", lambda **kw: folders.append(make(**kw)) or folders[-1]
    )
    env = gymnasium.make(f"mpdt/{name}-v0", task=FIRST[name], horizon=3, disable_env_checker=True)
    collector = minari.DataCollector(env, record_infos=True)
    try:
        for seed in (0, 1):
            collector.reset(seed=seed)
            for _ in range(3):
                collector.step(env.action_space.sample())
        with warnings.catch_warnings(action="ignore"):  # what else one should write about it
            made = collector.create_dataset(f"mpdt/{name.lower()}/test-v0")
    finally:
        for folder in folders:
            folder.cleanup()
    assert [len(episode.rewards) for episode in made] == [3, 3]
    if name == "MetaWorld":
        infos = made[1].infos
        assert infos["goal"].shape == (4, 6) and infos["success"].tolist() == [False] * 4
        assert (infos["goal"] == env.reset(seed=1)[1]["goal"]).all()


DRAW = """
import gymnasium, numpy, sys
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
import mpdt.envs
from mpdt.errors import SimulatorError
name, task = sys.argv[1:]
env = gymnasium.make(f"mpdt/{name}-v0", task=task, horizon=5, render_mode="rgb_array")
env.reset(seed=1)
try:
    first = env.render()
except SimulatorError as error:
    print("SKIP", error)
    sys.exit(0)
for _ in range(5):
    env.step(numpy.ones(env.action_space.shape, numpy.float32))
last = env.render()
assert first.shape == (480, 480, 3) and first.dtype == numpy.uint8 and first.std() > 20
assert (first != last).any()
if name == "MetaWorld":  # the others have modes that need a window
    check_env(env.unwrapped)
    env.close()
    print("DREW")
    sys.exit(0)
env.close()
envs = gymnasium.make_vec(f"mpdt/{name}-v0", num_envs=2, task=task, render_mode="rgb_array")
envs.reset(seed=1)
frames = envs.render()
assert len(frames) == 2 and frames[1].shape == (480, 480, 3) and (frames[0] != frames[1]).any()
envs.close()
print("DREW")
"""


@pytest.mark.parametrize("name", ["AntDir", "MetaWorld"])
def test_rgb_array(name: str) -> None:
    """In a process of its own: OpenGL is chosen when mujoco is imported."""
    done = run_python(DRAW, name, FIRST[name], gl="egl")
    if "SKIP" in done.stdout:
        pytest.skip(done.stdout)
    assert (done.returncode, done.stdout.split()[-1:]) == (0, ["DREW"]), done.stderr


@pytest.mark.parametrize("name", ["AntDir", "MetaWorld"])
def test_where_nothing_can_draw_render_is_one_clear_error(name: str) -> None:
    code = (
        "import sys, gymnasium, mpdt.envs\n"
        "from mpdt.errors import SimulatorError\n"
        "name, task = sys.argv[1:]\n"
        "env = gymnasium.make(f'mpdt/{name}-v0', task=task, render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "try:\n    env.render()\n"
        "except SimulatorError as error:\n    print(error, error.hint)\n"
    )
    done = run_python(code, name, FIRST[name], gl="")
    if not done.stdout:
        pytest.skip("there is a screen")
    assert "nothing here can draw a picture" in done.stdout and "MUJOCO_GL=egl" in done.stdout


def run_python(code: str, *arguments: str, gl: str) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    environment |= {"MUJOCO_GL": gl} if gl else {}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


def test_a_mode_that_is_not_there_is_refused() -> None:
    with pytest.raises(UsageError, match="no such render mode"):
        MetaworldTask("reach", render_mode="human")
    with pytest.raises(UsageError, match="no such render mode"):
        LocomotionVector(2, "cheetah_dir", "forward", render_mode="ansi")


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
    with pytest.raises(UsageError, match="a seed is at least 0"):
        envs.reset(seed=-1)
    with pytest.raises(UsageError, match="no such reset option; expected reset_mask, found goal"):
        envs.reset(options={"goal": None})
    for mask in ([True, False], np.array([1, 0]), np.zeros(2, bool), np.ones(3, bool)):
        with pytest.raises(UsageError, match="reset_mask: not a mask of rows"):
            envs.reset(options={"reset_mask": mask})


def test_nothing_comes_before_the_reset_of_all_rows() -> None:
    envs = LocomotionVector(2, "cheetah_dir", "forward")
    actions = np.zeros((2, 6), np.float32)
    with pytest.raises(ResetNeeded):
        envs.step(actions)
    with pytest.raises(ResetNeeded):
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.reset(seed=np.int64(1))
    envs.step(actions)
    with pytest.raises(UsageError, match="no render mode"):
        envs.render()


def test_a_masked_reset_is_gymnasiums_own() -> None:
    """Rows 0 and 2 start anew in the middle, one of them just before its autoreset."""
    options: dict[str, Any] = {"task": FIRST["AntDir"], "horizon": 6, "terminate": True}
    batched = gymnasium.make_vec("mpdt/AntDir-v0", num_envs=3, **options)
    single = gymnasium.make_vec("mpdt/AntDir-v0", 3, vectorization_mode="sync", **options)
    generator = np.random.Generator(np.random.PCG64(4))
    for envs in (batched, single):
        envs.reset(seed=5)
    for step in range(20):
        if step in (3, 6, 13):
            mask, seed = np.array([True, False, True]), [9, None, None] if step == 6 else None
            found = [e.reset(seed=seed, options={"reset_mask": mask}) for e in (batched, single)]
            assert np.array_equal(found[0][0], found[1][0])
        actions = generator.uniform(-1, 1, batched.action_space.shape).astype(np.float32)
        ours, theirs = batched.step(actions), single.step(actions)
        for one, other in zip(ours[:4], theirs[:4], strict=True):
            assert np.array_equal(one, other), step


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
