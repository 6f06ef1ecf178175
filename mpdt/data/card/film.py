"""Film: stored episodes simulated again in front of an off-screen camera.

Frames are not stored; the episode is stepped again from its seed key, goal and stored actions, and
compared with the stored observations on the way.

    films = shoot(dataset.path, ids, num_frames=6)

OpenGL is chosen when mujoco is imported, broken drivers end the process, and a second OSMesa
context in a process draws garbage. So a child process films, one per way of drawing that is tried:
what MUJOCO_GL says, else EGL (Mesa draws without a GPU too), then OSMesa.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.sim.batch import HasScene
from mpdt.data.sim.camera import NO_SCREEN, Camera, Pixels
from mpdt.data.sim.simulators import make_batch
from mpdt.data.sim.stored import watch_stored
from mpdt.data.spec.family import Family, view_of
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError, MpdtError, SimulatorError
from mpdt.seeding import UNKNOWN_SEED_KEY, SeedKey

WIDTH, HEIGHT = 240, 180
FLOORS = 10


@dataclass(frozen=True, eq=False)
class Film:
    """Frames of one episode.

    Args:
        frames: (F, HEIGHT, WIDTH, 3).
        steps: how many steps were done before each frame, ascending; the last is the end.
        is_equal: the simulator gave the stored observations, byte for byte.
    """

    episode: int
    frames: Pixels
    steps: tuple[int, ...]
    is_equal: bool


def shoot(file: Dataset | Path, ids: Sequence[int], num_frames: int | None = 6) -> list[Film]:
    """Film episodes of a file, open or not.

    Args:
        num_frames: spread evenly from the first observation to the last; None = every step.
    Raises: DataError for episodes without a seed; UsageError for a family that cannot be
        simulated; SimulatorError if nothing here can draw, with what to install.
    """
    data, refused = file if isinstance(file, Dataset) else open_dataset(file), []
    family = data.contract()  # the child may not know it yet
    view_of(family)  # before a process is started for it
    for way in ways_to_draw():
        try:
            with ProcessPoolExecutor(
                1, mp_context=get_context("spawn"), initializer=_use, initargs=(way,)
            ) as pool:
                return pool.submit(film_here, family, data, list(ids), num_frames).result()
        except MpdtError:
            raise
        except BrokenProcessPool:
            refused.append(f"{way}: the process ended")
        except Exception as error:  # noqa: BLE001  drivers raise whatever they like
            refused.append(f"{way}: {type(error).__name__}: {error}".splitlines()[0][:120])
    raise SimulatorError(
        "nothing here can draw a picture", found="; ".join(refused), hint=NO_SCREEN
    )


def ways_to_draw() -> tuple[str, ...]:
    """Values of MUJOCO_GL to try."""
    if given := os.environ.get("MUJOCO_GL"):
        return (given,)
    return ("egl", "osmesa") if sys.platform == "linux" else ("glfw",)


def _use(way: str) -> None:
    """In the child, before anything imports mujoco."""
    os.environ["MUJOCO_GL"] = way


def film_here(
    family: Family, data: Dataset, ids: Sequence[int], num_frames: int | None
) -> list[Film]:
    """Film with the OpenGL of this very process."""
    return [_film(family, data, episode_id, num_frames) for episode_id in ids]


def _film(family: Family, data: Dataset, episode_id: int, num_frames: int | None) -> Film:
    episode, view = data.episode(episode_id), view_of(family)
    length = episode.length
    places = np.linspace(0, length, num_frames or length + 1).round().astype(int)
    wanted = sorted(set(places.tolist()))
    frames, is_equal = [], True
    env = make_batch(family, [family.tasks[episode.task]], dict(data.spec.get("env") or {}))
    if not isinstance(env, HasScene):
        raise SimulatorError("no picture: this family's simulator shows none", where=family.name)
    model, _ = env.scene(0)
    if view.floor:
        floor = model.geom(view.floor)  # only its picture has an end, which experts run past
        floor.size[:2] *= FLOORS
        model.mat_texrepeat[floor.matid] *= FLOORS
    with closing(Camera(model, view, HEIGHT, WIDTH)) as camera:
        for step, seen in enumerate(watch_stored(env, episode, _key(data, family, episode))):
            shown = seen.astype(np.float32)
            shown[list(family.hidden_columns)] = 0.0
            is_equal &= shown.tobytes() == episode.observations[step].tobytes()
            if step in wanted:
                frames.append(camera.frame(env.scene(0)[1]))
    return Film(episode_id, np.stack(frames), tuple(wanted), is_equal)


def _key(data: Dataset, family: Family, episode: Episode) -> SeedKey:
    """What the episode's reset noise was drawn from. Raises: DataError where nobody knows."""
    seed = data.spec.get("seed")
    if isinstance(seed, int) and episode.seed_key != UNKNOWN_SEED_KEY:
        return SeedKey(seed, *episode.seed_key)
    if family.draws_goals:  # the goal alone decides how it begins
        return SeedKey(0, *UNKNOWN_SEED_KEY)
    raise DataError("an episode without a seed cannot be simulated again", where=str(data.path))
