"""Frames of episodes: which ways are tried, what is said where none works, and a real strip."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from makers import make_episode, make_header, source_of

from mpdt.data.card import film
from mpdt.data.card.film import HEIGHT, WIDTH, shoot, ways_to_draw
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file
from mpdt.errors import SimulatorError, UsageError
from mpdt.seeding import SeedKey

STEPS = 3
KEY = (0, 0, 0, 0, 0)


def still_file(folder: Path, family: str = "cheetah_dir", shift: float = 0.0) -> Path:
    """One episode of a cheetah that gets no commands; `shift` falsifies an observation."""
    from mpdt.data.sim.locomotion_env import LocomotionEnv

    env = LocomotionEnv("cheetah_dir", "forward")
    observations = [env.reset(seed=SeedKey(7, *KEY).env_seed())[0]]
    actions = np.zeros((STEPS, 6), np.float32)
    observations += [env.step(action)[0] for action in actions]
    stored = np.stack(observations).astype(np.float32)
    stored[1, 0] += shift
    episode = make_episode(
        STEPS, observations=stored, actions=actions, quality=2, progress=1.0, seed_key=KEY
    )
    header = make_header(
        [episode], [TaskRow("forward", 0, "both", {})], family=family,
        spec={"name": "still", "seed": 7, "horizon": STEPS},
    )  # fmt: skip
    return write_file(folder / "still.h5", header, source_of([episode])).path


def test_the_ways_to_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(film.sys, "platform", "linux")
    assert ways_to_draw() == ("egl", "osmesa")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert ways_to_draw() == ("osmesa",)


def test_where_nothing_can_draw_the_error_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = still_file(tmp_path)  # MuJoCo looks at the variable when it is imported
    monkeypatch.setenv("MUJOCO_GL", "chalk")
    with pytest.raises(SimulatorError) as caught:
        shoot(path, [0])
    assert "chalk: RuntimeError" in caught.value.found and "libosmesa6" in caught.value.hint


def test_an_unknown_family_is_told_before_anything_is_started(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown family"):
        shoot(still_file(tmp_path, family="nobody's"), [0])


def filmed(path: Path, num_frames: int | None) -> film.Film:
    """Episode 0. Skips only where MuJoCo itself, asked by nobody of ours, cannot draw either."""
    try:
        (found,) = shoot(path, [0], num_frames)
    except SimulatorError:
        bare = "import mujoco as m; m.Renderer(m.MjModel.from_xml_string('<mujoco/>')).render()"
        for way in ways_to_draw():
            command, environment = [sys.executable, "-c", bare], os.environ | {"MUJOCO_GL": way}
            if not subprocess.run(command, env=environment, check=False).returncode:
                raise
        pytest.skip("MuJoCo finds no OpenGL here")
    return found


def test_a_strip(tmp_path: Path) -> None:
    """First, middle and last frame differ; nothing was falsified."""
    strip = filmed(still_file(tmp_path), 3)
    assert strip.steps == (0, 2, 3) and strip.is_equal
    assert strip.frames.shape == (3, HEIGHT, WIDTH, 3)
    assert strip.frames.std() > 20 and (strip.frames[0] != strip.frames[2]).any()
    if os.environ.get("MUJOCO_GL") is None:
        assert "MUJOCO_GL" not in os.environ  # only the child was told


@pytest.mark.slow
def test_a_falsified_episode_is_noticed(tmp_path: Path) -> None:
    strip = filmed(still_file(tmp_path, shift=0.5), None)
    assert not strip.is_equal and strip.steps == (0, 1, 2, 3)
