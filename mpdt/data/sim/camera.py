"""Camera: pictures of a simulator without a screen. Used by gym.py, vector.py and card/film.py.

OpenGL is chosen when mujoco is imported, from MUJOCO_GL; film.py tries several in child processes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from mpdt.data.spec.family import View
from mpdt.errors import MpdtError, SimulatorError, UsageError

Pixels = npt.NDArray[np.uint8]

NO_SCREEN = (
    "drawing without a screen needs EGL or OSMesa; on Debian: "
    "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6 and MUJOCO_GL=osmesa"
)


SIDE = 480
"""Pixels of a frame's side, as in gymnasium's own MuJoCo environments."""


def check_render_mode(mode: str | None, where: str) -> None:
    """Raises: UsageError for a mode other than rgb_array and None."""
    if mode not in (None, "rgb_array"):
        raise UsageError("no such render mode", where=where, expected="rgb_array or None",
                         found=repr(mode),
                         hint="gymnasium.make shows a window for 'human' by itself")  # fmt: skip


def no_render_mode(where: str) -> UsageError:
    """What `render` raises in an environment that was made without a mode."""
    return UsageError("nothing to render: no render mode", where=where,
                      hint="make the environment with render_mode='rgb_array'")  # fmt: skip


class Camera:
    """Looks at one model off-screen, from the place that its family names.

    Raises: whatever the OpenGL driver raises; `drawing` makes one error of it.
    """

    def __init__(self, model: Any, view: View, height: int, width: int) -> None:
        import mujoco  # here: film.py sets MUJOCO_GL before it

        self._view = view
        self._renderer = mujoco.Renderer(model, height, width)
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = view.azimuth, view.elevation
        self._camera.distance = view.distance

    def frame(self, data: Any) -> Pixels:
        """(height, width, 3) of an MjData, the view's point or the torso in the middle."""
        at = self._view.at
        # MuJoCo's own tracking lags behind the torso.
        self._camera.lookat[:] = (*data.body("torso").xpos[:2], 0.5) if at is None else at
        self._renderer.update_scene(data, camera=self._camera)
        pixels: Pixels = self._renderer.render().copy()
        return pixels

    def close(self) -> None:
        self._renderer.close()


@contextmanager
def drawing() -> Iterator[None]:
    """Raises: SimulatorError in place of whatever an OpenGL driver raises."""
    try:
        yield
    except MpdtError:
        raise
    except Exception as error:
        raise SimulatorError(
            "nothing here can draw a picture",
            found=f"{type(error).__name__}: {error}".splitlines()[0][:120],
            hint=f"start the program with MUJOCO_GL=egl; {NO_SCREEN}",
        ) from error
