"""Several files read as one are the merged file: the twin of every public part is `merge`."""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from makers import make_episode, make_header, source_of, tta_source_of

import mpdt
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.slices.merge import merge
from mpdt.data.slices.several import one_ref
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.proof import BackgroundProof
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.store.rows import JoinedRows
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file
from mpdt.errors import DataError, FormatError, MissingFileError, StorageError, UsageError
from mpdt.seeding import UNKNOWN_SEED_KEY

ITS_OWN = {"path", "source", "seal", "parts"}
"""Of a file on the disk, which the joined one is not."""


def expect_equal(one: Any, two: Any, where: str = "") -> None:
    """Values, types and shapes, through dataclasses, mappings and sequences."""
    if is_dataclass(one):
        for name in {f.name for f in fields(two)} - ITS_OWN:
            expect_equal(getattr(one, name), getattr(two, name), f"{where}.{name}")
    elif isinstance(two, Mapping):
        assert set(one) == set(two), where
        for name in two:
            expect_equal(one[name], two[name], f"{where}[{name}]")
    elif isinstance(two, np.ndarray | JoinedRows):
        two = np.asarray(two)
        assert one.dtype == two.dtype and one.shape == two.shape, where
        assert np.asarray(one).tobytes() == two.tobytes(), where
    elif isinstance(two, Sequence) and not isinstance(two, str):
        assert len(one) == len(two), where
        for number, (left, right) in enumerate(zip(one, two, strict=True)):
            expect_equal(left, right, f"{where}[{number}]")
    else:
        assert (one == two or (one != one and two != two)) and type(one) is type(two), where


def expect_merged(parts: list[Path], target: Path) -> Dataset:
    """The joined dataset, compared with the merged file."""
    joined = mpdt.open(parts)
    merged = merge([open_dataset(part) for part in parts], target).dataset
    expect_equal(joined, merged)
    for i in range(merged.num_episodes):
        expect_equal(joined.episode(i), merged.episode(i))
    for name in merged.tta:
        expect_equal(open_tta_rewards(joined, name), open_tta_rewards(merged, name))
    for step in range(3):
        one, two = (mpdt.windows(d, window=3, per_task=5, seed=2) for d in (joined, merged))
        expect_equal(one.batch(step), two.batch(step))
    return joined


