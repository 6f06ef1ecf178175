"""No command passes damage on: what is copied, amended or trained on has its digest's bytes."""

from __future__ import annotations

import ast
from pathlib import Path

import h5py
import numpy as np
import pytest

import mpdt
from mpdt.data.exchange import formats
from mpdt.data.exchange.selection import Selection
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.slices.drop import drop
from mpdt.data.slices.merge import merge
from mpdt.data.store.amend import add_slice, add_tta
from mpdt.data.store.proof import BackgroundProof, check_digests, proven, proven_tta
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.store.seal import seal
from mpdt.errors import FormatError

PACKAGE = Path(mpdt.__file__).parent


def rot(path: Path, name: str, row: int = 0) -> None:
    """One bit of a stored number, as a disk loses it."""
    with h5py.File(path) as file:
        array = file[name]
        at = array.id.get_offset() + array.dtype.itemsize * row * int(np.prod(array.shape[1:]))
    data = bytearray(path.read_bytes())
    data[at] ^= 4
    path.unlink()  # another file: a map of the old one keeps the old bytes
    path.write_bytes(data)


@pytest.mark.parametrize("name", ["observations", "actions", "rewards"])
def test_proven(made, name):
    rot(made.path, f"steps/{name}", 3 if name != "observations" else 5)  # episode 2 of 4
    data = open_dataset(made.path)
    for i in (0, 1, 3):
        np.testing.assert_array_equal(proven(data, i).rewards, made.episode(i).rewards)
        assert not isinstance(proven(data, i).observations, np.memmap)
    with pytest.raises(FormatError, match="episode 2 does not have the bytes of its digest") as e:
        proven(data, 2)
    assert "mpdt-data drop" in e.value.hint and "--episodes 2" in e.value.hint
    with pytest.raises(FormatError, match="episode 2 does"):
        check_digests(data)
    check_digests(data, ids=np.array([0, 1, 3]))
    assert len(list(proven_tta(data, "default"))) == 3


def test_the_simulators_rewards_are_part_of_a_set(made):
    with h5py.File(made.path, "r+") as file:
        file["tta/default/sim_rewards"][2] = 7.0  # sealed again, as a program would
        seal(file)
    data = open_dataset(made.path)
    check_digests(data)
    for look in (lambda: list(proven_tta(data, "default")),
                 lambda: check_digests(data, sets=["default"])):  # fmt: skip
        with pytest.raises(FormatError, match="episode 1 of the TTA set 'default' does not"):
            look()


def test_what_was_opened_is_what_is_read(made, kit, tmp_path):
    """Not steps of the file that was opened beside rewards of the one that replaced it."""
    path, wanted = made.path, np.array(open_tta_rewards(made, "default")[0])
    moved = path.with_name("old.h5")
    path.rename(moved)
    path.write_bytes(moved.read_bytes())
    with h5py.File(path, "r+") as file:
        file["tta/default/sim_rewards"][2] = 7.0
        seal(file)
    cut = cut_file(made, Cut(episodes=1), tmp_path / "cut.h5")
    np.testing.assert_array_equal(open_tta_rewards(cut, "default")[0], wanted)
    check_digests(cut, sets=["default"])


@pytest.fixture
def tiny(collected: Path, tmp_path: Path) -> Path:
    path = tmp_path / "rotten.h5"
    path.write_bytes(collected.read_bytes())
    rot(path, "steps/rewards", 8 * 5 + 1)  # episode 8, expert
    return path


COMMANDS = {
    "cut": lambda data, to: cut_file(data, Cut(quality="expert"), to),
    "drop": lambda data, to: drop(data, to, [0]),
    "merge": lambda data, to: merge([data, data], to),
    "slice": lambda data, to: add_slice(data.path, "x", [0], {}),
    **{
        name: lambda data, to, name=name: formats.write(
            name, Selection(data, np.arange(data.num_episodes)), to
        )
        for name, known in formats.FORMATS.items()
        if known.write
    },
    "minari --link": lambda data, to: formats.write(
        "minari", Selection(data, np.arange(data.num_episodes)), to, link=True
    ),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_nothing_copies_damage(tiny, tmp_path, command):
    before = tiny.read_bytes()
    with pytest.raises(FormatError, match="episode 8 does not have the bytes of its digest"):
        COMMANDS[command](open_dataset(tiny), tmp_path / "out")
    assert not list(tmp_path.glob("out*")) and tiny.read_bytes() == before


def test_what_is_whole_can_still_be_taken_out(tiny, tmp_path):
    data = open_dataset(tiny)
    assert drop(data, tmp_path / "rest.h5", [8]).num_episodes == data.num_episodes - 1
    assert cut_file(data, Cut(quality="medium"), tmp_path / "medium.h5").num_episodes == 8


def test_a_damaged_set_can_be_replaced_and_nothing_else_be_added(made, kit):
    rot(made.path, "tta/default/steps/actions")
    with pytest.raises(FormatError, match="of the TTA set 'default'"):
        add_tta(made.path, "other", kit.tta())
    with pytest.raises(FormatError, match="of the TTA set 'default'"):
        add_slice(made.path, "x", [0], {})
    assert len(list(proven_tta(add_tta(made.path, "default", kit.tta()), "default"))) == 3


def test_background_proof_names_what_is_damaged(made):
    BackgroundProof(made, np.arange(4), ["default"]).finish()
    rot(made.path, "steps/rewards", 3)
    data = open_dataset(made.path)
    proof = BackgroundProof(data, np.array([0, 1, 3]))
    proof.finish()
    proof = BackgroundProof(data, np.array([1, 2]))
    with pytest.raises(FormatError, match="episode 2 does"):
        proof.finish()
    with pytest.raises(FormatError, match="episode 2 does"):
        proof.check()
    proof.stop()


def test_copies_are_asked_for_in_one_place():
    """Exports and slices take episodes through `proven`; a view of the file is for looking."""
    found = []
    fine = ("selection", "table", "stored")  # the last is Minari's own file, proved by nobody
    for folder in ("data/exchange", "data/slices"):
        for path in sorted((PACKAGE / folder).glob("*.py")):
            if path.name == "diff.py":  # copies nothing
                continue
            for call in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
                    owner = ast.unparse(call.func.value)
                    if call.func.attr == "episode" and owner not in fine:
                        found.append(f"{path.name}:{call.lineno} {owner}.episode")
    assert not found
