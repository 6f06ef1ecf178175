"""Behaviour training: rungs worked out by hand, and one tiny run through stable-baselines3."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.sim import pretrain as module
from mpdt.data.sim.network import load_rungs, network_actions
from mpdt.data.sim.pretrain import choose_rungs, judge, pretrain
from mpdt.data.spec.tasks import get_family
from mpdt.errors import UsageError


def test_rungs_cover_every_task_at_half_level() -> None:
    """Task 0 passes one half at snapshot 1, task 1 at snapshot 3: both must be kept."""
    levels = np.array([[0.0, 0.0], [0.5, 0.1], [0.8, 0.2], [0.9, 0.5], [1.0, 0.9], [1.0, 1.0]])
    assert choose_rungs(levels, 4) == [0, 1, 3, 5]


def test_rungs_are_even_where_nothing_is_forced() -> None:
    """One task, levels 0, .1 .. 1: one rung near one half, no wide gap."""
    levels = np.linspace(0, 1, 11)[:, None]
    chosen = choose_rungs(levels, 5)
    assert chosen[0] == 0 and chosen[-1] == 10 and {4, 5, 6} & set(chosen)
    assert len(chosen) == 5
    assert max(np.diff(chosen)) <= 3


def test_all_snapshots_are_rungs_when_there_are_few() -> None:
    assert choose_rungs(np.zeros((3, 2)), 20) == [0, 1, 2]


@pytest.fixture()
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    small = replace(
        module.SETTINGS["cheetah_dir"],
        rows=16,
        steps_per_update=25,
        minibatch=100,
        snapshots=2,
        hidden=8,
        judge_episodes=1,
        threads=1,
    )
    monkeypatch.setitem(module.SETTINGS, "cheetah_dir", small)


def test_tiny_run_writes_rungs_a_record_and_resumes(tiny: None, tmp_path: Path) -> None:
    lines: list[str] = []
    path = pretrain("cheetah_dir", steps=800, output=tmp_path, on_progress=lines.append)
    record = json.loads((tmp_path / "cheetah_dir.json").read_text())
    rungs = load_rungs(path)
    assert len(rungs) == len(record["rungs"]) >= 2
    assert record["rungs"][0]["train_step"] == 0
    assert record["rungs"][-1]["levels"] == {"forward": 1.0, "backward": 1.0}
    assert rungs[0]["w0"].shape == (18, 8) and rungs[0]["w2"].shape == (8, 6)
    pretrain("cheetah_dir", steps=1600, output=tmp_path, on_progress=lines.append)
    assert any("resuming at step 800" in line for line in lines)


def test_exported_network_is_the_trained_one(tiny: None, tmp_path: Path) -> None:
    """numpy on exported arrays equals stable-baselines3 on normalised observations."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from mpdt.data.sim.vecenv import LocomotionVecEnv

    pretrain("cheetah_dir", steps=800, output=tmp_path)
    work = tmp_path / "cheetah_dir.pretrain"
    env = LocomotionVecEnv(get_family("cheetah_dir"), 16, 0, 1)
    normalized = VecNormalize.load(str(work / "normalize.pkl"), env)
    model = PPO.load(work / "checkpoint.zip", env=normalized, device="cpu")
    inputs = np.random.Generator(np.random.PCG64(0)).normal(size=(5, 18)).astype(np.float32)
    with torch.no_grad():
        want, _ = model.predict(normalized.normalize_obs(inputs), deterministic=True)
    last = sorted(work.glob("0*.safetensors"))[-1]
    got = network_actions(module.load_file(last), inputs)
    np.testing.assert_allclose(np.clip(got, -1, 1), want, atol=1e-5)


def test_uniform_actions_return_what_was_published() -> None:
    """Random actions over 200 steps: about -36 forward and -4 backward."""
    forward, backward = judge(get_family("cheetah_dir"), None, 16, 0.0, seed=0, threads=1)
    assert -50 < forward < -22
    assert -18 < backward < 10


def test_bad_names_and_sizes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"did you mean 'cheetah_dir'"):
        pretrain("cheetah_dirr", output=tmp_path)
    with pytest.raises(UsageError, match="too few steps"):
        pretrain("cheetah_dir", steps=10, output=tmp_path)
