"""Train the behaviour network of a locomotion family and export its rungs.

    PPO (stable-baselines3) on the batched engine, one goal-conditioned network per family
      -> snapshots on the way, each judged on every task
      -> rungs: spread evenly over the normalised return, a medium one for every task
      -> <name>.safetensors and <name>.json, which `NetworkLadder` reads

Retraining on another machine gives other weights. That is why the rungs are shipped as data
and byte identity of a dataset is promised from the weights on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from mpdt.data.sim.network import network_actions
from mpdt.data.spec.tasks import Family, get_family
from mpdt.errors import SimulatorError, UsageError, unknown_name
from mpdt.seeding import Quality, SeedKey, Stream

Weights = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class PretrainSettings:
    """PPO settings of one family. Lengths in environment steps unless named otherwise."""

    steps: int
    rows: int = 256
    steps_per_update: int = 50
    minibatch: int = 3200
    epochs: int = 6
    learning_rate: float = 5e-4
    hidden: int = 128
    discount: float = 0.99
    gae_lambda: float = 0.95
    entropy: float = 0.0
    log_std_init: float = -0.5
    max_kl: float = 0.02
    snapshots: int = 100
    threads: int = 2
    num_rungs: int = 20
    judge_episodes: int = 16
    judge_noise: float = 0.1


SETTINGS: dict[str, PretrainSettings] = {
    "cheetah_dir": PretrainSettings(steps=12_000_000),
    "cheetah_vel": PretrainSettings(steps=16_000_000),
    "ant_dir": PretrainSettings(steps=16_000_000),
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
    """Train network `name` (a locomotion family) and write its rungs.

    Args:
        seed: seeds the initial weights, minibatches and episodes.
        steps: environment steps; the family's setting by default.
        output: folder for `<name>.safetensors`, `<name>.json` and, until the run is done,
            `<name>.pretrain/` with snapshots and the checkpoint to resume from.
        resume: go on from that checkpoint. False starts over.
        on_progress: called with one line per update.

    Returns the path of the weights. Raises UsageError for a family without a network,
    SimulatorError if the `behaviour` extra is not installed.
    """
    if name not in SETTINGS:
        raise unknown_name("behaviour network", name, SETTINGS)
    settings = SETTINGS[name]
    total = settings.steps if steps is None else steps
    if total < settings.rows * settings.steps_per_update:
        raise UsageError(
            "too few steps for one update",
            expected=f"at least {settings.rows * settings.steps_per_update}",
            found=str(total),
        )
    family = get_family(name)
    folder = (output or Path.cwd()).resolve()
    work = folder / f"{name}.pretrain"
    if not resume and work.is_dir():
        for path in work.iterdir():
            path.unlink()
    work.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    say = on_progress or (lambda line: None)
    curve = _train(family, settings, total, seed, work, say)
    say("judging the snapshots on every task")
    ladder = _judge_all(family, settings, work, seed)
    record = {
        "network": name,
        "robot": family.robot,
        "reward": family.reward,
        "seed": seed,
        "steps": total,
        "wall_s": round(time.monotonic() - started, 1),
        "settings": asdict(settings),
        "packages": {
            package: metadata.version(package)
            for package in ("mpdt", "mujoco", "numpy", "stable-baselines3", "torch")
        },
        **ladder,
        "curve": curve,
    }
    target = folder / f"{name}.safetensors"
    rungs = [load_file(work / f"{rung['train_step']:012d}.safetensors") for rung in ladder["rungs"]]
    save_file(
        {
            f"rung-{i:02d}/{key}": value
            for i, rung in enumerate(rungs)
            for key, value in rung.items()
        },
        target,
    )
    (folder / f"{name}.json").write_text(json.dumps(record, indent=1, sort_keys=True) + "\n")
    return target


def _train(
    family: Family,
    settings: PretrainSettings,
    total: int,
    seed: int,
    work: Path,
    say: Callable[[str], None],
) -> list[dict[str, float]]:
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.callbacks import BaseCallback
        from stable_baselines3.common.vec_env import VecNormalize
    except ImportError as error:
        raise SimulatorError(
            "training a behaviour network needs stable-baselines3",
            hint="pip install 'mpdt[behaviour]'",
        ) from error
    from mpdt.data.sim.vecenv import LocomotionVecEnv

    torch.set_num_threads(1)  # small matrix products collapse on more, most of all when busy
    every = max(1, total // settings.snapshots)
    curve_path = work / "curve.json"

    class Snapshots(BaseCallback):  # type: ignore[misc]  # untyped base
        def __init__(self, curve: list[dict[str, float]]) -> None:
            super().__init__()
            self.curve = curve
            self.next_snapshot = (curve[-1]["step"] + every) if curve else 0
            self.since = time.monotonic()

        def _on_rollout_start(self) -> None:
            step = int(self.num_timesteps)
            returns = [info["r"] for info in self.model.ep_info_buffer]
            mean = float(np.mean(returns)) if returns else float("nan")
            rate = step / max(1e-9, time.monotonic() - self.since)
            say(f"step {step}/{total}  mean return {mean:.1f}  {rate:.0f} steps/s")
            if step >= self.next_snapshot:
                self.snapshot(step, mean)

        def snapshot(self, step: int, mean: float) -> None:
            save_file(_export(self.model), work / f"{step:012d}.safetensors")
            self.curve.append({"step": step, "mean_return": round(mean, 2)})
            curve_path.write_text(json.dumps(self.curve).replace("NaN", "null"))
            self.model.save(work / "checkpoint.zip")
            self.model.get_env().save(str(work / "normalize.pkl"))
            self.next_snapshot = step + every

        def _on_step(self) -> bool:
            return True

    checkpoint = work / "checkpoint.zip"
    curve: list[dict[str, float]] = []
    if checkpoint.is_file() and curve_path.is_file():
        curve = json.loads(curve_path.read_text())
        # Other episodes than before the stop: the resumed run is a valid, not an equal one.
        rows = LocomotionVecEnv(family, settings.rows, seed + len(curve), settings.threads)
        env = VecNormalize.load(str(work / "normalize.pkl"), rows)
        model = PPO.load(checkpoint, env=env, device="cpu")
        say(f"resuming at step {model.num_timesteps}")
    else:
        rows = LocomotionVecEnv(family, settings.rows, seed, settings.threads)
        env = VecNormalize(rows, norm_obs=True, norm_reward=True, gamma=settings.discount)
        model = PPO(
            "MlpPolicy",
            env,
            learning_rate=lambda remaining: settings.learning_rate * max(remaining, 0.05),
            n_steps=settings.steps_per_update,
            batch_size=settings.minibatch,
            n_epochs=settings.epochs,
            gamma=settings.discount,
            gae_lambda=settings.gae_lambda,
            ent_coef=settings.entropy,
            target_kl=settings.max_kl,
            policy_kwargs={
                "net_arch": [settings.hidden, settings.hidden],
                "log_std_init": settings.log_std_init,
            },
            stats_window_size=settings.rows,
            seed=seed,
            device="cpu",
        )
    callback = Snapshots(curve)
    remaining = total - int(model.num_timesteps)
    if remaining > 0:
        model.learn(remaining, callback=callback, reset_num_timesteps=False)
        returns = [info["r"] for info in model.ep_info_buffer]
        callback.snapshot(int(model.num_timesteps), float(np.mean(returns)))
    return callback.curve


def _export(model: Any) -> Weights:
    """The actor as plain arrays: inputs @ w + b, normalised by mean and std first."""
    state = {key: value.detach().numpy() for key, value in model.policy.state_dict().items()}
    stats = model.get_env().obs_rms
    layers = ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net")
    weights = {"mean": stats.mean, "std": np.sqrt(stats.var + 1e-8)}
    for i, layer in enumerate(layers):
        weights[f"w{i}"] = state[f"{layer}.weight"].T
        weights[f"b{i}"] = state[f"{layer}.bias"]
    return {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in weights.items()}


def judge(
    family: Family, weights: Weights | None, episodes: int, noise: float, seed: int, threads: int
) -> NDArray[np.float64]:
    """Mean return per task of a network, or of uniform actions where `weights` is None.

    Plays `episodes` episodes of every task side by side, with Gaussian action noise.
    Returns (num_tasks,) in the task's own reward.
    """
    from mpdt.data.sim.locomotion import LocomotionBatch
    from mpdt.data.sim.robots import network_inputs

    tasks = [task for task in family.tasks for _ in range(episodes)]
    keys = [
        SeedKey(seed, family.id, task.index, Quality.PRETRAINING, 0, row)
        for row, task in enumerate(tasks)
    ]
    env = LocomotionBatch(family, tasks, threads=threads)
    goals = env.draw_goals(keys)
    flat = np.array([goal[0] for goal in goals])
    observations = env.reset(keys, goals)
    generator = keys[0].generator(Stream.POLICY)
    total, alive = np.zeros(len(tasks)), np.ones(len(tasks), dtype=bool)
    for _ in range(family.horizon):
        shape = (len(tasks), family.action_size)
        if weights is None:
            actions = generator.uniform(family.action_low, family.action_high, shape)
        else:
            inputs = network_inputs(family.robot, family.reward, observations, flat)
            actions = network_actions(weights, inputs) + noise * generator.standard_normal(shape)
        actions = np.clip(actions, family.action_low, family.action_high)
        result = env.step(actions.astype(np.float32))
        observations = result.observations
        total += np.where(alive, result.rewards, 0.0)
        alive &= ~result.terminations
    return np.asarray(total.reshape(len(family.tasks), episodes).mean(axis=1))


def _judge_all(family: Family, settings: PretrainSettings, work: Path, seed: int) -> dict[str, Any]:
    """Measure every snapshot, choose the rungs, and describe them for the record."""
    paths = sorted(work.glob("[0-9]*.safetensors"))
    args = (settings.judge_episodes, settings.judge_noise, seed, settings.threads)
    random = judge(family, None, *args)
    returns = np.stack([judge(family, load_file(path), *args) for path in paths])
    best = 1 + int(returns[1:].mean(axis=1).argmax())  # the untrained one is never final
    returns, paths = returns[: best + 1], paths[: best + 1]
    levels = (returns - random) / (returns[-1] - random)
    chosen = choose_rungs(levels, settings.num_rungs)
    names = [task.name for task in family.tasks]

    def per_task(values: NDArray[np.float64]) -> dict[str, float]:
        return {name: round(float(value), 4) for name, value in zip(names, values, strict=True)}

    return {
        "random": per_task(random),
        "rungs": [
            {
                "train_step": int(paths[i].stem),
                "returns": per_task(returns[i]),
                "levels": per_task(levels[i]),
            }
            for i in chosen
        ],
    }


def choose_rungs(levels: NDArray[np.float64], num_rungs: int) -> list[int]:
    """Snapshots that become rungs, ascending.

    levels (S, K): normalised return of S snapshots on K tasks; the last one is final, so its
    level is 1. Always contains the first, the last and, for as few snapshots as possible, one
    within [0.4, 0.6] for every task (the nearest to 0.5 where none is); the rest is spread
    evenly over the mean level.
    """
    num_snapshots = len(levels)
    if num_snapshots <= num_rungs:
        return list(range(num_snapshots))
    distance = np.abs(levels - 0.5)
    good = distance <= np.maximum(0.1, distance.min(axis=0))
    chosen = {0, num_snapshots - 1}
    missing = ~good[sorted(chosen)].any(axis=0)
    while missing.any():
        pick = int(good[:, missing].sum(axis=1).argmax())
        chosen.add(pick)
        missing &= ~good[pick]
    mean = levels.mean(axis=1)
    targets = np.linspace(mean[0], 1.0, num_rungs)
    while len(chosen) < num_rungs:
        taken = mean[sorted(chosen)]
        # The target worst served by what is chosen gets the nearest snapshot still free.
        worst = targets[np.abs(targets[:, None] - taken).min(axis=1).argmax()]
        free = [i for i in range(num_snapshots) if i not in chosen]
        chosen.add(min(free, key=lambda i: abs(mean[i] - worst)))
    return sorted(chosen)
