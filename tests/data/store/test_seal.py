"""The seal: any change outside the episodes is found, none inside them is the seal's business."""

from __future__ import annotations

from collections.abc import Callable

import h5py
import numpy as np
import pytest

from mpdt.data.store.amend import add_slice
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.store.seal import check_seal, seal, seal_of
from mpdt.data.store.tree import Tree
from mpdt.errors import FormatError

CHANGES: dict[str, Callable[[h5py.File], None]] = {
    "a number of a table": lambda f: f["tasks/ref_random"].write_direct(np.array([7.0, -1.0])),
    "a bit of a number": lambda f: _flip(f["goals/values"]),
    "a name": lambda f: f["policies/name"].__setitem__(0, "other"),
    "a letter from one name to the next": lambda f: _shift(f["tasks/name"]),
    "an attribute like one of the root": lambda f: f["tasks"].attrs.__setitem__("complete", 1),
    "a version": lambda f: f.attrs.__setitem__("version", "9.0.0"),
    "a licence": lambda f: f.attrs.__setitem__("license", "x"),
    "an attribute of a column": lambda f: f["episodes/quality"].attrs.__setitem__("codes", "{}"),
    "another attribute": lambda f: f["steps"].attrs.__setitem__("note", "x"),
    "another array": lambda f: f.create_dataset("extra", data=np.zeros(1)) and None,
    "an array less": lambda f: f["episodes"].__delitem__("progress"),
    "the type of a step array": lambda f: _retype(f, "steps/rewards"),
}


def _flip(array: h5py.Dataset) -> None:
    values = array[()]
    values.view(np.uint8).reshape(-1)[0] ^= 1
    array[...] = values


def _shift(array: h5py.Dataset) -> None:
    one, two = array[:2]
    array[0], array[1] = one + two[:1], two[1:]


def _retype(file: h5py.File, name: str) -> None:
    values = file[name][()]
    del file[name]
    file[name] = values.astype(np.float64)


@pytest.mark.parametrize("change", CHANGES)
def test_every_change_outside_the_episodes_breaks_it(made, change):
    with h5py.File(made.path, "r+") as file:
        check_seal(Tree(file, str(made.path)), made.path)
        CHANGES[change](file)
        with pytest.raises(FormatError, match="the seal is broken"):
            check_seal(Tree(file, str(made.path)), made.path)


def test_the_episodes_have_digests_of_their_own(made):
    with h5py.File(made.path, "r+") as file:
        before = seal_of(file)
        _flip(file["steps/observations"])
        assert seal_of(file) == before


def test_a_new_slice_is_sealed_and_changes_no_content(made):
    before = made.content_hash
    with h5py.File(made.path) as file:
        old = seal_of(file)
    assert add_slice(made.path, "one", [0], {"by": "hand"}).content_hash == before
    with h5py.File(made.path) as file:
        check_seal(Tree(file, str(made.path)), made.path)
        assert seal_of(file) != old


def test_nothing_is_added_over_damage(made):
    with h5py.File(made.path, "r+") as file:
        file["tasks/ref_random"][0] = 5.0
    damaged = made.path.read_bytes()
    with pytest.raises(FormatError, match="the seal is broken"):
        add_slice(made.path, "one", [0], {})
    assert made.path.read_bytes() == damaged


def test_nothing_is_believed_without_it(made):
    with h5py.File(made.path, "r+") as file:
        file["tasks/ref_random"][0] = 5.0
    for look in (open_dataset, lambda path: open_tta_rewards(path, "default")):
        with pytest.raises(FormatError, match="the seal is broken"):
            look(made.path)
    with h5py.File(made.path, "r+") as file:
        seal(file)
    assert open_dataset(made.path).tasks.ref_random[0] == 5.0
