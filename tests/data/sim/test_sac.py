"""SAC for one's own families: what it exports, and that a kill changes no byte."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_families import forgotten, line

import mpdt
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.sim.checkpoint import load_checkpoint, restore
from mpdt.data.sim.network import network_actions
from mpdt.data.sim.network_file import load_network, load_snapshot
from mpdt.data.sim.pretrain import pretrain
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.spec.family import Family
from mpdt.data.spec.training import SacSettings, described, own_settings
from mpdt.data.verify.verify import verify
from mpdt.errors import FormatError, SimulatorError, SpecError, UsageError

TINY: dict[str, Any] = {
    "algorithm": "sac", "steps": 360, "rows": 3, "minibatch": 16, "gradient_steps": 1, "hidden": 8,
    "warmup": 30, "buffer": 240, "snapshots": 12, "num_rungs": 4, "judge_episodes": 2,
    "threads": 1,
}  # fmt: skip


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


def wide() -> Family:
    """Bounds that are no [-1, 1], so that a scale forgotten is seen."""
    return mpdt.register_family(line(action_low=-0.5, action_high=2.0, env=_wide, pretrain=TINY))


def _wide(task: mpdt.Task) -> Any:
    from gymnasium import spaces
    from own_families import Line

    env = Line(task.goal[0])
    env.action_space = spaces.Box(-0.5, 2.0, (1,), np.float32)
    return env


class Killed(BaseException):
    """Nothing of ours catches it."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that nobody stopped."""
    folder = tmp_path_factory.mktemp("trained")
    with forgotten():
        wide()
        pretrain("line", output=folder)
    return folder


def files_of(folder: Path, name: str = "line") -> dict[str, bytes]:
    """All that a run leaves, without seconds and its checkpoint, whose curve has some too."""
    found = {path.name: path.read_bytes() for path in folder.rglob("*.safetensors")}
    found["curve"] = found.pop("checkpoint.safetensors").partition(b"wall_s")[0]
    record = json.loads((folder / f"{name}.json").read_text())
    for point in [record, *record["curve"]]:
        del point["wall_s"]
    return found | {"record": json.dumps(record).encode()}


