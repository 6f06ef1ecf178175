"""Train the behaviour network of a family and export its rungs.

    PPO or SAC (stable-baselines3) on the family's simulator, one network per family, which sees
    the goal
      -> snapshots on the way, each judged on every task
      -> rungs: spread evenly over the normalised return, a medium one for every task
      -> <name>.safetensors and <name>.json, which `NetworkLadder` reads

Retraining on another machine gives other weights. That is why the rungs are shipped as data
and byte identity of a dataset is promised from the weights on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
from safetensors.numpy import save

from mpdt.data.sim.checkpoint import NAME as CHECKPOINT
from mpdt.data.sim.checkpoint import PICKLES, Point, load_checkpoint, restore
from mpdt.data.sim.network import network_scene
from mpdt.data.sim.network_file import load_snapshot
from mpdt.data.sim.rungs import JUDGED, describe_rungs
from mpdt.data.spec.family import Family
from mpdt.data.spec.own import find_own
from mpdt.data.spec.tasks import FAMILIES, SHIPPED
from mpdt.data.spec.training import PretrainSettings, SacSettings, Settings, described, own_settings
from mpdt.disk import check_replaceable, disk, holding, write_bytes
from mpdt.errors import SimulatorError, UsageError, unknown_name

SETTINGS: dict[str, PretrainSettings] = {
    "cheetah_dir": PretrainSettings(steps=12_000_000),
    "cheetah_vel": PretrainSettings(steps=16_000_000, judge_episodes=4, judge_noise=0.05),
    # The reward charges half the squared action, so wide exploration costs more than walking gains.
    "ant_dir": PretrainSettings(
        steps=6_000_000, log_std_init=-1.0, judge_episodes=2, judge_noise=0.05
    ),
}


def pretrain(
    name: str,
    *,
    seed: int = 0,
    steps: int | None = None,
    output: Path | None = None,
    resume: bool = True,
    on_progress: Callable[[str], None] | None = None,
) -> Path:
    """Train the network of a family, named as it, and write its rungs.

    Args:
        seed: seeds the initial weights, minibatches and episodes.
        steps: environment steps; the family's setting by default.
        output: folder for `<name>.safetensors`, `<name>.json` and, until the run is done,
            `<name>.pretrain/` with snapshots and the checkpoint to resume from.
        resume: go on from that checkpoint. False starts over. A run of SAC that was stopped ends
            with the bytes of one that was not; PPO goes on with other episodes.
        on_progress: called with one line per update.

    Returns the path of the weights. Raises UsageError for a family without a network,
    SimulatorError if the `behaviour` extra is not installed, the simulator breaks its contract,
    nothing was learnt, or the numbers ran away; StorageError if the folder cannot be made or
    written to.
    """
    family, settings = _trainable(name)
    total = settings.steps if steps is None else steps
    least = settings.rows * settings.steps_per_update
    if isinstance(settings, SacSettings):
        least += settings.warmup
    if total < least:
        raise UsageError("too few steps for one update", expected=f"at least {least}",
                         found=str(total))  # fmt: skip
    folder = (output or Path.cwd()).resolve()
    work = folder / f"{name}.pretrain"
    target, record_path = folder / f"{name}.safetensors", folder / f"{name}.json"
    with disk(work):
        work.mkdir(parents=True, exist_ok=True)
    with holding(work, amends=True, wait_s=0, kept="snapshots are kept"):
        for path in (target, record_path, work / CHECKPOINT):
            check_replaceable(path)
        begun = any((work / name).exists() for name in (CHECKPOINT, *PICKLES))
        if not resume or not begun:  # a clearing that was ended halfway goes on
            _clear(work)
        return _pretrain(family, settings, total, seed, work, on_progress or (lambda line: None))


def _trainable(name: str) -> tuple[Family, Settings]:
    """Raises: UsageError for a family without a network; SpecError for one that is unusable."""
    if name in SETTINGS:
        return FAMILIES[name], SETTINGS[name]
    if name not in SHIPPED and (family := _own(name)) is not None:
        return family, own_settings(family.pretrain)
    own = [one for one in FAMILIES if one not in SHIPPED]
    raise unknown_name("behaviour network", name, [*SETTINGS, *own])


def _own(name: str) -> Family | None:
    family = FAMILIES.get(name) or find_own(name)
    if family is not None and family.draws_goals:
        raise UsageError("no network: its goals are drawn per episode", where=name,
                         hint="give it a script")  # fmt: skip
    return family


def _clear(work: Path) -> None:
    """Delete what earlier sessions left, and nothing else; the checkpoint first, without which
    nobody goes on from the rest. Raises: StorageError.
    """
    with disk(work):
        for name in (CHECKPOINT, *PICKLES, JUDGED, "curve.json"):
            (work / name).unlink(missing_ok=True)
        for path in work.glob("[0-9]*.safetensors"):
            path.unlink()


def _pretrain(
    family: Family,
    settings: Settings,
    total: int,
    seed: int,
    work: Path,
    say: Callable[[str], None],
) -> Path:
    name, folder = family.name, work.parent
    target, record_path = folder / f"{name}.safetensors", folder / f"{name}.json"
    curve = _train(family, settings, total, seed, work, say)
    say("judging the snapshots on every task")
    ladder = describe_rungs(
        family,
        work,
        num_rungs=settings.num_rungs,
        episodes=settings.judge_episodes,
        noise=settings.judge_noise,
        seed=seed,
        threads=settings.threads,
        say=say,
    )
    robot, _, reward = network_scene(family).partition("/")
    packages = ("mpdt", "mujoco", "numpy", "stable-baselines3", "torch", *family.packages)
    record = {
        "network": name,
        "robot": robot,
        "reward": reward,
        "seed": seed,
        "steps": total,
        "wall_s": curve[-1].wall_s,  # of training, without judging
        "settings": described(settings),
        "packages": {package: metadata.version(package) for package in dict.fromkeys(packages)},
        **ladder,
        "curve": [msgspec.to_builtins(point) for point in curve],
    }
    rungs = [
        load_snapshot(work / f"{rung['train_step']:012d}.safetensors") for rung in ladder["rungs"]
    ]
    arrays = {
        f"rung-{i:02d}/{key}": value for i, rung in enumerate(rungs) for key, value in rung.items()
    }
    content = save(arrays)
    record["weights_sha256"] = hashlib.sha256(content).hexdigest()
    write_bytes(target, content)
    write_bytes(record_path, (json.dumps(record, indent=1, sort_keys=True) + "\n").encode())
    return target


def _train(
    family: Family,
    settings: Settings,
    total: int,
    seed: int,
    work: Path,
    say: Callable[[str], None],
) -> list[Point]:
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecNormalize

        from mpdt.data.sim.sac import train_sac
        from mpdt.data.sim.snapshots import Snapshots, drop_later, learning
        from mpdt.data.sim.vecenv import FamilyVecEnv
    except ImportError as error:
        raise SimulatorError(
            "training a behaviour network needs stable-baselines3",
            hint="pip install 'mpdt[behaviour]'",
        ) from error

    torch.set_num_threads(1)  # small matrix products get slower on more threads
    run = {"network": family.name, "seed": seed, "settings": described(settings)}
    if family.module:
        run["scene"] = network_scene(family)
    if isinstance(settings, SacSettings):
        return train_sac(family, settings, total, seed, work, run, say)
    kept = load_checkpoint(work, run)
    curve = list(kept[0].curve) if kept else []
    # Other episodes than before a stop: the resumed run is a valid, not an equal one.
    rows = FamilyVecEnv(family, settings.rows, seed + len(curve), settings.threads)
    env = VecNormalize(rows, norm_obs=True, norm_reward=True, gamma=settings.discount)
    model = PPO("MlpPolicy", env, seed=seed, device="cpu", **_ppo(settings))
    if kept:
        restore(model, *kept, work / CHECKPOINT)
        say(f"resuming at step {model.num_timesteps}")
        drop_later(work, int(model.num_timesteps))
    snapshots = Snapshots(work, run, curve, total, max(1, total // settings.snapshots), say,
                          settings.early)  # fmt: skip
    remaining = total - int(model.num_timesteps)
    if remaining > 0:
        with learning(family):
            model.learn(remaining, callback=snapshots, reset_num_timesteps=False)
        snapshots.take(int(model.num_timesteps))
    return snapshots.curve


def _ppo(settings: PretrainSettings) -> dict[str, Any]:
    """The settings in stable-baselines3's words."""
    return {
        "learning_rate": lambda remaining: settings.learning_rate * max(remaining, 0.05),
        "n_steps": settings.steps_per_update,
        "batch_size": settings.minibatch,
        "n_epochs": settings.epochs,
        "gamma": settings.discount,
        "gae_lambda": settings.gae_lambda,
        "ent_coef": settings.entropy,
        "target_kl": settings.max_kl,
        "policy_kwargs": {
            "net_arch": [settings.hidden, settings.hidden],
            "log_std_init": settings.log_std_init,
        },
        "stats_window_size": settings.rows,
    }
