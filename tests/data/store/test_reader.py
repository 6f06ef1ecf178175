"""Opening: maps equal what h5py reads, and every wrong file gets one clear error."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import h5py
import numpy as np
import pytest
from own_families import TASKS, line

from mpdt.data.spec.family import definition
from mpdt.data.spec.tasks import Task
from mpdt.data.store import layout
from mpdt.data.store.reader import open_dataset, open_tta_rewards, parse_ref
from mpdt.data.store.seal import seal
from mpdt.data.store.tables import Stats
from mpdt.data.store.writer import write_file, write_stats
from mpdt.errors import FormatError, MissingFileError, UsageError

STEPS = ("observations", "actions", "rewards", "terminations", "truncations")


def test_maps_equal_h5py_and_ram(made):
    loaded = open_dataset(made.path, preload=True)
    with h5py.File(made.path) as file:
        for name in STEPS:
            mapped, copied = getattr(made.steps, name), getattr(loaded.steps, name)
            assert isinstance(mapped, np.memmap)
            assert not isinstance(copied, np.memmap)
            np.testing.assert_array_equal(mapped, file["steps"][name][()])
            np.testing.assert_array_equal(copied, mapped)
            assert mapped.dtype == copied.dtype
            assert mapped.ctypes.data % mapped.dtype.itemsize == 0
    assert made.steps.successes is None


def test_maps_cannot_be_written(made):
    with pytest.raises(ValueError, match="read-only"):
        made.steps.rewards[0] = 1.0


def test_no_hdf5_object_stays_open(made):
    kinds = h5py.h5f.OBJ_FILE | h5py.h5f.OBJ_DATASET | h5py.h5f.OBJ_GROUP
    assert h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, kinds) == 0
    with h5py.File(made.path, "r+"):  # refused while HDF5 itself still reads the file
        pass


def test_a_dataset_crosses_processes(made):
    again = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(again.steps.rewards, made.steps.rewards)
    assert again.content_hash == made.content_hash


def test_misaligned_arrays_are_read_into_memory_with_one_warning(made):
    before = np.array(made.steps.observations)  # a map would show the change made below
    with h5py.File(made.path, "r+") as file:  # without the writer's alignment
        file["odd"] = np.zeros(3, np.int8)
        names = ("observations", "rewards")
        for name in names:
            file[name] = file["steps"][name][()]
            assert file[name].id.get_offset() % 4
        for name in names:
            del file["steps"][name]
            file.move(name, f"steps/{name}")
        del file["odd"]
    with pytest.warns(UserWarning, match="/steps/observations is misaligned") as caught:
        again = open_dataset(made.path)
    assert len(caught) == 1
    assert not isinstance(again.steps.rewards, np.memmap)
    np.testing.assert_array_equal(again.steps.observations, before)


def test_select(made):
    assert made.select().tolist() == [0, 1, 2, 3]
    assert made.select(task="forward").tolist() == [0, 1, 2]
    assert made.select(task=1).tolist() == [3]
    assert made.select(task=["forward", 1], quality="random").tolist() == [0, 1, 3]
    assert made.select(quality=["medium", "expert"]).tolist() == [2]
    for wrong in (
        {"task": "forwrd"},
        {"task": 2},
        {"task": -1},
        {"quality": "exprt"},
        {"slice": "train"},
    ):
        with pytest.raises(UsageError, match="unknown"):
            made.select(**wrong)
    for outside in (4, -1):
        with pytest.raises(UsageError, match=f"no episode {outside}; expected 0 to 3"):
            made.episode(outside)


def test_parse_ref(tmp_path):
    (tmp_path / "a:b").touch()
    for text, path, name in [
        ("a.h5", "a.h5", None),
        ("a.h5:train", "a.h5", "train"),
        ("/x:y/a.h5", "/x:y/a.h5", None),
        ("C:\\data\\a.h5", "C:\\data\\a.h5", None),
        (f"{tmp_path}/a:b", f"{tmp_path}/a:b", None),
        (f"{tmp_path}/a:b:train", f"{tmp_path}/a:b", "train"),
    ]:
        found = parse_ref(text)
        assert (str(found[0]), found[1]) == (path, name)
    for text in ("", ":train", "a.h5:"):
        with pytest.raises(UsageError, match="expected FILE or FILE:slice"):
            parse_ref(text)


def test_a_missing_file_says_how_to_make_it(tmp_path):
    path = tmp_path / "cheetah_dir.h5"
    with pytest.raises(MissingFileError, match="no such file") as caught:
        open_dataset(path)
    assert caught.value.hint == f"mpdt-data collect cheetah_dir -o {path}"


def test_a_damaged_file_says_how_to_make_it_again(tmp_path):
    path = tmp_path / "ml10.h5"
    path.write_text("text")
    with pytest.raises(FormatError) as caught:
        open_dataset(path)
    assert caught.value.hint == (
        f"copy it again, or move it away and make it again: mpdt-data collect ml10 -o {path}"
    )


def test_files_that_are_not_ours(tmp_path):
    text, foreign = tmp_path / "a.txt", tmp_path / "b.h5"
    text.write_text("hello", encoding="utf-8")
    with h5py.File(foreign, "w") as file:
        file["steps/observations"] = np.zeros(3)
    with pytest.raises(FormatError, match="not an HDF5 file"):
        open_dataset(text)
    with pytest.raises(FormatError, match="an HDF5 file, but not one of mpdt"):
        open_dataset(foreign)
    with pytest.raises(FormatError, match="a folder, not a file"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
def test_truncated_files(made, share):
    data = made.path.read_bytes()
    made.path.unlink()
    made.path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(FormatError, match="truncated or damaged"):
        open_dataset(made.path)


def amend(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def delete(name):
    def change(file):
        del file[name]

    return change


def attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def put(name, row, value):
    return lambda file: file[name].__setitem__(row, value)


def retype(name, values):
    def change(file):
        del file[name]
        file[name] = values

    return change


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (attribute("format", "mpdt/2"), "another format version; expected mpdt/1, found mpdt/2"),
        (lambda file: file.attrs.__delitem__("complete"), "incomplete"),
        (attribute("complete", 0), "incomplete"),
        (delete("steps/rewards"), "dataset /steps/rewards is missing"),
        (delete("episodes/digest"), "dataset /episodes/digest is missing"),
        (delete("goals"), "group /goals is missing"),
        (delete("tta/default/episodes/preset_return"), "preset_return is missing"),
        (lambda file: file.attrs.__delitem__("family"), "attribute 'family' of / is missing"),
        (attribute("spec", "{"), "not JSON"),
        (attribute("spec", "[]"), "not a JSON object"),
        (attribute("name", np.bytes_(b"\xff")), "damaged; found UnicodeDecodeError"),
        (attribute("complete", "yes"), "incomplete"),
        (attribute("complete", [1]), "incomplete"),
        (attribute("name", np.arange(3)), "attribute 'name' of / is not text; found array"),
        (attribute("name", 5), "attribute 'name' of / is not text"),
        (attribute("license", np.zeros(0)), "attribute 'license' of / is not text"),
        (attribute("spec", 1.5), "attribute 'spec' of / is not text"),
        (attribute("lineage", "{}"), "its lineage is not as the format has it"),
        (
            attribute("lineage", '{"steps": [{"verb": 1, "from": []}]}'),
            "Expected `str`, got `int` - at `$[0].verb`",
        ),
        (
            attribute("lineage", '{"steps": [{"verb": "drop", "from": "abc"}]}'),
            "Expected `array`, got `str` - at `$[0].from`",
        ),
        (put("tasks/ref_zero_source", 1, "x"), "/tasks/ref_zero_source is no word of the format"),
        (put("episodes/return", 1, np.nan), "/episodes/return holds what is no number"),
        (put("tta/default/episodes/preset_return", 0, np.nan), "preset_return holds what is no n"),
        (put("policies/level", 1, np.inf), "/policies/level holds what is no number"),
        (put("tasks/ref_expert_error", 1, -np.inf), "/tasks/ref_expert of backward holds what"),
        (put("tasks/role", 1, 3), "/tasks/role points outside its table"),
        (retype("steps/rewards", np.zeros(7)), "/steps/rewards has the wrong type; expected <f4"),
        (retype("steps/rewards", np.zeros(6, "<f4")), "/steps/rewards has the wrong shape"),
        (retype("tasks/name", np.zeros(2)), "/tasks/name has the wrong type; expected str"),
        (put("episodes/start", 2, 4), "start leaves a gap or overlaps at episode 2; expected 3"),
        (put("episodes/obs_start", 1, 1), "obs_start leaves a gap or overlaps at episode 1"),
        (put("episodes/length", 0, 0), "episodes without a step"),
        (put("episodes/length", 3, 2), "does not cover the actions; expected 8 rows, found 7"),
        (put("episodes/task", 0, 2), "/episodes/task points outside its table"),
        (put("episodes/policy", 0, -1), "/episodes/policy points outside its table"),
        (put("goals/dim", 0, 2), "/goals/dim points outside its table"),
        (put("episodes/digest", (0, 0), 0), "content hash does not fit"),
        (attribute("content_hash", "0" * 64), "content hash does not fit"),
        (attribute("family", "ant_dir"), "content hash does not fit"),
        (put("tta/default/episodes/start", 1, 1), "/tta/default/episodes/start leaves a gap"),
    ],
)
def test_damaged_files_get_one_clear_error(made, change, what):
    amend(made.path, change)
    with pytest.raises(FormatError) as caught:
        open_dataset(made.path)
    assert what in str(caught.value)
    assert "hand-made.h5" in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "what"),
    [({"tasks": 3}, "no definition of a family"), ({"horizon": 0}, "horizon: ")],
)
def test_a_definition_that_nobody_writes(made, changes, what):
    amend(made.path, attribute("definition", json.dumps(definition(line()) | changes)))
    with pytest.raises(FormatError, match=f"definition of the family is not as.*found {what}"):
        open_dataset(made.path)


def test_a_definition_too_long_for_an_attribute(kit, tmp_path):
    """It is a data set of the file then, like any long text."""
    more = (Task(f"task-{i}", i, "train", (float(i),)) for i in range(3, 1000))
    told = definition(line(tasks=(*TASKS, *more)))
    header = replace(kit.header, family="line", definition=told)
    path = write_file(tmp_path / "long.h5", header, kit.source()).path
    with h5py.File(path) as file:
        assert "definition" in file and "definition" not in file.attrs
    assert open_dataset(path).definition == told


def test_text_that_is_no_text(made):
    """h5py reads such an attribute without a word; the first print of it would fail."""
    content = made.path.read_bytes()
    made.path.unlink()
    made.path.write_bytes(content.replace(b"CC0-1.0", b"\xffC0-1.0"))
    with pytest.raises(FormatError, match="damaged; found UnicodeDecodeError"):
        open_dataset(made.path)


def test_bad_slices(made):
    amend(made.path, put_slice([1, 1]))
    with pytest.raises(FormatError, match="/slices/x is not ascending"):
        open_dataset(made.path)
    amend(made.path, put("slices/x", 1, 4))
    with pytest.raises(FormatError, match="/slices/x points outside its table"):
        open_dataset(made.path)


def put_slice(ids):
    def change(file):
        file["slices/x"] = np.array(ids)
        file["slices/x"].attrs["rule"] = "{}"

    return change


def test_statistics_of_test_tasks_are_refused(made):
    widths = {"observations": 2, "actions": 1, "rewards": 1, "returns": 1}
    fields = {f: {s: np.zeros(n) for s in layout.STATS} for f, n in widths.items()}
    path = made.path

    def change(file):
        write_stats(file, Stats(fields, "", (0, 1), {}))
        seal(file)

    amend(path, change)
    assert open_dataset(path).stats_info.tasks_seen == (0, 1)  # role both: they are training tasks
    amend(path, put("tasks/role", 1, 1))
    with pytest.raises(FormatError, match="statistics saw test tasks; found backward"):
        open_dataset(path)
    for key, value in (("constant", '{"x": "ab"}'), ("tasks_seen", b"01"), ("tasks_seen", [0.5])):
        amend(path, lambda file, k=key, v=value: file["stats"].attrs.__setitem__(k, v))
        with pytest.raises(FormatError, match=f"{key}.* is not"):
            open_dataset(path)


def test_tta_sets_carry_no_reward(made):
    tta = made.tta["default"]
    assert not [name for name in vars(tta) if "reward" in name or "success" in name]
    rewards, successes = open_tta_rewards(made.path, "default")
    assert (rewards.tolist(), successes) == ([1, 2, 1, 1], None)
    with pytest.raises(UsageError, match="unknown TTA set 'defalt'"):
        open_tta_rewards(made.path, "defalt")
