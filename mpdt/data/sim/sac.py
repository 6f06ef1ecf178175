"""SAC of stable-baselines3 on a family, so that a run that was killed ends as one that was not.

    snapshot   weights of the actor; every few steps
    seam       a checkpoint, after which every row begins a new episode and all random numbers a new
               stream, named by (seed, step): in every run, killed or not

Between two seams nothing is read that the checkpoint before them does not hold: the state of a
simulator, which nobody can store for any environment, never crosses one. What is made again after a
kill has the same bytes. SAC learns from single transitions: an episode that is cut loses nothing.

Used by pretrain.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecNormalize

from mpdt.data.sim.checkpoint import NAME, Point, load_checkpoint, restore
from mpdt.data.sim.snapshots import Snapshots, drop_later, learning
from mpdt.data.sim.vecenv import FamilyVecEnv
from mpdt.data.spec.family import Family
from mpdt.data.spec.training import SacSettings
from mpdt.pace import Pace
from mpdt.seeding import Quality, SeedKey, Stream

SEAM_HORIZONS = 4
"""Least length of every row between two seams: most of what is seen is of whole episodes."""


def train_sac(
    family: Family,
    settings: SacSettings,
    total: int,
    seed: int,
    work: Path,
    run: dict[str, Any],
    say: Callable[[str], None],
) -> list[Point]:
    """Train up to `total` environment steps, from the checkpoint in `work` where one is.

    Returns the learning curve; snapshots lie in `work`. Raises: FormatError for a checkpoint of
    another run; SimulatorError; StorageError.
    """
    kept = load_checkpoint(work, run)
    curve = list(kept[0].curve) if kept else []
    model = _model(family, settings, seed)
    if kept:
        restore(model, *kept, work / NAME)
        say(f"resuming at step {model.num_timesteps}")
        drop_later(work, int(model.num_timesteps))
    every = max(1, total // settings.snapshots)
    snapshots = _Quiet(work, run, curve, total, every, say, settings.early)
    snapshots.model = model
    if not kept:
        snapshots.take(0)
    seam, step = int(model.num_timesteps), int(model.num_timesteps)
    while step < total:
        if step == seam:
            _begin(model, family, seed, step)
        with learning(family):
            model.learn(min(snapshots.next, total) - step, callback=snapshots,
                        reset_num_timesteps=False)  # fmt: skip
        step = int(model.num_timesteps)
        if step >= total or step - seam >= SEAM_HORIZONS * family.horizon * settings.rows:
            seam = step
        snapshots.take(step, checkpoint=step == seam)
    return snapshots.curve


def _model(family: Family, settings: SacSettings, seed: int) -> SAC:
    rows = FamilyVecEnv(family, settings.rows, seed, settings.threads)
    env = VecNormalize(rows, norm_obs=True, norm_reward=True, gamma=settings.discount)
    model = SAC("MlpPolicy", env, seed=seed, device="cpu", **_words(settings))
    # As `learn` makes them at first; there is a checkpoint before.
    model.ep_info_buffer = deque(maxlen=settings.rows)
    model.ep_success_buffer = deque(maxlen=settings.rows)
    return model


def _words(settings: SacSettings) -> dict[str, Any]:
    """The settings in stable-baselines3's words."""
    return {
        "learning_rate": settings.learning_rate,
        "buffer_size": settings.buffer,
        "learning_starts": settings.warmup,
        "batch_size": settings.minibatch,
        "tau": settings.tau,
        "gamma": settings.discount,
        "train_freq": settings.steps_per_update,
        "gradient_steps": settings.gradient_steps,
        "ent_coef": settings.entropy or "auto",
        "policy_kwargs": {"net_arch": [settings.hidden, settings.hidden]},
        "stats_window_size": settings.rows,
    }


def _begin(model: SAC, family: Family, seed: int, step: int) -> None:
    """What follows depends on the checkpoint of this step and on (seed, step) alone."""
    key = SeedKey(seed, family.id, 0, Quality.PRETRAINING, step, 0)
    model.set_random_seed(key.env_seed(Stream.POLICY) % 2**32)
    model._last_obs = None  # `learn` then resets every row


class _Quiet(Snapshots):
    """Tells of itself at intervals, for SAC learns at every step; takes no snapshot by itself."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._pace = Pace()

    def _on_rollout_start(self) -> None:
        if self._pace.is_time():
            self.tell(int(self.num_timesteps))
