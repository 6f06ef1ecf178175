"""One filmed episode as a PNG or an MP4. Needs the extra `pages`."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from mpdt.data.card.film import Film
from mpdt.data.store.dataset import Dataset
from mpdt.disk import disk, replacing
from mpdt.errors import UsageError

PNG, MP4 = b"\x89PNG", b"ftyp"
"""What the first bytes of such a file hold."""
MOST_FPS = 40  # a clip of a faster simulator leaves steps out


def expect_package(name: str) -> None:
    """Raises: UsageError with the extra that brings it, if `name` is not installed."""
    if find_spec(name) is None:
        raise UsageError(
            f"{name} is not installed", hint="python -m pip install 'mpdt[pages]'"
        )  # fmt: skip


def forget_screen() -> None:
    """Drop a backend that a notebook set for its own environment: matplotlib would not import.

    Nothing here is shown on a screen.
    """
    home = os.environ.get("MPLBACKEND", "").removeprefix("module://").partition(".")[0]
    if os.environ.get("MPLBACKEND", "").startswith("module://") and find_spec(home) is None:
        del os.environ["MPLBACKEND"]


def write_png(target: Path, data: Dataset, film: Film) -> None:
    """The frames side by side above the reward of every step and the return so far.

    Raises: UsageError without matplotlib; StorageError where the disk refuses.
    """
    expect_package("matplotlib")
    forget_screen()
    from matplotlib.figure import Figure

    rewards = np.asarray(data.episode(film.episode).rewards, np.float64)
    steps = np.arange(1, len(rewards) + 1)
    figure = Figure(figsize=(2.4 * len(film.frames), 4.6), layout="constrained")
    grid = figure.add_gridspec(2, len(film.frames), height_ratios=(3, 2))
    for place, (pixels, step) in enumerate(zip(film.frames, film.steps, strict=True)):
        axes = figure.add_subplot(grid[0, place])
        axes.imshow(pixels)
        axes.set_title(f"step {step}", fontsize=9)
        axes.set_axis_off()
    axes = figure.add_subplot(grid[1, :])
    axes.plot(steps, rewards, color="C0", linewidth=1)
    axes.set_xlabel("step")
    axes.set_ylabel("reward", color="C0")
    total = axes.twinx()
    total.plot(steps, np.cumsum(rewards), color="C1")
    total.set_ylabel("return so far", color="C1")
    for step in film.steps:
        axes.axvline(step, color="0.8", linewidth=0.8, zorder=0)
    with replacing(target, like=PNG) as temporary, disk(target):
        figure.savefig(temporary, dpi=100, format="png")


def clip_frames(length: int, step_s: float) -> tuple[int, float]:
    """(number of frames, frames per second) of a clip in real time.

    500 steps of 12.5 ms are 80 a second, so every second one is shown: 251 frames at 40.
    """
    every = max(1, round(1 / step_s / MOST_FPS))
    return length // every + 1, 1 / (step_s * every)


def write_mp4(target: Path, film: Film, fps: float) -> None:
    """H.264, by the ffmpeg that imageio-ffmpeg brings.

    Raises: UsageError without it; StorageError where the disk refuses.
    """
    expect_package("imageio_ffmpeg")
    from imageio_ffmpeg import write_frames

    height, width = film.frames.shape[1:3]
    with replacing(target, like=MP4) as temporary, disk(target):
        writer = write_frames(
            str(temporary), (width, height), fps=fps, quality=7, macro_block_size=4,
            output_params=["-f", "mp4"],
        )  # fmt: skip
        writer.send(None)
        for pixels in film.frames:
            writer.send(np.ascontiguousarray(pixels))
        writer.close()
