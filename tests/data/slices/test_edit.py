"""merge, drop and diff on tiny.h5: 2 tasks x (4 random, 4 medium, 4 expert, 4 history)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.slices.diff import diff
from mpdt.data.slices.drop import drop, parse_ids
from mpdt.data.slices.merge import merge
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError, UsageError


@pytest.fixture
def data(tiny_file: Path) -> Dataset:
    return open_dataset(tiny_file)


def test_all_cut_outs_together_are_the_file_again(data: Dataset, tmp_path: Path) -> None:
    qualities = EpisodeCounts.__struct_fields__
    parts = [cut_file(data, Cut(quality=q), tmp_path / f"{q}.h5") for q in qualities]
    done = merge(parts[::-1], tmp_path / "all.h5")  # in whatever order they are given
    assert done.num_repeated == 0
    whole = done.dataset
    assert whole.content_hash == data.content_hash
    assert whole.spec_hash == data.spec_hash
    assert whole.parent == data.content_hash
    assert whole.episodes.source is not None and whole.episodes.source.tolist() == list(range(32))
    assert whole.tta["default"].digest.tobytes() == data.tta["default"].digest.tobytes()
    assert whole.stats["returns"]["mean"] == data.stats["returns"]["mean"]
    assert set(whole.slices) == set(data.slices)
    (step,) = whole.lineage
    assert (step["verb"], len(step["from"])) == ("merge", 4)
    assert step["before"][0][0]["rule"] == {"quality": "history"}


def test_what_is_in_both_is_there_once(data: Dataset, tmp_path: Path) -> None:
    half = cut_file(data, Cut(tasks=("forward",)), tmp_path / "f.h5")
    done = merge([half, data], tmp_path / "all.h5")
    assert done.num_repeated == 16
    assert done.dataset.content_hash == data.content_hash
    assert done.dataset.parent == half.content_hash  # no common parent: the first source
    assert done.dataset.episodes.source is None
    assert len(done.dataset.tta["default"]) == 4


def test_tasks_collected_apart_and_a_longer_collection(
    fakes: Callable[..., None], tiny_spec: DatasetSpec, data: Dataset, tmp_path: Path
) -> None:
    def made(name: str, **changes: object) -> Dataset:
        spec = msgspec.structs.replace(tiny_spec, **changes)
        return collect(make_job(spec), tmp_path / name, workers=0).dataset

    forward, backward = made("f.h5", tasks=("forward",)), made("b.h5", tasks=("backward",))
    both = merge([backward, forward], tmp_path / "fb.h5").dataset
    assert both.content_hash == data.content_hash
    assert both.tasks.names == ("forward", "backward")
    assert sorted(both.spec["tasks"]) == ["backward", "forward"]
    counts = EpisodeCounts(random=4, medium=4, expert=7, history=4)
    longer = made("l.h5", episodes=counts)
    done = merge([data, longer], tmp_path / "dl.h5")
    assert done.dataset.content_hash == longer.content_hash
    assert done.num_repeated == 32
    assert done.dataset.spec["episodes"]["expert"] == 7
    assert merge([longer, data], tmp_path / "ld.h5").dataset.spec["episodes"]["expert"] == 7


def test_contradictions_are_refused(
    fakes: Callable[..., None], tiny_spec: DatasetSpec, data: Dataset, tmp_path: Path
) -> None:
    other = collect(
        make_job(msgspec.structs.replace(tiny_spec, seed=8)), tmp_path / "o.h5", workers=0
    )
    with pytest.raises(DataError, match=r"not made for one file: seed 7 -> 8"):
        merge([data, other.dataset], tmp_path / "x.h5")
    fakes(0.45)
    weaker = collect(make_job(tiny_spec), tmp_path / "w.h5", workers=0).dataset
    with pytest.raises(DataError, match="different episodes of one place") as caught:
        merge([data, weaker], tmp_path / "x.h5")
    assert "tiny.h5: episode 4" in str(caught.value) and "w.h5: episode 4" in str(caught.value)
    assert "mpdt-data diff" in caught.value.hint
    with pytest.raises(UsageError, match="at least two"):
        merge([data], tmp_path / "x.h5")
    with pytest.raises(DataError, match="replace another file"):
        merge([data, data], data.path)
    assert not (tmp_path / "x.h5").exists()


def test_drop_by_id(data: Dataset, tmp_path: Path) -> None:
    left = drop(data, tmp_path / "d.h5", [0, 5, 31])
    assert left.num_episodes == 29
    assert left.episodes.source is not None
    kept = [i for i in range(32) if i not in (0, 5, 31)]
    assert left.episodes.source.tolist() == kept
    assert (left.episodes.digest == data.episodes.digest[kept]).all()
    assert left.parent == data.content_hash
    assert left.lineage[0]["rule"] == {"episodes": [0, 5, 31]}
    assert left.slices["expert"].tolist() == [6, 7, 8, 9, 22, 23, 24, 25]
    assert len(left.tta["default"]) == 4
    again = drop(left, tmp_path / "e.h5", [0])
    assert [step["verb"] for step in again.lineage] == ["drop", "drop"]
    assert again.episodes.source is not None and again.episodes.source[0] == 1


def test_drop_by_rule(data: Dataset, tmp_path: Path) -> None:
    left = drop(data, tmp_path / "d.h5", [0], Cut(quality="history", tasks=("backward",)))
    assert left.num_episodes == 32 - 4 - 1
    assert left.lineage[0]["rule"]["chosen"] == {"quality": "history", "tasks": ["backward"]}
    # Its TTA set keeps a task that has lost all its episodes.
    half = drop(data, tmp_path / "h.h5", rule=Cut(tasks=("backward",)))
    assert half.tasks.names == ("forward", "backward")
    assert np.unique(half.episodes.task).tolist() == [0]


def test_drops_that_make_no_sense(data: Dataset, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no episode 32"):
        drop(data, tmp_path / "d.h5", [32])
    with pytest.raises(UsageError, match="nothing to drop"):
        drop(data, tmp_path / "d.h5")
    with pytest.raises(DataError, match="no episode would be left"):
        drop(data, tmp_path / "d.h5", range(32))
    with pytest.raises(DataError, match="replace another file"):
        drop(data, data.path, [1])


def test_ids_as_they_are_typed() -> None:
    assert parse_ids(["3,17", "5-7,6"]) == [3, 5, 6, 7, 17]
    assert parse_ids([]) == []
    for word in ("a", "1-", "-1", "7-5", "1-999999999999", "1.5"):
        with pytest.raises(UsageError):
            parse_ids([word])


def test_equal_files_have_an_empty_diff(data: Dataset) -> None:
    found = diff(data, data)
    assert found.is_empty
    assert not found.runs and not found.header


def test_diff_names_tasks_runs_fields_and_header(
    fakes: Callable[..., None], tiny_spec: DatasetSpec, data: Dataset, tmp_path: Path
) -> None:
    fakes(0.45)
    counts = EpisodeCounts(random=5, medium=4, expert=4, history=0)
    spec = msgspec.structs.replace(
        tiny_spec, version="2.0.0", tasks=("forward",), episodes=counts, tta={}
    )
    other = collect(make_job(spec), tmp_path / "o.h5", workers=0).dataset
    found = diff(data, other)
    assert found.tasks_only_a == ["backward"] and found.tasks_only_b == []
    assert 'version "1.0.0" -> "2.0.0"' in found.header
    assert "spec.episodes.random 4 -> 5" in found.header
    runs = {(r.task, r.quality): (r.same, r.only_a, r.only_b, r.changed) for r in found.runs}
    assert runs["forward", "random"] == (4, 0, 1, 0)
    assert runs["forward", "medium"] == (0, 0, 0, 4)
    assert runs["forward", "history"] == (0, 4, 0, 0)
    assert runs["backward", "expert"] == (0, 4, 0, 0)
    assert ("forward", "expert") not in runs  # equal
    (medium,) = [run for run in found.runs if run.quality == "medium" and run.changed]
    assert medium.examples[0] == (4, 5, ("actions", "rewards", "policy"))
    assert found.tta == ["tta set default: only in A"]
    assert "slice history: only in A" in found.slices
    assert "slice expert: differs" in found.slices
    assert not found.is_empty


def test_a_merged_file_may_only_replace_one_of_the_same_sources(
    data: Dataset, tmp_path: Path
) -> None:
    parts = [cut_file(data, Cut(quality=name), tmp_path / f"{name}.h5")
             for name in ("random", "medium", "expert")]  # fmt: skip
    made = merge(parts[:2], tmp_path / "m.h5").dataset.content_hash
    with pytest.raises(DataError, match=r"would replace another file.*of other sources"):
        merge(parts[1:], tmp_path / "m.h5")
    assert open_dataset(tmp_path / "m.h5").content_hash == made
    assert merge(parts[:2], tmp_path / "m.h5").dataset.content_hash == made
