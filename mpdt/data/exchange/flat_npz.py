"""Flat arrays as in D4RL, but in an .npz: steps of one task and quality, episode after episode.

observations, next_observations   (N, D)        terminals   the task's own end
actions                           (N, A)        timeouts    its time limit; optional
rewards                           (N,)          successes   optional
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.exchange.treatment import RawEpisode, joined
from mpdt.data.spec.rules import MOST_STEPS
from mpdt.errors import DataError, FormatError, ShapeError, UsageError
from mpdt.reading import open_plain, refuse_other

_MOST_COMPRESSED = 100
_NAMES = ("observations", "next_observations", "actions", "rewards", "terminals", "timeouts",
        "successes")  # fmt: skip


def episodes(path: Path, horizon: int | None) -> Iterator[RawEpisode]:
    """Its episodes; one that the file's end cuts off is left out.

    Args:
        horizon: the time limit, where the file does not flag what it cut off.
    Raises: FormatError, ShapeError, DataError; UsageError where nobody says the time limit.
    """
    arrays = _arrays(path)
    if missing := [name for name in _NAMES[:5] if name not in arrays]:
        raise FormatError(f"no {missing[0]} in it", where=str(path), expected=", ".join(_NAMES[:5]),
                          hint="an export of mpdt is imported without --family-of")  # fmt: skip
    if "timeouts" not in arrays and horizon is None:
        raise no_limit(path)
    counts = {name: len(array) for name, array in arrays.items() if array.ndim}
    if len(set(counts.values())) != 1 or len(counts) != len(arrays):
        raise ShapeError("arrays of different lengths", where=str(path), found=str(counts)[:160])
    limit = horizon or MOST_STEPS
    terminals = arrays["terminals"].reshape(-1).astype(bool)
    timeouts = np.zeros_like(terminals)
    if "timeouts" in arrays:
        timeouts = arrays["timeouts"].reshape(-1).astype(bool)
    start = number = 0
    for row in range(len(terminals)):
        full = "timeouts" not in arrays and row + 1 - start == limit
        if not (terminals[row] or timeouts[row] or full):
            continue
        rows = slice(start, row + 1)
        where = f"{path}: episode {number}"
        over, cut = np.zeros(row + 1 - start, bool), np.zeros(row + 1 - start, bool)
        over[-1], cut[-1] = terminals[row], timeouts[row] or not terminals[row]
        yield RawEpisode(
            observations=joined(
                arrays["observations"][rows], arrays["next_observations"][rows], where
            ),
            actions=arrays["actions"][rows], rewards=arrays["rewards"][rows],
            terminations=over, truncations=cut,
            successes=arrays["successes"][rows] if "successes" in arrays else None,
        )  # fmt: skip
        start, number = row + 1, number + 1
    if len(terminals) and not number:
        raise DataError("no step ends an episode", where=str(path),
                        expected="terminals or timeouts true at the last step of each",
                        found=f"{len(terminals)} steps, all false",
                        hint="without timeouts, --horizon STEPS says where episodes end"
                        )  # fmt: skip


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    refuse_other(path, "an .npz file", "a zip archive")
    try:
        with open_plain(path) as file, zipfile.ZipFile(file) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > _MOST_COMPRESSED * path.stat().st_size:
                raise ValueError(f"{size:,} bytes, more than it can hold")
        with open_plain(path) as file, np.load(file, allow_pickle=False) as content:
            return {name: content[name] for name in _NAMES if name in content.files}
    except (zipfile.BadZipFile, ValueError, KeyError, EOFError, OSError) as error:
        raise FormatError("damaged, or not an .npz file of plain numbers", where=str(path),
                          found=f"{type(error).__name__}: {error}"[:120]) from error  # fmt: skip


def no_limit(path: Path) -> UsageError:
    """The error for flat arrays without timeouts, of which no horizon is known."""
    return UsageError("it does not say where episodes were cut off", where=str(path),
                      expected="timeouts", hint="--horizon STEPS, the time limit")  # fmt: skip