def test_a_killed_run_ends_with_the_bytes_of_one_that_was_not(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mpdt.data.sim import snapshots

    wide()
    kept, write = tmp_path / "line.pretrain", snapshots.write_bytes
    resumed: list[str] = []
    for last in (2, 4, 9):  # snapshots before a kill, once between one and its checkpoint

        def dies(path: Path, content: bytes, last: int = last) -> None:
            if len(list(kept.glob("0*.safetensors"))) > last:
                raise Killed
            write(path, content)

        with monkeypatch.context() as patched, pytest.raises(Killed):
            patched.setattr(snapshots, "write_bytes", dies)
            pretrain("line", output=tmp_path)
        assert not (tmp_path / "line.json").exists()
    pretrain("line", output=tmp_path, on_progress=resumed.append)
    assert resumed[0] == "resuming at step 240"  # the second snapshot after 4 horizons of 3 rows
    assert files_of(tmp_path) == files_of(trained)


def test_the_exported_actor_is_the_trained_one(trained: Path) -> None:
    """numpy on exported arrays equals stable-baselines3's deterministic action to rounding."""
    from mpdt.data.sim import sac

    family = wide()
    settings = own_settings(family.pretrain)
    assert isinstance(settings, SacSettings) and settings.discount == 0.98
    work = trained / "line.pretrain"
    run = {"network": "line", "seed": 0, "settings": described(settings), "scene": "line/1.0.0"}
    kept = load_checkpoint(work, run)
    assert kept is not None and kept[0].num_timesteps == 360
    model = sac._model(family, settings, seed=9)
    restore(model, *kept, work / "checkpoint.safetensors")
    assert model.replay_buffer.full and model.replay_buffer.pos == 40  # 120 of each row, into 80
    inputs = np.random.Generator(np.random.PCG64(0)).normal(0, 5, (200, 3)).astype(np.float32)
    want, _ = model.predict(model.get_env().normalize_obs(inputs), deterministic=True)
    weights = load_snapshot(sorted(work.glob("0*.safetensors"))[-1])
    got = network_actions(weights, inputs)
    np.testing.assert_allclose(got, want, atol=2e-6)
    assert got.min() > -0.5 and got.max() < 2.0 and np.ptp(got) > 0.1
    assert load_network(str(trained / "line")).rungs[-1]["high"] == 2.0


def test_an_entry_acts_by_it(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(trained)
    wide()
    record = json.loads((trained / "line.json").read_text())
    assert record["settings"]["algorithm"] == "sac" and len(record["curve"]) == 13
    spec = DatasetSpec(
        name="mine", version="1.0.0-smoke", family="line", horizon=8, seed=3, block=2,
        license="CC0-1.0",
        behaviour=Behaviour(network="./line", rungs=3, noise=0.1), reference=2,
        episodes=EpisodeCounts(random=2, expert=2, history=2),
    )  # fmt: skip
    job = make_job(spec)
    names = {info.name for info in job.ladder.policies(spec.resolve_tasks())}
    assert names - {"uniform"} and all(name.startswith("sac-0.") for name in names - {"uniform"})
    data = collect(job, tmp_path / "mine.h5", workers=0).dataset
    found = {one.id: one.outcome.value for one in verify(data.path, replay="all").findings}
    assert found["replay"] == "PASS"


@pytest.mark.parametrize(
    ("said", "what"),
    [
        ({"algorithm": "sacc"}, "unknown algorithm 'sacc' .did you mean 'sac'.*expected ppo or"),
        ({"algorithm": 3}, "pretrain: unknown algorithm 3"),
        ({"algorithm": None}, "pretrain: unknown algorithm None"),
        ({"discount": 1.5}, "pretrain: discount is at most 1, found 1.5"),
        ({"algorithm": ["sac"]}, "pretrain: unknown algorithm"),
        ({"epochs": 3}, "pretrain: 'epochs' is a setting of ppo, not of sac"),
        ({"tauu": 3}, "pretrain: unknown key 'tauu' .did you mean 'tau'"),
        ({"tau": 1.5}, "pretrain: tau is at most 1, found 1.5"),
        ({"buffer": 0.5}, "pretrain: buffer is a whole number, found 0.5"),
        ({"entropy": -1.0}, "pretrain: entropy is 0, which is learnt, or above, found -1.0"),
        ({"algorithm": "ppo"}, "pretrain: 'gradient_steps' is a setting of sac, not of ppo"),
    ],
)
def test_settings_that_are_none(said: Any, what: str) -> None:
    with pytest.raises(SpecError, match=what):
        mpdt.register_family(line(pretrain=TINY | said))


def test_an_entry_says_another_algorithm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It then speaks alone; of the same one, it speaks over the module."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from own_families import line\n"
        "ppo = line(pretrain={'epochs': 3, 'rows': 7})\n"
        "sac = line(pretrain={'algorithm': 'sac', 'tau': 0.1, 'rows': 7})\n"
    )
    (tmp_path / "datasets.yaml").write_text(
        "schema: 1\nfamilies:\n"
        "  one: {module: 'mine:ppo', pretrain: {algorithm: sac, tau: 0.2}}\n"
        "  two: {module: 'mine:sac', pretrain: {tau: 0.3}}\n"
        "  three: {module: 'mine:ppo', pretrain: {tau: 0.3}}\n"
        "  four: {module: 'mine:ppo', pretrain: {algorithm: td3}}\n"
    )
    from mpdt.data.spec.tasks import get_family

    assert get_family("one").pretrain == {"algorithm": "sac", "tau": 0.2}
    assert get_family("two").pretrain == {"algorithm": "sac", "tau": 0.3, "rows": 7}
    with pytest.raises(SpecError, match="'tau' is a setting of sac, not of ppo"):
        get_family("three")
    with pytest.raises(SpecError, match=r"families.four: pretrain: unknown algorithm 'td3'"):
        get_family("four")
    # `pretrain` says the same, and not that there is no such family.
    with pytest.raises(SpecError, match=r"families.four: pretrain: unknown algorithm 'td3'"):
        pretrain("four")
    with pytest.raises(UsageError, match="unknown behaviour network 'five'"):
        pretrain("five")


def test_what_cannot_be_gone_on_from(tmp_path: Path) -> None:
    from safetensors import safe_open
    from safetensors.numpy import save_file

    family = wide()
    with pytest.raises(UsageError, match="too few steps for one update; expected at least 33"):
        pretrain("line", output=tmp_path, steps=32)
    pretrain("line", output=tmp_path, steps=40)
    path = tmp_path / "line.pretrain/checkpoint.safetensors"
    with safe_open(path, framework="np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        header = file.metadata()
    assert {"entropy", "replay/rewards", "optimizer/entropy/0/exp_avg"} <= arrays.keys()
    seen = arrays["replay/observations"]
    for changed, match in (
        ({"replay/place": np.array([81, 0])}, "no place in the replay buffer; found .81, 0"),
        ({"replay/place": np.array([4, 0])}, "other tensors than this network has: replay/act"),
        ({"replay/observations": seen[..., :1].copy()}, "other tensors .* replay/obs"),
        ({"replay/observations": seen * np.nan}, "not finite"),
    ):
        save_file(arrays | changed, path, header)
        with pytest.raises(FormatError, match=match) as caught:
            pretrain("line", output=tmp_path)
        assert "--no-resume" in caught.value.hint
    save_file(arrays, path, header)
    changed_settings = {**TINY, "tau": 0.1}
    mpdt.register_family(line(action_low=-0.5, action_high=2.0, env=_wide,
                              pretrain=changed_settings))  # fmt: skip
    with pytest.raises(FormatError, match="checkpoint of another run; expected settings"):
        pretrain("line", output=tmp_path)
    assert family.pretrain == TINY


def test_numbers_that_run_away_are_one_error(tmp_path: Path) -> None:
    mpdt.register_family(line(pretrain={**TINY, "learning_rate": 1e30}))
    with pytest.raises(SimulatorError, match="training ran away") as caught:
        pretrain("line", output=tmp_path)
    assert "learning_rate" in caught.value.hint


@pytest.mark.slow
def test_it_learns_and_survives_kill_nine(tmp_path: Path) -> None:
    """A family of examples/, killed four times on the way, beside one that was not."""
    examples = Path(__file__).parents[3] / "examples/families"
    text = (
        "schema: 1\ndatasets: {}\nfamilies:\n  point_robot:\n"
        "    module: mpdt_families.point_robot:point_robot\n"
        "    pretrain: {algorithm: sac, steps: 40000, rows: 25, discount: 0.9, snapshots: 20,\n"
        "      judge_noise: 0.02, judge_episodes: 1}\n"
    )
    paths = os.pathsep.join([str(examples), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "mpdt.data.cli", "pretrain", "point_robot"]
    runs = {name: tmp_path / name for name in ("whole", "killed")}
    for name, folder in runs.items():
        folder.mkdir()
        (folder / "datasets.yaml").write_text(text)
        for count in (2, 7, 8, 15) if name == "killed" else ():
            child = subprocess.Popen(command, cwd=folder, env={**os.environ, "PYTHONPATH": paths})
            while len(list(folder.glob("*.pretrain/0*.safetensors"))) < count:
                assert child.poll() is None
                time.sleep(0.02)
            child.send_signal(signal.SIGKILL)
            child.wait()
        subprocess.run(command, cwd=folder, env={**os.environ, "PYTHONPATH": paths}, check=True)
    whole, killed = (files_of(folder, "point_robot") for folder in runs.values())
    assert killed == whole
    returns = json.loads(whole["record"])["rungs"][-1]["returns"].values()
    assert np.mean(list(returns)) > -6.0  # -3.4 here; uniform actions -14.3, the script -2.2
