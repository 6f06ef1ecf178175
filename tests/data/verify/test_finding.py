"""What findings say, by hand: faults counted, doubts beside failures, amounts of replay."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from makers import make_episode

from mpdt.data.spec.tasks import get_family
from mpdt.data.verify.finding import Fault, Outcome, judge
from mpdt.data.verify.replay import Amount, _compare
from mpdt.data.verify.streaming import Faults

OWN = SimpleNamespace(label="")


def test_three_episodes_are_named_and_the_others_counted() -> None:
    assert Fault("odd", (1, 2, 3), 3).text() == "odd: episodes 1, 2, 3"
    assert Fault("odd", (1, 2, 3), 4).text() == "odd: episodes 1, 2, 3 and 1 more"
    assert Fault("odd", (1,), 1, "tta x").text() == "odd: episode 1 of tta x"


def test_a_doubt_before_a_failure_leaves_it_one() -> None:
    doubt, failure = Fault("maybe", (1,), 1, is_doubt=True), Fault("wrong", (2,), 1)
    for faults in ([doubt, failure], [failure, doubt]):
        found = judge("x", faults, "fine")
        assert (found.outcome, found.episodes) == (Outcome.FAIL, (2,))
    assert judge("x", [doubt], "fine").outcome is Outcome.WARN
    assert judge("x", [], "fine").outcome is Outcome.PASS


def test_faults_add_up_over_chunks() -> None:
    faults = Faults()
    for episodes in ([0, 1], [], [5, 6], [9]):
        faults.add("odd", OWN, episodes)  # type: ignore[arg-type]
    (found,) = faults.all()
    assert (found.episodes, found.total) == ((0, 1, 5), 5)


def test_amounts_by_hand() -> None:
    """2 % of 51 are two: a part of an episode is one."""
    assert [Amount.parse("2%").of(run, 999) for run in (1, 50, 51, 100, 101)] == [1, 1, 2, 2, 3]
    assert [Amount.parse("40").of(run, 400) for run in (10, 100, 101)] == [1, 10, 11]
    assert Amount.parse("all").of(7, 999) == 7 and Amount.parse("500").of(7, 7) == 7


def test_every_array_of_a_replayed_episode_is_compared() -> None:
    """Of three steps that the horizon cut off; one array at a time is not what was stored."""
    family = get_family("cheetah_dir")
    stored = make_episode(3, sizes=(20, 6), success=True)
    names = ("observations", "rewards", "terminations", "successes")

    def differing(horizon: int = 3, **changes: object) -> tuple[str, ...]:
        arrays = {name: getattr(stored, name)[None].copy() for name in names} | changes
        play = SimpleNamespace(**arrays)
        return _compare(family, 0, stored, play, 0, horizon).differing  # type: ignore[arg-type]

    assert differing() == () and differing(horizon=4) == ("truncations",)
    for name in names:
        other = getattr(stored, name)[None].copy()
        other[0, 0] = ~other[0, 0] if other.dtype == bool else other[0, 0] + 1
        assert differing(**{name: other}) == (name,)
    assert np.array_equal(stored.truncations, [False, False, True])
