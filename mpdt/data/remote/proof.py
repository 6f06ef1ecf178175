"""Proof: a dataset file is what its own digests and seal say, before it leaves and on arrival."""

from __future__ import annotations

from pathlib import Path

from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError


def prove(path: Path, lock: Path | None = None) -> str:
    """The content hash of a file all of whose bytes are covered by a digest or the seal.

    Args:
        lock: only what this datasets.lock holds will do.
    Raises: DataError saying what is wrong; MissingFileError, StorageError.
    """
    report = verify(path, only=("hash",), lock=lock)
    for finding in report.findings:
        if finding.outcome is Outcome.FAIL:
            raise DataError("not a whole dataset file", where=str(path),
                            found="; ".join(finding.lines()), hint=finding.hint)  # fmt: skip
    return report.content_hash
