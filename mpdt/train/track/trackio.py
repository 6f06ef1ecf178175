"""trackio: a local database of Hugging Face's, for all runs, wherever TRACKIO_DIR says.

A delivery opens the run, logs and closes it; points of a batch come in order and all at once, so
the largest step that the database has is the position.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from mpdt.errors import StorageError
from mpdt.train.track.points import Facts, Point
from mpdt.train.track.tracker import PROJECT


class Trackio:
    """Args:
    folder: of the run, of which nothing is needed here.
    """

    every_s = 10.0

    def __init__(self, folder: Path, facts: Facts) -> None:
        self._facts, self.name = facts, f"{facts.name}-{facts.run}"

    def held(self) -> int:
        from trackio.sqlite_storage import SQLiteStorage

        last = SQLiteStorage.get_max_step_for_run(PROJECT, self.name)
        return 0 if last is None else int(last) + 1

    def deliver(self, points: Sequence[Point]) -> None:
        if not points:  # a run begins with its first point there
            return
        import trackio

        facts = self._facts
        config = {
            "settings": facts.settings,
            "described": dict(facts.described),
            "tags": list(facts.tags),
        }
        with redirect_stdout(sys.stderr):  # results are what stands on ours
            run = trackio.init(
                project=PROJECT, name=self.name, config=config, resume="allow", embed=False,
                auto_log_gpu=False, auto_log_cpu=False,
            )  # fmt: skip
            for point in points:
                run.log(_values(point), step=point.number)
            trackio.finish()
        # It warns and goes on where it could not write.
        if (held := self.held()) <= points[-1].number:
            raise StorageError(
                "trackio did not keep what it was given", where=self.name,
                expected=f"{points[-1].number + 1} points", found=str(held),
            )  # fmt: skip


def _values(point: Point) -> dict[str, Any]:
    import trackio

    images = {name: trackio.Image(pixels, caption=name) for name, pixels in point.images.items()}
    return {"update": point.at, **point.scalars, **point.texts, **images}
