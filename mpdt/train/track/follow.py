"""Following: what a run has written goes on to trackers, each point once.

    metrics.jsonl   the truth; lines that a checkpoint covers, or weights, are never taken back
    trackers        get those lines, and behind them each judgement of the finished weights
    tracked.json    the run's id in them; which judgements they have, and from which point on

A kill loses what was not delivered: the next run of the same command delivers it. Lines behind the
last checkpoint are not told of, because a resumed run writes them again. A tracker that fails is
told of once and left alone; training goes on, and so does the file.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import Any

import msgspec

from mpdt.disk import write_bytes
from mpdt.errors import FormatError, TrainingError
from mpdt.model.weights import load_weights
from mpdt.pace import Pace
from mpdt.reading import decode_json, read_json
from mpdt.train.run.config import to_plain
from mpdt.train.run.folder import RunFolder
from mpdt.train.run.prepare import Prepared
from mpdt.train.run.progress import Progress
from mpdt.train.run.results import VERSIONED
from mpdt.train.study.maps import map_pixels, prompt_maps
from mpdt.train.track.points import Facts, Point, point_of, point_of_results
from mpdt.train.track.tracker import Tracker, open_tracker
from mpdt.version import installed

Spans = dict[str, tuple[int, int]]
"""Judgement -> its first point and the one behind its last."""


class Tracked(msgspec.Struct):
    """tracked.json."""

    run: str
    judged: dict[str, Spans] = {}
    """By tracker."""


@dataclass
class Following:
    """Of one run by one or more trackers.

    Args:
        names: of the trackers.
    """

    names: Sequence[str]
    progress: Progress
    _folder: RunFolder = field(init=False)
    _trackers: dict[str, tuple[Tracker, Pace]] = field(default_factory=dict)
    _tasks: Sequence[str] = ()
    _bytes: int | None = None

    def begin(self, folder: RunFolder, prepared: Prepared) -> None:
        """Open the trackers; what an earlier process did not deliver comes with the next lines.

        Raises: TrainingError where one cannot begin, such as without a network or a login.
        """
        self._folder, material = folder, prepared.material
        self._tasks = [material.dataset.tasks.names[row] for row in material.test_rows]
        facts = _facts(folder, self._tracked().run, prepared)
        for name in self.names:
            try:
                tracker = open_tracker(name, folder.path, facts)
                tracker.deliver([])
            except Exception as error:  # theirs may raise anything
                raise TrainingError(
                    f"{name} does not begin: {type(error).__name__}: {error}", where="--log",
                    hint=_HINTS.get(name, ""),
                ) from error  # fmt: skip
            self._trackers[name] = (tracker, Pace(tracker.every_s))

    def kept(self, size_bytes: int) -> None:
        """The first `size_bytes` of metrics.jsonl will not be taken back."""
        self._bytes = size_bytes
        for name, (_, pace) in list(self._trackers.items()):
            if pace.is_time():
                self._deliver(name, self._lines)

    def judged(self, results: Mapping[str, Any]) -> None:
        """These are the results of the weights that are there."""
        if self._bytes is None:  # nothing was trained here
            settings = load_weights(self._folder.weights)[0].settings
            self._bytes = int(str(settings["metrics_bytes"]))
        for find in (self._lines, partial(self._judgement, results)):
            for name in list(self._trackers):
                self._deliver(name, find)

    def _deliver(self, name: str, find: Callable[[str, Tracker], list[Point]]) -> None:
        tracker, _ = self._trackers[name]
        try:
            if points := find(name, tracker):
                tracker.deliver(points)
        except Exception as error:  # noqa: BLE001 - theirs may raise anything, and must end no run
            del self._trackers[name]
            self.progress.say(
                f"{name} failed, and is left alone: {type(error).__name__}: {error}\n"
                "  metrics.jsonl has it all; the same command delivers the rest"
            )

    def _lines(self, name: str, tracker: Tracker) -> list[Point]:
        """What the tracker lacks of the training."""
        return list(_points(self._read(0, self._bytes), tracker.held(), self._tasks))

    def _judgement(self, results: Mapping[str, Any], name: str, tracker: Tracker) -> list[Point]:
        """What the tracker lacks of this judgement; the first one's names have nothing above."""
        assert self._bytes is not None
        trained = self._read(0, self._bytes).count(b"\n")
        lines = self._read(self._bytes, None)
        tracked, held = self._tracked(), tracker.held()
        judging = str(results["identity"]["judging"])[:16]
        # One that was announced and has not come, or not wholly, does not come any more.
        spans = {k: v for k, v in tracked.judged.get(name, {}).items()
                 if k == judging or v[1] <= held}  # fmt: skip
        if judging not in spans:
            first = max(trained, held)
            spans[judging] = (first, first + lines.count(b"\n") + 1)
            tracked.judged[name] = spans
            self._write(tracked)
        first, end = spans[judging]
        if held >= end:
            return []
        points = [*_points(lines, 0, self._tasks, first),
                  point_of_results(results, self._maps(), end - 1)]  # fmt: skip
        if next(iter(spans)) != judging:
            points = [point.below(f"judged {judging[:8]}") for point in points]
        return [point for point in points if point.number >= held]

    def _maps(self) -> dict[str, Any]:
        maps = prompt_maps(self._folder.weights)
        return {name: map_pixels(values) for name, values in maps.items()}

    def _read(self, first: int, end: int | None) -> bytes:
        path = self._folder.log.path
        if not path.exists():
            return b""
        with path.open("rb") as file:
            file.seek(first)
            return file.read(None if end is None else end - first)

    def _tracked(self) -> Tracked:
        """Raises: FormatError for a damaged file."""
        path = self._folder.tracked
        if not path.exists():
            tracked = Tracked(secrets.token_hex(4))
            self._write(tracked)
            return tracked
        try:
            return msgspec.convert(read_json(path), Tracked)
        except msgspec.ValidationError as error:
            raise FormatError(
                "not what trackers have of a run", where=str(path), found=str(error),
                hint="move it away: trackers then get a new run",
            ) from error  # fmt: skip

    def _write(self, tracked: Tracked) -> None:
        text = json.dumps(msgspec.to_builtins(tracked)) + "\n"
        write_bytes(self._folder.tracked, text.encode())


def _points(
    lines: bytes, first: int, tasks: Sequence[str], number: int = 0
) -> Iterable[Point]:  # fmt: skip
    """Those of whole lines from the `first` on; the very first line has `number`."""
    rows = islice(enumerate(lines.splitlines(keepends=True), number), first, None)
    for place, line in rows:
        if line.endswith(b"\n"):
            yield point_of(decode_json(line), place, tasks)


def _facts(folder: RunFolder, run: str, prepared: Prepared) -> Facts:
    material, config = prepared.material, prepared.config
    dataset = material.dataset
    versions = installed(VERSIONED)
    described = {
        "data": f"{dataset.title} {dataset.name} {dataset.version}, {material.quality}, content "
                f"{dataset.content_hash}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
    }  # fmt: skip
    tags = (dataset.family, config.method, material.quality,
            f"data-{dataset.content_hash[:12]}")  # fmt: skip
    return Facts(run, folder.path.name, to_plain(config), described, tags)


_HINTS = {"wandb": "`wandb login`, or WANDB_MODE=offline in front of the command"}
