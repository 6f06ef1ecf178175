"""Follower: who is told of a run while it goes, such as experiment trackers (`train/track`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from mpdt.train.run.folder import RunFolder
from mpdt.train.run.prepare import Prepared


class Follower(Protocol):
    """Told in this order; `kept` as often as there is something."""

    def begin(self, folder: RunFolder, prepared: Prepared) -> None:
        """The folder is this run's, and this process has it to itself."""

    def kept(self, size_bytes: int) -> None:
        """No resumed run will take back the first `size_bytes` of metrics.jsonl."""

    def judged(self, results: Mapping[str, Any]) -> None:
        """The content of results.json, of training that has all its updates."""


class Nobody:
    """A follower that hears nothing."""

    def begin(self, folder: RunFolder, prepared: Prepared) -> None: ...

    def kept(self, size_bytes: int) -> None: ...

    def judged(self, results: Mapping[str, Any]) -> None: ...
