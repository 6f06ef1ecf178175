"""Behaviour training: tiny runs through stable-baselines3."""

from __future__ import annotations

import errno
import json
import os
import pickle
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.sim import pretrain as module
from mpdt.data.sim.checkpoint import load_checkpoint, restore, save_checkpoint
from mpdt.data.sim.network import network_actions
from mpdt.data.sim.network_file import load_network, load_snapshot, split_rungs
from mpdt.data.sim.pretrain import pretrain
from mpdt.data.spec.tasks import get_family
from mpdt.data.spec.training import described
from mpdt.errors import BusyError, FormatError, StorageError, UsageError


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
    rungs = split_rungs(path.read_bytes(), path)
    assert len(rungs) == len(record["rungs"]) >= 2
    assert record["rungs"][0]["train_step"] == 0
    assert record["rungs"][-1]["levels"] == {"forward": 1.0, "backward": 1.0}
    assert rungs[0]["w0"].shape == (18, 8) and rungs[0]["w2"].shape == (8, 6)
    pretrain("cheetah_dir", steps=1600, output=tmp_path, on_progress=lines.append)
    assert any("resuming at step 800" in line for line in lines)


def test_snapshots_behind_the_checkpoint_are_none_of_a_resumed_run(
    tiny: None, tmp_path: Path
) -> None:
    """A kill came between a snapshot and the checkpoint that covers it."""
    pretrain("cheetah_dir", steps=800, output=tmp_path)
    work = tmp_path / "cheetah_dir.pretrain"
    (*_, last) = sorted(work.glob("[0-9]*.safetensors"))
    later = work / f"{1001:012d}.safetensors"
    later.write_bytes(last.read_bytes())
    pretrain("cheetah_dir", steps=1600, output=tmp_path)
    assert not later.exists() and last.exists()


def test_the_whole_state_comes_back_from_a_checkpoint(tiny: None, tmp_path: Path) -> None:
    """Policy, moments, running statistics and counters, put into a model of another seed."""
    pretrain("cheetah_dir", steps=800, output=tmp_path)
    work, run = tmp_path / "cheetah_dir.pretrain", checkpoint_run()
    kept = load_checkpoint(work, run)
    assert kept is not None
    model = fresh_model()
    restore(model, *kept, work / "checkpoint.safetensors")
    assert model.num_timesteps == 800 and model._n_updates > 0
    again = work / "again"
    again.mkdir()
    save_checkpoint(again, model, run, kept[0].curve)
    first, second = ((folder / "checkpoint.safetensors").read_bytes() for folder in (work, again))
    assert first == second, "what is read is what was written, to the bit"
    assert any(name.endswith("exp_avg_sq") and array.any() for name, array in kept[1].items())


def checkpoint_run() -> dict[str, Any]:
    settings = described(module.SETTINGS["cheetah_dir"])
    return {"network": "cheetah_dir", "seed": 0, "settings": settings}


def fresh_model() -> Any:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from mpdt.data.sim.vecenv import FamilyVecEnv

    settings = module.SETTINGS["cheetah_dir"]
    env = VecNormalize(FamilyVecEnv(get_family("cheetah_dir"), 16, 0, 1))
    return PPO("MlpPolicy", env, seed=3, device="cpu", **module._ppo(settings))


def test_exported_network_is_the_trained_one(tiny: None, tmp_path: Path) -> None:
    """numpy on exported arrays equals stable-baselines3 on normalised observations."""
    import torch

    pretrain("cheetah_dir", steps=800, output=tmp_path)
    work = tmp_path / "cheetah_dir.pretrain"
    kept, model = load_checkpoint(work, checkpoint_run()), fresh_model()
    assert kept is not None
    restore(model, *kept, work)
    inputs = np.random.Generator(np.random.PCG64(0)).normal(size=(5, 18)).astype(np.float32)
    with torch.no_grad():
        want, _ = model.predict(model.get_env().normalize_obs(inputs), deterministic=True)
    last = sorted(work.glob("0*.safetensors"))[-1]
    got = network_actions(load_snapshot(last), inputs)
    np.testing.assert_allclose(np.clip(got, -1, 1), want, atol=1e-5)
    assert len(load_network(str(tmp_path / "cheetah_dir")).rungs) >= 2


class Runs:
    """Unpickled, it leaves a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.path}",)


def test_pickles_in_the_working_folder_never_run(tiny: None, tmp_path: Path) -> None:
    """Neither as what earlier versions kept, nor under the name of today's checkpoint."""
    work, ran = tmp_path / "cheetah_dir.pretrain", tmp_path / "PWNED"
    work.mkdir()
    content = pickle.dumps(Runs(ran))
    (work / "curve.json").write_text('[{"step": 0, "mean_return": 0, "wall_s": 0}]')
    for name in ("normalize.pkl", "checkpoint.zip"):
        (work / name).write_bytes(content)
        with pytest.raises(FormatError, match="earlier version, which is never loaded") as caught:
            pretrain("cheetah_dir", steps=800, output=tmp_path)
        assert "--no-resume" in caught.value.hint
        (work / name).unlink()
    (work / "checkpoint.safetensors").write_bytes(content)
    with pytest.raises(FormatError, match="not a checkpoint"):
        pretrain("cheetah_dir", steps=800, output=tmp_path)
    (work / "normalize.pkl").write_bytes(content)
    (work / "mine.txt").write_text("the user's own")
    pretrain("cheetah_dir", steps=800, output=tmp_path, resume=False)
    assert not ran.exists()
    assert (work / "mine.txt").exists() and not (work / "normalize.pkl").exists()
    pickle.loads(content)
    assert ran.exists(), "unpickled, it would have run"


