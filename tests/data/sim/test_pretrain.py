"""Behaviour training: tiny runs through stable-baselines3."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.sim import pretrain as module
from mpdt.data.sim.network import load_rungs, network_actions
from mpdt.data.sim.pretrain import pretrain
from mpdt.data.spec.tasks import get_family
from mpdt.errors import StorageError, UsageError


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


def test_bad_names_and_sizes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"did you mean 'cheetah_dir'"):
        pretrain("cheetah_dirr", output=tmp_path)
    with pytest.raises(UsageError, match="too few steps"):
        pretrain("cheetah_dir", steps=10, output=tmp_path)


def test_a_folder_that_cannot_be_made_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="cannot be written") as caught:
        pretrain("cheetah_dir", output=tmp_path / "file" / "weights")
    assert "-o" in caught.value.hint
    (tmp_path / "cheetah_dir.json").mkdir()
    with pytest.raises(StorageError, match="a folder is in the way"):
        pretrain("cheetah_dir", output=tmp_path)


def test_a_disk_that_fills_up_on_the_way_is_one_clear_error(
    tiny: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StorageError, match="the disk is full"):
        pretrain("cheetah_dir", steps=800, output=tmp_path)
