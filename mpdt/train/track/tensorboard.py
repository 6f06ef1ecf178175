"""TensorBoard: one event file per delivery, in the run's folder.

    runs/NAME/tensorboard/events.out.tfevents.0000000000-0000000012.mpdt      points 0 to 11

A file is written elsewhere and appears as a whole, so its name is the position: what TensorBoard
shows has every point once, whenever somebody pulled the plug. Files are read in the order of names.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpdt.disk import disk, write_bytes
from mpdt.train.track.points import Facts, Point

FOLDER = "tensorboard"
_NAME = re.compile(r"events\.out\.tfevents\.(\d{10})-(\d{10})\.mpdt")


class TensorBoard:
    """Args:
    folder: of the run.
    """

    every_s = 0.0

    def __init__(self, folder: Path, facts: Facts) -> None:
        self.folder, self._facts = folder / FOLDER, facts

    def held(self) -> int:
        return max((int(found[2]) for found in self._files()), default=0)

    def deliver(self, points: Sequence[Point]) -> None:
        from torch.utils.tensorboard import SummaryWriter

        first = not self._files()
        if not points and not first:
            return
        begin = points[0].number if points else 0
        end = points[-1].number + 1 if points else 0
        with tempfile.TemporaryDirectory(prefix="mpdt-") as temporary:
            writer = SummaryWriter(temporary)
            if first:
                self._write_facts(writer)
            for point in points:
                _write(writer, point)
            writer.close()
            (written,) = Path(temporary).iterdir()
            content = written.read_bytes()
        with disk(self.folder):
            self.folder.mkdir(exist_ok=True)
        name = f"events.out.tfevents.{begin:010d}-{end:010d}.mpdt"
        write_bytes(self.folder / name, content)

    def _files(self) -> list[re.Match[str]]:
        found = (_NAME.fullmatch(path.name) for path in self.folder.glob("events.*"))
        return [match for match in found if match]

    def _write_facts(self, writer: Any) -> None:
        facts = self._facts
        texts = {"settings": json.dumps(facts.settings, indent=1), **facts.described,
                 "tags": ", ".join(facts.tags)}  # fmt: skip
        for name, text in texts.items():
            shown = f"```\n{text}\n```" if "\n" in text else text
            writer.add_text(name, shown, 0)


def _write(writer: Any, point: Point) -> None:
    for name, value in point.scalars.items():
        writer.add_scalar(name, value, point.at)
    for name, text in point.texts.items():
        writer.add_text(name, text, point.at)
    for name, pixels in point.images.items():
        writer.add_image(name, pixels, point.at, dataformats="HWC")
