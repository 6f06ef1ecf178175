"""Work in threads comes back in its order, and no more is begun than is soon asked for."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from mpdt.data.workers.threads import AHEAD, in_order


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_are_those_of_map(threads: int) -> None:
    first = threading.Event()

    def square(n: int) -> int:
        if threads > 1 and n == 0:  # the first one is done last of the first few
            assert first.wait(10)
        if n == threads - 1:
            first.set()
        return n * n

    assert list(in_order(square, range(40), threads)) == [n * n for n in range(40)]


def test_items_are_taken_when_they_are_needed() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for n in range(100):
            taken.append(n)
            yield n

    results = in_order(str, items(), 3)
    assert not taken
    assert next(results) == "0" and len(taken) == AHEAD * 3 + 1
    assert next(results) == "1" and len(taken) == AHEAD * 3 + 2
    results.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_comes_at_its_place_and_ends_it(threads: int) -> None:
    begun: list[int] = []

    def fail_at_five(n: int) -> int:
        begun.append(n)
        if n == 5:
            raise ValueError("five")
        return n

    results, seen = in_order(fail_at_five, range(100), threads), []
    with pytest.raises(ValueError, match="five"):
        for n in results:
            seen.append(n)
    assert seen == [0, 1, 2, 3, 4] and max(begun) <= 5 + AHEAD * threads
    assert not [one for one in threading.enumerate() if "ThreadPool" in one.name]
