"""The making verbs: each thing is found out once; episode lengths are typed as one does."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from mpdt.data.cli import main
from mpdt.data.collect.plan import make_plan
from mpdt.data.sim.ladder import load_ladder
from mpdt.data.sim.record import find_records
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.store.reader import open_dataset
from mpdt.data.verbs.options import split_steps
from mpdt.errors import UsageError

ONCE = [load_catalog, load_ladder, find_records, make_plan, open_dataset]


def calls_during(work: Callable[[], Any]) -> dict[str, int]:
    """How often each of ONCE ran, whoever called it."""
    names = {function.__code__: function.__name__ for function in ONCE}
    found: Counter[str] = Counter()

    def look(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_code in names:
            found[names[frame.f_code]] += 1

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        work()
    finally:
        sys.setprofile(before)
    return dict(found)


def test_one_collect_finds_everything_out_once(
    fake_sim: Any, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shipped network acts in the fake simulator; a smoke version may have any levels."""
    monkeypatch.setattr("mpdt.data.collect.runner.make_batch", fake_sim.FakeBatch)
    text = Path("datasets.yaml").read_text().replace("network: fake", "network: cheetah_dir")
    Path("datasets.yaml").write_text(text)
    once = {function.__name__: 1 for function in ONCE}
    words = ["collect", "tiny", "--smoke", "--workers", "0", "-q"]
    for state in ("new", "finished"):
        assert calls_during(lambda: main(words)) == once, state
    more = ["tta", "tiny-smoke.h5", "--name", "more", "--workers", "0", "-q"]
    assert calls_during(lambda: main(more))["make_plan"] == 1


def test_horizons_are_steps_in_one_word_or_several():
    assert split_steps(("200,500", "77"), "--horizons") == (200, 500, 77)
    assert split_steps((), "--horizons") == ()


@pytest.mark.parametrize("word", ["0", "-5", "fast", "2.5"])
def test_what_is_no_episode_length_is_refused(word):
    with pytest.raises(UsageError, match=f"--horizons: not an episode length.*found {word}"):
        split_steps((f"200,{word}",), "--horizons")