@pytest.fixture(autouse=True)
def no_plug_is_pulled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture(scope="module")
def cuts(collected: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """By quality, and of one task: three files with episodes in between each other's."""
    data, folder = open_dataset(collected), tmp_path_factory.mktemp("parts")
    rules = {"z": Cut(quality="random"), "b": Cut(quality="expert"), "a": Cut(tasks=("backward",))}
    return [cut_file(data, cut, folder / f"{name}.h5").path for name, cut in rules.items()]


@pytest.fixture
def parts(cuts: list[Path], tmp_path: Path) -> list[Path]:
    """Copies of them, to be changed."""
    folder = tmp_path / "parts"
    folder.mkdir()
    return [Path(shutil.copy(cut, folder)) for cut in cuts]


def test_twin_of_cut_outs(parts: list[Path], tmp_path: Path) -> None:
    joined = expect_merged(parts, tmp_path / "m.h5")
    # 4 random and 4 expert ones of forward, all 16 of backward; 8 of these are in two files
    assert joined.num_episodes == 24 and joined.stats["returns"]["count"] == 24
    assert joined.title == "z.h5,b.h5,a.h5"
    assert joined.num_bytes == sum(part.stat().st_size for part in parts)


def test_twin_of_collections_of_some_tasks(
    fakes: Callable[..., None], tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    found = []
    for task in ("forward", "backward"):
        job = make_job(msgspec.structs.replace(tiny_spec, tasks=(task,)))
        found.append(collect(job, tmp_path / f"{task}.h5", workers=0).dataset.path)
    expect_merged(found[::-1], tmp_path / "m.h5")


def written(path: Path, rows: list[int], x: int = 0, task: str = "forward", **fields: Any) -> Path:
    """Episodes of one task by hand, of two policies' goals, and a set of `x` more."""
    episodes = [make_episode(2 + i % 3, row=i, goal=np.array([float(i % 2)]),
                             success=fields.get("success")) for i in rows]  # fmt: skip
    drawn = [make_episode(3, quality=4, row=i, goal=np.array([9.0 - i]),
                          success=fields.get("success")) for i in range(x)]  # fmt: skip
    sets = {"x": tta_source_of(drawn, {0: 1.5}, {"scale": 1.0})} if x else {}
    header = make_header(episodes, [TaskRow(task, 0, "both", {})],
                         **({"spec": {"name": "m", "seed": 1}}
                            | fields.get("header", {})))  # fmt: skip
    return write_file(path, header, source_of(episodes), sets).path


def test_twin_by_hand_with_sets_goals_and_successes(tmp_path: Path) -> None:
    a = written(tmp_path / "a.h5", [1, 2, 5], x=1, success=True)
    b = written(tmp_path / "b.h5", [0, 2, 3, 4, 6], x=3, success=True)
    c = written(tmp_path / "c.h5", [7], success=True)
    for number, files in enumerate(([b, a], [c, a, b])):
        joined = expect_merged(files, tmp_path / f"m{number}.h5")
        assert len(joined.tta["x"]) == 3


def test_episodes_without_a_place_are_each_there_once(tmp_path: Path) -> None:
    def imported(name: str, firsts: list[float]) -> Path:
        episodes = [make_episode(2, first, seed_key=UNKNOWN_SEED_KEY) for first in firsts]
        header = make_header(episodes, spec={"name": "m", "seed": 1})
        return write_file(tmp_path / name, header, source_of(episodes)).path

    files = [imported("a.h5", [5.0, 1.0]), imported("b.h5", [1.0, 7.0])]
    joined = expect_merged(files, tmp_path / "m.h5")
    assert [joined.episode(i).observations[0, 0] for i in range(3)] == [5, 1, 7]


def test_lists_patterns_and_folders(parts: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    folder = parts[0].parent
    monkeypatch.chdir(folder.parent)
    by_name = mpdt.open(sorted(parts)).content_hash
    for ref in ("parts", "parts/*.h5", Path("parts"), ["parts/[ab].h5", "parts/z.h5"],
                "parts/a.h5,parts/b.h5,parts/z.h5"):  # fmt: skip
        assert mpdt.open(ref).content_hash == by_name, ref
    alone = mpdt.open(["parts/z.h5"])
    assert not alone.parts and alone.path == Path("parts/z.h5")
    expert = mpdt.windows("parts/*.h5:expert", per_task=2).batch(0)
    again = mpdt.windows(
        ["parts/a.h5:expert", "parts/b.h5:expert", "parts/z.h5:expert"], per_task=2
    )
    assert expert.observations.tobytes() == again.batch(0).observations.tobytes()
    Path("odd,name.h5").write_bytes(parts[0].read_bytes())
    assert not mpdt.open("odd,name.h5").parts
    with pytest.raises(UsageError, match="one slice is chosen of all files together"):
        one_ref(["parts/a.h5:expert", "parts/b.h5"])
    with pytest.raises(UsageError, match=r"odd,name.h5: a comma in its name"):
        one_ref(["odd,name.h5", "parts/b.h5"])
    with pytest.raises(UsageError, match="no file named"):
        mpdt.open([])
    with pytest.raises(MissingFileError, match=r"parts/\*\.hdf5: no file fits"):
        mpdt.open("parts/*.hdf5")
    Path("empty").mkdir()
    with pytest.raises(MissingFileError, match=r"empty: no \.h5 file in this folder"):
        mpdt.open("empty")
    with pytest.raises(MissingFileError, match=r"parts/c\.h5"):
        mpdt.open("parts/a.h5,parts/c.h5")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [({"window": 0}, "window="), ({"per_task": 10**12}, "per_task="), ({"seed": -1}, "seed="),
     ({"tasks": ("forward", "forward")}, "named twice")],
)  # fmt: skip
def test_windows_of_no_sense_are_refused_at_the_call(
    parts: list[Path], arguments: dict[str, Any], said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        mpdt.windows(parts[0], **arguments)
    with pytest.raises(TypeError):
        mpdt.windows(parts[0], window=2.5)  # type: ignore[arg-type]
    assert len(mpdt.windows(parts[0], tasks="forward").tasks) == 1
    with pytest.raises(UsageError, match="no file named"):
        mpdt.open("")


def test_none_of_the_files_is_left_out(parts: list[Path], tmp_path: Path) -> None:
    """A folder with something that is no file is not the folder without it."""
    folder = shutil.copytree(parts[0].parent, tmp_path / "d")
    mpdt.open(folder)
    (folder / "older").mkdir()
    mpdt.open(f"{folder}/*")
    dead, pipe = folder / "dead.h5", folder / "pipe.h5"
    dead.symlink_to("nowhere")
    for ref in (folder, f"{folder}/*.h5"):
        with pytest.raises(MissingFileError, match=r"dead\.h5: a link that leads nowhere"):
            mpdt.open(ref)
    dead.unlink()
    os.mkfifo(pipe)
    with pytest.raises(FormatError, match=r"pipe\.h5: a named pipe, not a file"):
        mpdt.open(folder)
    for word in (",", ",,"):
        with pytest.raises(MissingFileError, match="no such file"):
            mpdt.open(word)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"header": {"spec": {"name": "m", "seed": 2}}}, "not made for one file: seed 1 -> 2"),
        ({"header": {"family": "ant_dir"}}, "not made for one file: family"),
        ({"success": True}, "not made for one file: fields"),
        ({"header": {"version": "2.0.0"}}, r"two versions of hand-made; expected 1\.0\.0"),
        ({"task": "backward"}, r"task 0 is forward \(both\) and backward \(both\)"),
    ],
)
def test_refusals_name_both(tmp_path: Path, other: dict[str, Any], message: str) -> None:
    family = {"header": {"family": "unheard"}} if "task" in other else {}
    a = written(tmp_path / "a.h5", [0], **family)
    b = written(tmp_path / "b.h5", [1], **family | other)
    with pytest.raises(DataError, match=message) as caught:
        mpdt.open([a, b])
    assert "a.h5 and " in str(caught.value) and "b.h5" in str(caught.value)


