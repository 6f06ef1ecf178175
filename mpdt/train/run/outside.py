"""Policies that are not this run's, judged on the tasks of a file as ours are: the same table.

    module:function   any callable, see `Act`; imported because the command line names it
    DIR, hf://...     a bundle: each of its sets of prompts that has the tasks

A callable acts task by task: a group of calls begins with one where every row starts, and all of
them are of one task. Whatever is wrong with its answers is one error that names it, task and step.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.sim.actors import Actions, Observations, Rewards, Rows
from mpdt.data.spec.tasks import Family
from mpdt.errors import DataError, ShapeError, UsageError, nearest

Act = Callable[[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], str], Any]
"""act(observations, rewards, starts, task) -> actions, for B episodes of one task side by side.

    observations   (B, D) float32, as in the data: the goal is hidden where it is hidden there
    rewards        (B,) float32, what the actions before were paid; 0 in rows that start
    starts         (B,) bool, rows whose episode begins with this observation
    task           the name of the task
    actions        (B, A), numbers; clipped to the bounds

Episodes that are over go on getting calls until all are; their rows do not count.
"""


@dataclass(frozen=True)
class Named:
    """A callable by the words that named it.

    Args:
        fingerprint: of its module's source; of the words alone where there is none.
    """

    words: str
    act: Act
    fingerprint: bytes


@contextmanager
def importing_from(folder: Path) -> Iterator[None]:
    """Modules are looked for in `folder` as well, also by what is called meanwhile."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        with suppress(ValueError):  # what was imported may have changed the list
            sys.path.remove(str(folder))


def load_callable(words: str) -> Named:
    """Import `module:function`; the working folder counts as well.

    Raises: UsageError for what cannot be imported, is not there or cannot be called.
    """
    module_name, colon, path = words.partition(":")
    if not (colon and module_name and path):
        raise UsageError(f"cannot read '{words}'", where="--policy",
                         expected="module:function, or a bundle's folder")  # fmt: skip
    try:
        with importing_from(Path.cwd()), redirect_stdout(sys.stderr):
            module = importlib.import_module(module_name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        what = f"cannot be imported: {_told(error)}"
        raise UsageError(what, where=module_name,
                         hint="-v shows where; modules are looked for here and in what is "
                         "installed") from error  # fmt: skip
    found: Any = module
    for name in path.split("."):
        if not hasattr(found, name):
            near = nearest(name, [each for each in vars(module) if not each.startswith("_")])
            raise UsageError(f"no '{name}' in it {near}".rstrip(), where=words)
        found = getattr(found, name)
    if not callable(found) or inspect.isclass(found):
        raise UsageError("cannot be called", where=words, found=type(found).__name__,
                         expected="act(observations, rewards, starts, task)")  # fmt: skip
    source = getattr(module, "__file__", None)
    content = Path(source).read_bytes() if source and Path(source).is_file() else b""
    return Named(words, found, hashlib.sha256(words.encode() + b"\0" + content).digest())


class OutsideActor:
    """A callable in the place of a policy, on one task."""

    def __init__(self, named: Named, task: str, family: Family) -> None:
        self._named, self._task, self._family = named, task, family
        self._rows = 0

    def begin(self, rows: Rows) -> None:
        self._rows = len(rows.tasks)

    def act(self, step: int, observations: Observations, rewards: Rewards | None = None) -> Actions:
        """Raises: UsageError for one that raises; ShapeError and DataError for bad answers."""
        B, A = self._rows, self._family.action_size
        where = f"{self._named.words}, task {self._task}, step {step}"
        paid = np.zeros(B, np.float32) if rewards is None else rewards.astype(np.float32)
        try:
            with redirect_stdout(sys.stderr):  # ours has the results
                answer = self._named.act(
                    observations.astype(np.float32), paid, np.full(B, rewards is None), self._task
                )
            actions = np.asarray(answer)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise UsageError(f"the policy failed: {_told(error)}", where=where,
                             hint="-v shows where") from error  # fmt: skip
        if actions.shape != (B, A):
            raise ShapeError("wrong actions", where=where, expected=f"shape ({B}, {A})",
                             found=f"{type(answer).__name__} of shape {actions.shape}")  # fmt: skip
        if actions.dtype.kind not in "fiu":
            raise ShapeError("actions that are no real numbers", where=where,
                             expected="floats", found=str(actions.dtype))  # fmt: skip
        wished: NDArray[np.float64] = actions.astype(np.float64)
        if not np.isfinite(wished).all():
            row = int(np.flatnonzero(~np.isfinite(wished).all(axis=1))[0])
            raise DataError("an action is not a number", where=where,
                            found=f"row {row}: {wished[row].tolist()}")  # fmt: skip
        return wished


def _told(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__
