"""Threads for what leaves the interpreter alone: hashes, reading, numpy's long loops; in order.

items    a b c d e ...
threads  [b] [c]            two at work, a few more waiting to be asked for
yields   a                  in the order of the items, whoever was done first
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Generic, TypeVar

from mpdt.data.workers.processes import default_workers

_Item = TypeVar("_Item")
_Done = TypeVar("_Done")

AHEAD = 2
"""Items per thread that are begun before they are asked for; memory is bounded by them."""


class Ahead(Generic[_Done]):
    """Calls that are begun in threads and whose results come in the order of the calls.

    Args:
        threads: 0 = one per core that this process may use; 1 = none but the caller's.
    """

    def __init__(self, threads: int = 0) -> None:
        self._threads = threads or default_workers()
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None
        self._waiting: deque[Future[_Done]] = deque()

    def give(self, do: Callable[..., _Done], *arguments: Any) -> list[_Done]:
        """Begin a call; the results that are due, those of earlier calls.

        Raises: what an earlier call raised, or this one where there are no threads.
        """
        if self._pool is None:
            return [do(*arguments)]
        self._waiting.append(self._pool.submit(do, *arguments))
        return [self._next()] if len(self._waiting) > AHEAD * self._threads else []

    def rest(self) -> Iterator[_Done]:
        """The results of all calls that are left. Raises: as `give`."""
        while self._waiting:
            yield self._next()

    def stop(self) -> None:
        """Drop what was not begun and wait for the rest."""
        self._waiting.clear()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _next(self) -> _Done:
        return self._waiting.popleft().result()


def in_order(
    do: Callable[[_Item], _Done], items: Iterable[_Item], threads: int = 0
) -> Iterator[_Done]:
    """`do(item)` of each item, as `map` gives it, worked on by several threads.

    Args:
        items: taken one by one, in the caller's thread, some before their turn.
        threads: as `Ahead`.
    Raises: what `do` raises at the place of that item, what `items` raises at once.
    """
    ahead = Ahead[_Done](threads)
    try:
        for item in items:
            yield from ahead.give(do, item)
        yield from ahead.rest()
    finally:
        ahead.stop()
