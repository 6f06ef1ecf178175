"""Cut and split on the small collected file: 2 tasks x (4 random, 4 medium, 4 expert, 4 history).

Ids: task 0 holds 0-15 and task 1 16-31; in each, random 0-3, medium 4-7, expert 8-11,
history 12-15.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from mpdt.data.slices.cut import Cut, choose, cut_file
from mpdt.data.slices.drop import drop
from mpdt.data.slices.merge import merge
from mpdt.data.slices.split import split
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.errors import DataError, MissingFileError, UsageError


@pytest.fixture
def data(tiny_file: Path) -> Dataset:
    return open_dataset(tiny_file)


def with_roles(data: Dataset, codes: list[int]) -> Dataset:
    """The same file with other roles; 0 train, 1 test."""
    data.tasks.roles[:] = codes
    return data


@pytest.mark.parametrize(
    ("cut", "wanted"),
    [
        (Cut(quality="medium"), [4, 5, 6, 7, 20, 21, 22, 23]),
        (Cut(tasks=("backward",), quality="expert"), [24, 25, 26, 27]),
        (Cut(slice="random", tasks=("forward", "backward")), [0, 1, 2, 3, 16, 17, 18, 19]),
        (Cut(role="train"), list(range(32))),  # role both is in either
        (Cut(role="test"), list(range(32))),
    ],
)
def test_choose_by_hand(data: Dataset, cut: Cut, wanted: list[int]) -> None:
    assert choose(data, cut).tolist() == wanted


def test_roles_choose_tasks(data: Dataset) -> None:
    data = with_roles(data, [0, 1])
    assert choose(data, Cut(role="train")).tolist() == list(range(16))
    assert choose(data, Cut(role="test")).tolist() == list(range(16, 32))


def test_few_episodes_are_nested_and_per_task(data: Dataset) -> None:
    sets = [set(choose(data, Cut(quality="history", episodes=n)).tolist()) for n in (1, 2, 3, 9)]
    assert [len(found) for found in sets] == [2, 4, 6, 8]
    assert sets[0] < sets[1] < sets[2] < sets[3]
    assert all(len({i // 16 for i in found}) == 2 for found in sets)


def test_few_episodes_are_those_with_the_smallest_digests(data: Dataset) -> None:
    """Slow twin: look at the digests as whole numbers."""
    for row in (0, 1):
        ids = [i for i in range(32) if data.episodes.task[i] == row]
        numbers = {i: int.from_bytes(data.episodes.digest[i].tobytes()) for i in ids}
        wanted = sorted(sorted(ids, key=lambda i: numbers[i])[:5])
        found = choose(data, Cut(episodes=5))
        assert [i for i in found if data.episodes.task[i] == row] == wanted


def test_unknown_names_have_a_nearest_one(data: Dataset) -> None:
    with pytest.raises(UsageError, match="did you mean 'medium'"):
        choose(data, Cut(quality="mediun"))
    with pytest.raises(UsageError, match="did you mean 'forward'"):
        choose(data, Cut(tasks=("forwrd",)))
    with pytest.raises(UsageError, match="did you mean 'expert'"):
        choose(data, Cut(slice="experts"))
    with pytest.raises(UsageError, match="1 or more"):
        choose(data, Cut(episodes=0))
    with pytest.raises(UsageError, match="too many episodes"):
        choose(data, Cut(episodes=10**20))


def test_nothing_left_is_an_error(data: Dataset) -> None:
    with pytest.raises(DataError, match="no episode fits"):
        choose(data, Cut(quality="medium", slice="expert"))


def test_a_cut_out_keeps_episodes_parent_references_and_tta(data: Dataset, tmp_path: Path) -> None:
    cut = cut_file(data, Cut(quality="medium"), tmp_path / "m.h5")
    assert cut.parent == data.content_hash
    assert cut.content_hash != data.content_hash
    assert cut.episodes.source is not None
    assert cut.episodes.source.tolist() == [4, 5, 6, 7, 20, 21, 22, 23]
    assert (cut.episodes.digest == data.episodes.digest[cut.episodes.source]).all()
    assert cut.tasks.ref_expert.tolist() == [5.0, 5.0]
    assert cut.spec_hash == data.spec_hash
    assert cut.tta["default"].digest.tobytes() == data.tta["default"].digest.tobytes()
    rewards = [open_tta_rewards(file.path, "default")[0] for file in (cut, data)]
    assert rewards[0].tobytes() == rewards[1].tobytes()
    assert set(cut.slices) == {"medium", "train", "test"}


def test_stats_of_a_cut_out_are_its_own(data: Dataset, tmp_path: Path) -> None:
    cut = cut_file(data, Cut(quality="expert"), tmp_path / "e.h5")
    assert cut.stats["returns"]["mean"].tolist() == [5.0]
    assert cut.stats["rewards"]["count"].tolist() == [8 * 5.0]


def test_tasks_that_are_not_chosen_go(data: Dataset, tmp_path: Path) -> None:
    cut = cut_file(data, Cut(tasks=("backward",)), tmp_path / "b.h5")
    assert cut.tasks.names == ("backward",)
    assert cut.tasks.indices == (1,)
    assert np.unique(cut.tta["default"].task).tolist() == [0]
    assert len(cut.tta["default"]) == 2
    assert cut.episode(0).goal.tolist() == [-1.0]


def test_a_test_task_without_episodes_stays_for_its_tta_set(data: Dataset, tmp_path: Path) -> None:
    """As in ml10.h5:train: adaptation needs the TTA set of a task and nothing else."""
    data = with_roles(data, [0, 1])
    object.__setattr__(data, "slices", {"train": np.arange(16)})
    cut = cut_file(data, Cut(slice="train"), tmp_path / "t.h5")
    assert cut.tasks.names == ("forward", "backward")
    assert cut.episodes.task.max() == 0
    assert len(cut.tta["default"]) == 4


def test_stats_without_train_tasks_are_inherited(data: Dataset, tmp_path: Path) -> None:
    data = with_roles(data, [0, 1])
    assert data.stats_info is not None
    object.__setattr__(data.stats_info, "tasks_seen", (0,))
    cut = cut_file(data, Cut(role="test"), tmp_path / "t.h5")
    assert cut.tasks.names == ("backward",)
    assert cut.stats_info is not None and cut.stats_info.tasks_seen == ()
    assert cut.stats["returns"]["mean"].tolist() == data.stats["returns"]["mean"].tolist()


def test_a_cut_out_may_only_replace_the_same_cut_out(data: Dataset, tmp_path: Path) -> None:
    target = tmp_path / "m.h5"
    cut_file(data, Cut(quality="medium"), target)
    with pytest.raises(DataError, match="by another rule"):
        cut_file(data, Cut(quality="expert"), target)
    few = cut_file(data, Cut(episodes=1), tmp_path / "few.h5")
    with pytest.raises(DataError, match="of other sources"):
        cut_file(few, Cut(quality="medium"), target)
    assert cut_file(data, Cut(quality="medium"), target).num_episodes > 0
    drop(data, tmp_path / "d.h5", [0])
    expert = cut_file(data, Cut(quality="expert"), tmp_path / "e.h5")
    merge([open_dataset(target), expert], tmp_path / "both.h5")
    for name, verb in (("d", "drop"), ("both", "merge")):
        with pytest.raises(DataError, match=f"made by {verb}"):
            cut_file(data, Cut(quality="medium"), tmp_path / f"{name}.h5")
    drop(data, tmp_path / "d.h5", [0])
    merge([open_dataset(target), expert], tmp_path / "both.h5")
    with pytest.raises(DataError, match="of other sources"):
        merge([expert, open_dataset(target)], tmp_path / "both.h5")
    before = data.path.read_bytes()
    with pytest.raises(DataError, match="replace another file"):
        cut_file(data, Cut(quality="medium"), data.path)
    shutil.copy(data.path, tmp_path / "other.h5")
    with pytest.raises(DataError, match="collected"):
        cut_file(data, Cut(quality="medium"), tmp_path / "other.h5")
    (tmp_path / "text.h5").write_text("precious")
    with pytest.raises(DataError, match="not an HDF5 file"):
        cut_file(data, Cut(quality="medium"), tmp_path / "text.h5")
    assert data.path.read_bytes() == before


def test_split_without_a_file_takes_every_family_file(tiny_file: Path) -> None:
    other = tiny_file.with_name("second.h5")
    shutil.copy(tiny_file, other)
    tiny_file.with_name("broken.h5").write_text("no")
    skipped: list[str] = []
    first = split(None, Cut(quality="medium"), on_skip=skipped.append)
    again = split(None, Cut(quality="medium"))  # the cut-outs are not cut again
    names = ["second-medium.h5", "tiny-medium.h5"]
    assert [one.path.name for one in first] == [one.path.name for one in again] == names
    assert [one.num_episodes for one in first] == [8, 8]
    assert [line.partition(":")[0] for line in skipped] == ["broken.h5"]
    found = sorted(path.name for path in tiny_file.parent.glob("*.h5"))
    assert found == sorted([*names, "broken.h5", "second.h5", "tiny.h5"])


def test_split_without_a_file_goes_on_behind_a_damaged_one(tiny_file: Path) -> None:
    other = tiny_file.with_name("second.h5")
    shutil.copy(tiny_file, other)
    with h5py.File(other) as file:
        at = file["steps/rewards"].id.get_offset()
        end = at + file["steps/rewards"].nbytes
    content = bytearray(other.read_bytes())
    content[at:end] = bytes(end - at)
    other.write_bytes(content)
    skipped: list[str] = []
    (one,) = split(None, Cut(quality="medium"), on_skip=skipped.append)
    assert one.path.name == "tiny-medium.h5" and "second.h5" in skipped[0]
    tiny_file.unlink()
    with pytest.raises(DataError, match=r"second\.h5"):
        split(None, Cut(quality="medium"))


def test_split_without_any_file_names_collect(workplace: Path) -> None:
    with pytest.raises(MissingFileError, match="no dataset file here") as caught:
        split(None, Cut(quality="medium"))
    assert "mpdt-data collect" in caught.value.hint


def test_split_per_task_and_default_names(tiny_file: Path) -> None:
    names = [one.path.name for one in split("tiny.h5", Cut(quality="medium"), per_task=True)]
    assert names == ["tiny-medium-forward.h5", "tiny-medium-backward.h5"]
    (one,) = split("tiny.h5:expert", Cut(tasks=("forward",), role="train", episodes=2))
    assert one.path.name == "tiny-expert-train-forward-2.h5"
    assert open_dataset(one.path).num_episodes == 2
    named = split("tiny.h5", Cut(), per_task=True, output=Path("out.h5"))
    assert [one.path.name for one in named] == ["out-forward.h5", "out-backward.h5"]


def test_split_by_name_adds_a_slice(tiny_file: Path) -> None:
    before = open_dataset(tiny_file).content_hash
    (one,) = split("tiny.h5", Cut(quality="expert", tasks=("forward",)), name="best")
    assert (one.path.name, one.slice, one.num_episodes) == ("tiny.h5", "best", 4)
    data = open_dataset(tiny_file)
    assert data.slices["best"].tolist() == [8, 9, 10, 11]
    assert data.slice_rules["best"] == {"quality": "expert", "tasks": ["forward"]}
    assert data.content_hash == before


@pytest.mark.parametrize(
    ("file", "cut", "options", "text"),
    [
        (None, Cut(quality="medium"), {"output": Path("x.h5")}, "-o needs to know which file"),
        ("tiny.h5", Cut(), {}, "nothing to cut by"),
        ("tiny.h5", Cut(quality="medium"), {"name": "a", "per_task": True}, "--name adds"),
        ("tiny.h5", Cut(quality="medium"), {"name": "a", "output": Path("x.h5")}, "--name adds"),
    ],
)
def test_options_that_do_not_go_together(
    tiny_file: Path, file: str | None, cut: Cut, options: dict[str, object], text: str
) -> None:
    with pytest.raises(UsageError, match=text):
        split(file, cut, **options)  # type: ignore[arg-type]


def test_the_best_share_is_rounded_up_and_of_equals_the_earlier(data: Dataset) -> None:
    """Four experts per task, all of return 5: 0.3 of four are two, 0.25 are one."""
    found = {
        share: choose(data, Cut(quality="expert", return_top=share)).tolist()
        for share in (0.25, 0.3, 0.5, 1.0)
    }
    assert found[0.25] == [8, 24]
    assert found[0.3] == found[0.5] == [8, 9, 24, 25]
    assert found[1.0] == [8, 9, 10, 11, 24, 25, 26, 27]


def test_nobody_is_told_to_delete_the_source(data: Dataset) -> None:
    with pytest.raises(DataError, match="found the source itself") as raised:
        cut_file(data, Cut(quality="medium"), data.path)
    assert "delete" not in raised.value.hint and data.path.exists()