def test_what_is_refused_deletes_nothing_of_the_run_before(tiny: None, tmp_path: Path) -> None:
    work = tmp_path / "cheetah_dir.pretrain"
    work.mkdir()
    (work / "checkpoint.safetensors").write_bytes(b"hours of training")
    (work / f"{800:012d}.safetensors").write_bytes(b"a snapshot")
    (tmp_path / "cheetah_dir.json").mkdir()
    with pytest.raises(StorageError, match="a folder is in the way"):
        pretrain("cheetah_dir", steps=800, output=tmp_path, resume=False)
    assert sorted(path.name for path in work.iterdir()) == [
        f"{800:012d}.safetensors", "checkpoint.safetensors",
    ]  # fmt: skip


def test_a_checkpoint_of_something_else_is_refused(tiny: None, tmp_path: Path) -> None:
    from safetensors import safe_open
    from safetensors.numpy import save_file

    pretrain("cheetah_dir", steps=800, output=tmp_path)
    path = tmp_path / "cheetah_dir.pretrain/checkpoint.safetensors"

    def refused(match: str, **options: Any) -> None:
        before = {p: p.read_bytes() for p in tmp_path.rglob("*.*") if p.is_file()}
        with pytest.raises(FormatError, match=match):
            pretrain("cheetah_dir", **{"steps": 1600, "output": tmp_path} | options)
        assert {p: p.read_bytes() for p in tmp_path.rglob("*.*") if p.is_file()} == before

    refused("checkpoint of another run; expected seed 1, found 0", seed=1)
    good = path.read_bytes()
    with safe_open(path, framework="np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        header = json.loads(file.metadata()["mpdt"])
    name = "policy/action_net.weight"
    for changed, match in (
        ({name: arrays[name][:, :-1].copy()}, "other tensors than this network has: policy/act"),
        ({"more": arrays[name]}, "other tensors than this network has: more"),
        ({name: np.full_like(arrays[name], np.nan)}, "not finite"),
    ):
        save_file(arrays | changed, path, {"mpdt": json.dumps(header)})
        refused(match)
    save_file({k: v for k, v in arrays.items() if k != name}, path, {"mpdt": json.dumps(header)})
    refused("other tensors")
    for text in (
        "", "[]", "{", "[" * 2000, json.dumps(header | {"updates": "7"}),
        json.dumps(header | {"curve": []}), json.dumps(header | {"format": "mpdt-pretrain/9"}),
        json.dumps(header | {"more": 1}),
    ):  # fmt: skip
        save_file(arrays, path, {"mpdt": text})
        refused("not a checkpoint")
    for content in (b"", good[:-5], good[:100], b"\x00" * 100, b"\xff" * 8 + good[8:]):
        path.write_bytes(content)
        refused("not a checkpoint")
    path.write_bytes(good)
    judged = path.with_name("judged.json")
    for text in ("[]", '{"random x8": [1.0]}', '{"a": "b"}', "{"):
        judged.write_text(text)
        refused("not a list of judged snapshots", steps=800)


def test_two_processes_do_not_train_in_one_folder(tiny: None, tmp_path: Path) -> None:
    from mpdt.disk import holding

    work = tmp_path / "cheetah_dir.pretrain"
    work.mkdir()
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    other = context.Process(target=hold, args=(work, theirs), daemon=True)
    other.start()
    assert ours.recv() == "held"
    with pytest.raises(BusyError) as caught:
        pretrain("cheetah_dir", steps=800, output=tmp_path)
    assert str(other.pid) in str(caught.value)
    ours.send("go")
    other.join()
    with holding(work, amends=True):
        pass


def hold(work: Path, pipe: Any) -> None:
    from mpdt.disk import holding

    with holding(work, amends=True):
        pipe.send("held")
        pipe.recv()


def test_bad_names_and_sizes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"did you mean 'cheetah_dir'"):
        pretrain("cheetah_dirr", output=tmp_path)
    with pytest.raises(UsageError, match="too few steps"):
        pretrain("cheetah_dir", steps=10, output=tmp_path)


def test_a_folder_that_cannot_be_made_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="cannot be written") as caught:
        pretrain("cheetah_dir", output=tmp_path / "file" / "weights")
    assert "another folder" in caught.value.hint
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


def test_a_clearing_that_was_ended_halfway_is_gone_on_with(tiny: None, tmp_path: Path) -> None:
    """Without a checkpoint, what else lies there is of an earlier run."""
    pretrain("cheetah_dir", steps=800, output=tmp_path)
    work = tmp_path / "cheetah_dir.pretrain"
    (work / "checkpoint.safetensors").unlink()
    judged = json.loads((work / "judged.json").read_text())
    stale = {name: [12345.0] * len(returns) for name, returns in judged.items()}
    (work / "judged.json").write_text(json.dumps(stale))
    pretrain("cheetah_dir", steps=800, output=tmp_path, seed=1)
    assert "12345" not in (tmp_path / "cheetah_dir.json").read_text()
