"""Episodes and files made by hand, for every test that needs some: no simulator, no randomness.

A test says what matters to it and gets the rest: numbers that count up, so that a step found in a
wrong place shows where it came from.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mpdt.data.episode import Episode, PolicyInfo
from mpdt.data.store.sources import EpisodeSource, FileHeader, TtaSource
from mpdt.data.store.tables import TaskRow

if TYPE_CHECKING:
    from mpdt.train.fit.trained import Trained
    from mpdt.train.run.prepare import Prepared

UNIFORM, FINAL = bytes(range(32)), bytes([7] * 32)
"""Hashes of two policies: the first rung of a ladder and the last."""


def make_episode(
    length: int = 3,
    first: float = 0.0,
    sizes: tuple[int, int] = (2, 1),
    *,
    task: int = 0,
    quality: int = 0,
    block: int = 0,
    row: int = 0,
    success: bool | None = None,
    **columns: Any,
) -> Episode:
    """Observations first, first + 1, ...; actions the same with a minus; rewards 1, 2, ...

    Args:
        sizes: of an observation and of an action.
        success: at the last step; None = a family without success.
        columns: fields of Episode as they are to be, whatever was said above.
    """
    D, A = sizes
    ends = np.arange(length) == length - 1
    counted = {
        "observations": first + np.arange(D * (length + 1), dtype=np.float32).reshape(-1, D),
        "actions": -first - np.arange(A * length, dtype=np.float32).reshape(-1, A),
        "rewards": np.arange(1, length + 1, dtype=np.float32),
        "terminations": np.zeros(length, bool),
        "truncations": ends,
        "successes": None if success is None else ends & success,
        "task": task,
        "goal": np.array([1.0 if task == 0 else -1.0]),
        "quality": quality,
        "progress": 0.0,
        "policy": UNIFORM,
        "seed_key": (0, task, quality, block, row),
    }
    return Episode(**(counted | columns))


def make_header(
    episodes: Sequence[Episode], tasks: Sequence[TaskRow] | None = None, **fields: Any
) -> FileHeader:
    """A header that fits the episodes: their sizes, their tasks (role both), their policies.

    Args:
        fields: of FileHeader, as they are to be.
    """
    one, acted = episodes[0], dict.fromkeys((e.policy, e.task, e.progress) for e in episodes)
    known = {
        "family": "cheetah_dir", "name": "hand-made", "version": "1.0.0", "license": "CC0-1.0",
        "spec": {"name": "hand-made"}, "has_success": one.successes is not None,
        "observation_size": one.observations.shape[1], "action_size": one.actions.shape[1],
        "tasks": tuple(tasks or (TaskRow(f"t{i}", i, "both", {})
                                 for i in sorted({e.task for e in episodes}))),
        "policies": tuple(PolicyInfo(policy, task, 0, progress, -1, 0.0, "made by hand")
                          for policy, task, progress in acted),
    }  # fmt: skip
    return FileHeader(**(known | fields))


def source_of(episodes: Sequence[Episode]) -> EpisodeSource:
    return EpisodeSource(episodes, len(episodes), sum(e.length for e in episodes))


def tta_source_of(
    episodes: Sequence[Episode], presets: dict[int, float], rule: dict[str, Any]
) -> TtaSource:
    return TtaSource(episodes, len(episodes), sum(e.length for e in episodes), presets, rule)


def make_trained(data: Path, method: str = "MPDT", *words: str) -> tuple[Prepared, Trained]:
    """A policy of that method which was never trained, over the tasks of `data`."""
    import tyro

    from mpdt.model.backbone import from_settings
    from mpdt.train.run.build import build
    from mpdt.train.run.config import TrainConfig
    from mpdt.train.run.methods import apply_method
    from mpdt.train.run.prepare import prepare
    from mpdt.train.run.presets import get_preset

    preset = apply_method(get_preset("smoke"), method)
    prepared = prepare(tyro.cli(TrainConfig, default=preset, args=list(words)), str(data))
    return prepared, build(prepared, from_settings(prepared.config.backbone)).trained({})


def make_bundle(target: Path, prepared: Prepared, trained: Trained) -> Path:
    """Its bundle."""
    from mpdt.train.bundle.card import card_of
    from mpdt.train.bundle.contents import contents_of, own_prompts
    from mpdt.train.bundle.write import write_bundle
    from mpdt.train.run.config import to_plain

    contents = contents_of(
        trained, [own_prompts(trained)], to_plain(prepared.config), "made",
        prepared.identity.hashes,
    )  # fmt: skip
    write_bundle(target, contents, card_of(contents.config, []))
    return target