def test_a_pickle_names_the_files(parts: list[Path]) -> None:
    joined = mpdt.open(parts)
    text = pickle.dumps(joined)
    assert len(text) < 4096
    expect_equal(pickle.loads(text), joined)
    parts[0].write_bytes(parts[1].read_bytes())
    with pytest.raises(StorageError, match="another file took its place"):
        pickle.loads(text)


def test_damage_is_found_in_the_file_that_has_it(parts: list[Path]) -> None:
    for part in parts[1:2]:
        whole = open_dataset(part)
        row = whole.episodes.obs_start[3]
        at = part.read_bytes().find(whole.steps.observations[row].tobytes())
        with part.open("r+b") as file:
            file.seek(at)
            file.write(b"\x01")
    joined = mpdt.open(parts)
    proof = BackgroundProof(joined, np.arange(joined.num_episodes))
    with pytest.raises(FormatError, match=r"b\.h5: episode 3 does not have the bytes") as caught:
        proof.finish()
    assert "mpdt-data drop" in caught.value.hint and "--episodes 3" in caught.value.hint
    forward = joined.select(task="forward", quality="random")
    BackgroundProof(joined, forward).finish()


def test_nothing_is_copied_on_opening(parts: list[Path]) -> None:
    joined = mpdt.open(parts)
    held = joined.episode(0).observations
    assert held.base is not None and not held.flags.owndata and not held.flags.writeable


def test_rows_read_as_an_array_does() -> None:
    """Every way of indexing, against the plain array of the same rows."""
    a, b = np.arange(20).reshape(10, 2), 100 + np.arange(12).reshape(6, 2)
    pieces = [(0, 4, 3), (0, 7, 1), (0, 1, 1), (1, 0, 2), (0, 0, 1), (1, 5, 1), (1, 5, 0)]
    rows = JoinedRows([a, b], *(np.array(one) for one in zip(*pieces, strict=True)))
    plain = np.concatenate([(a, b)[n][first : first + count] for n, first, count in pieces])
    keys: list[Any] = [0, -1, 4, slice(None), slice(2, 7), slice(6, 2), slice(None, None, 2),
                       slice(-3, None), np.array([[8, 0], [3, 3]]), plain[:, 0] > 90, ...,
                       (slice(1, 8), slice(1, 2)), (slice(None), 0), (np.array([5, 1]), 1),
                       np.array([-1, 2]), np.empty(0, int), slice(9, 20)]  # fmt: skip
    for key in keys:
        expect_equal(rows[key], plain[key], str(key))
    expect_equal(rows.take(np.array([7, 2])), plain.take([7, 2], axis=0))
    expect_equal(np.asarray(rows, np.float32), plain.astype(np.float32))
    assert [row.tolist() for row in rows] == plain.tolist()  # type: ignore[attr-defined]
    for wrong in (9, -10, np.array([0, 9])):
        with pytest.raises(IndexError):
            rows[wrong]
