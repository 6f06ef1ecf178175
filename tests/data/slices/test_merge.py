"""merge and diff on hand-made files: references, sets for adaptation, episodes without a place."""

from __future__ import annotations

from pathlib import Path

import pytest
from makers import make_episode, make_header, source_of, tta_source_of

from mpdt.data.reference import Reference, References
from mpdt.data.slices.diff import diff
from mpdt.data.slices.merge import merge
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file
from mpdt.errors import DataError
from mpdt.seeding import UNKNOWN_SEED_KEY

KNOWN = References({"expert": Reference(9.0, 0.5, 16, source="shipped")})


def made(
    path: Path, row: int, x: list[float], references: References = KNOWN, **columns: object
) -> Dataset:
    """One episode of one task, and a set of an episode per number."""
    episodes = [make_episode(2, row=row, **columns)]  # type: ignore[arg-type]
    header = make_header(
        episodes, [TaskRow("forward", 0, "both", {}, references)], spec={"name": "m", "seed": 1}
    )
    drawn = [make_episode(2, first, quality=4, row=i) for i, first in enumerate(x)]
    sets = {"x": tta_source_of(drawn, {0: 1.0}, {"action_scale": 1.0})} if x else {}
    return write_file(path, header, source_of(episodes), sets)


def test_the_longest_set_is_taken_wherever_it_is(tmp_path: Path) -> None:
    short, long = made(tmp_path / "a.h5", 0, [1.0]), made(tmp_path / "b.h5", 1, [1.0, 2.0])
    for number, sources in enumerate(([short, long], [long, short])):
        done = merge(sources, tmp_path / f"m{number}.h5").dataset
        assert done.tta["x"].digest.tobytes() == long.tta["x"].digest.tobytes()


def test_sets_that_begin_differently_are_refused(tmp_path: Path) -> None:
    one, other = made(tmp_path / "a.h5", 0, [1.0]), made(tmp_path / "b.h5", 1, [3.0, 2.0])
    with pytest.raises(DataError, match="the sets tta/x have different episodes"):
        merge([one, other], tmp_path / "m.h5")


def test_references_come_from_the_source_that_has_some(tmp_path: Path) -> None:
    without, having = made(tmp_path / "a.h5", 0, [], References()), made(tmp_path / "b.h5", 1, [])
    done = merge([without, having], tmp_path / "m.h5").dataset
    assert done.tasks.references[0]["expert"].mean == 9.0


def test_what_either_knows_of_a_task_is_kept_and_two_figures_are_refused(tmp_path: Path) -> None:
    """In both orders: nothing depends on which file comes first."""
    more = References({"random": Reference(1.0, 0.5, 16, source="local")})
    other = References({"expert": Reference(8.0, 0.5, 16, source="local")})
    one, two = made(tmp_path / "a.h5", 0, []), made(tmp_path / "b.h5", 1, [], more)
    three = made(tmp_path / "c.h5", 2, [], other)
    for number, sources in enumerate(([one, two], [two, one])):
        found = merge(sources, tmp_path / f"m{number}.h5").dataset.tasks.references[0]
        assert (found["expert"].mean, found["random"].mean) == (9.0, 1.0)
        with pytest.raises(DataError, match="two figures for the reference expert"):
            merge([*sources, three], tmp_path / "n.h5")


def test_episodes_without_a_place_are_none_that_changed(tmp_path: Path) -> None:
    """Imported ones have no block and row to be compared at."""
    one = made(tmp_path / "a.h5", 0, [], seed_key=UNKNOWN_SEED_KEY)
    two = made(tmp_path / "b.h5", 0, [], seed_key=UNKNOWN_SEED_KEY, progress=0.5)
    (run,) = diff(one, two).runs
    assert (run.same, run.only_a, run.only_b, run.changed) == (0, 1, 1, 0)
