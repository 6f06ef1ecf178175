"""Weights & Biases: one session per delivery, all of one run; offline as well.

    runs/NAME/wandb/offline-run-DATE-ID/   and in it points.json: which points

Their process writes late: of an offline session that is killed nothing is left. So a session is
begun for what is to be delivered and ended before anything else happens, in a folder that gets its
place when it is whole. Its points.json is the position. Online their server is asked as well.

Whether there is a network says WANDB_MODE (online, offline), as everywhere with them. Offline
sessions are sent by `wandb sync runs/NAME/wandb/offline-run-*`, into one run.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpdt.disk import disk, put_folder
from mpdt.errors import MpdtError
from mpdt.reading import read_json
from mpdt.train.track.points import Facts, Point
from mpdt.train.track.tracker import PROJECT

FOLDER, POINTS, SENDING = "wandb", "points.json", ".wandb-sending"
LONGEST_TAG = 64


class WeightsAndBiases:
    """Args:
    folder: of the run.
    """

    every_s = 60.0  # a session takes some two seconds to begin

    def __init__(self, folder: Path, facts: Facts) -> None:
        self._run, self.folder, self._facts = folder, folder / FOLDER, facts
        self._step, self._ended_s = 0, 0.0

    def held(self) -> int:
        return max([self._step, *map(_end_of, self.folder.glob(f"*run-*/{POINTS}"))])

    def deliver(self, points: Sequence[Point]) -> None:
        if not points and any(self.folder.glob("*run-*")):
            return
        sending = self._run / SENDING
        shutil.rmtree(sending, ignore_errors=True)  # of a session that was killed
        with disk(sending):
            sending.mkdir()
        # The name of a session's folder has seconds.
        time.sleep(max(0.0, self._ended_s + 1.1 - time.monotonic()))
        try:
            session = self._session(sending, points)
            if not session.is_relative_to(sending):  # WANDB_MODE=disabled keeps nothing
                return
            end = {"end": points[-1].number + 1 if points else 0}
            with disk(session):
                (session / POINTS).write_text(json.dumps(end) + "\n")
                self.folder.mkdir(exist_ok=True)
            put_folder(session, self.folder / session.name)
        finally:
            self._ended_s = time.monotonic()
            shutil.rmtree(sending, ignore_errors=True)

    def _session(self, sending: Path, points: Sequence[Point]) -> Path:
        """The folder of an ended session that has these points."""
        import wandb

        facts = self._facts
        run = wandb.init(
            project=os.environ.get("WANDB_PROJECT", PROJECT), dir=sending, id=facts.run,
            name=facts.name, resume="allow", tags=[tag[:LONGEST_TAG] for tag in facts.tags],
            config={**facts.settings, "described": dict(facts.described)}, allow_val_change=True,
            settings=wandb.Settings(
                console="off", silent=True, x_disable_stats=True, save_code=False, disable_git=True,
            ),
        )  # fmt: skip
        session = Path(run.dir).parent
        # Whoever was killed after their server had it and before we knew; it would warn of each.
        self._step = int(run.step)
        seen = set[str]()
        for point in points:
            if point.number >= self._step:
                run.log(_values(run, point, seen), step=point.number)
        run.finish()
        return session


def _values(run: Any, point: Point, seen: set[str]) -> dict[str, Any]:
    """What a point logs; every phase over its own updates."""
    import wandb

    values: dict[str, Any] = {**point.scalars}
    for group in {name.partition("/")[0] for name in (*point.scalars, *point.images)}:
        values[f"{group}/update"] = point.at
        if group not in seen:
            seen.add(group)
            run.define_metric(f"{group}/*", step_metric=f"{group}/update")
    values |= {name: wandb.Image(pixels, caption=name) for name, pixels in point.images.items()}
    return values | dict(point.texts)


def _end_of(path: Path) -> int:
    try:
        return int(read_json(path)["end"])
    except (MpdtError, KeyError, TypeError, ValueError):
        return 0
