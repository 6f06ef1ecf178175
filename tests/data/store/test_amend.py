"""Slices and TTA sets are added by a changed copy; the episodes stay what they are."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from mpdt.data.store.amend import add_slice, add_tta
from mpdt.data.store.digest import episode_digest
from mpdt.data.store.inherit import episodes_of, header_of, tta_of
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.store.ttaset import tta_episodes, unlabelled
from mpdt.data.store.writer import TtaSource, check_digests, write_file
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, UsageError


def test_slices_are_added_and_replaced(made):
    first = add_slice(made.path, "few", [0, 3], {"episodes": 2})
    again = add_slice(made.path, "few", np.array([2]), {"episodes": 1})
    assert first.slices["few"].tolist() == [0, 3]
    assert again.slices["few"].tolist() == [2]
    assert again.slice_rules["few"] == {"episodes": 1}
    assert again.select(slice="few", quality="expert").tolist() == [2]
    assert first.select(slice="few", task="backward").tolist() == [3]
    assert again.content_hash == made.content_hash
    with h5py.File(made.path) as file:
        assert file["slices/few"].attrs["parent"] == made.content_hash


def test_the_same_slice_again_leaves_every_byte(made):
    add_slice(made.path, "few", [0, 3], {"episodes": 2})
    before = made.path.read_bytes()
    assert add_slice(made.path, "few", [0, 3], {"episodes": 2}).slices["few"].tolist() == [0, 3]
    assert made.path.read_bytes() == before
    assert add_slice(made.path, "few", [0, 3], {"top": 1}).slice_rules["few"] == {"top": 1}


@pytest.mark.parametrize("ids", [[3, 0], [0, 0], [4], [-1], [[0]]])
def test_slices_need_ascending_ids_inside_the_file(made, ids):
    before = made.path.read_bytes()
    with pytest.raises(DataError, match="ascending episode ids"):
        add_slice(made.path, "few", ids, {})
    assert made.path.read_bytes() == before


@pytest.mark.parametrize("name", ["", "a/b", "a:b", "..", "ä"])
def test_slice_names_fit_hdf5_and_the_command_line(made, name):
    with pytest.raises(UsageError, match="cannot be a name"):
        add_slice(made.path, name, [0], {})


def test_tta_columns_by_hand(made):
    tta = made.tta["default"]
    assert (tta.name, tta.rule) == ("default", {"action_scale": 3.0})
    assert tta.task.tolist() == [0, 0, 1]
    assert tta.goal.tolist() == [0, 0, 2]
    assert (tta.start.tolist(), tta.obs_start.tolist()) == ([0, 2, 3], [0, 3, 5])
    assert tta.length.tolist() == [2, 1, 1]
    assert tta.preset_return.tolist() == [1500, 1500, 0.25]
    assert tta.observations[5:].tolist() == [[700, 701], [702, 703]]
    assert tta.actions.ravel().tolist() == [-500, -501, -600, -700]
    assert tta.seed_key.tolist()[1] == [0, 0, 4, 0, 1]
    assert isinstance(tta.observations, np.memmap)


def test_sets_are_nested(made):
    tta = made.tta["default"]
    assert tta.of_task(0).tolist() == [0, 1]
    assert tta.of_task(0, episodes=1).tolist() == [0]
    assert tta.of_task(1, episodes=5).tolist() == [2]


def test_tta_digests_fit_what_the_simulator_said(made, kit):
    rewards, successes = open_tta_rewards(made.path, "default")
    episodes = list(tta_episodes(made, "default", rewards, successes))
    for i, (episode, source) in enumerate(zip(episodes, kit.tta().episodes, strict=True)):
        digest = made.tta["default"].digest[i].tobytes()
        name = made.tasks.names[episode.task]
        assert episode_digest(episode, name) == digest == episode_digest(unlabelled(source), name)


def test_tta_sets_are_added_beside_and_over_others(made, kit):
    wide = kit.tta()
    moved = tuple(replace(e, goal=np.array([9.0])) for e in wide.episodes)
    added = add_tta(made.path, "wide", replace(wide, episodes=moved))
    assert list(added.tta) == ["default", "wide"]
    assert added.content_hash == made.content_hash
    assert added.goals.of(int(added.tta["wide"].goal[0])).tolist() == [9.0]
    check_digests(added)  # the older rows of /goals did not move
    same = add_tta(made.path, "wide", kit.tta())
    assert same.tta["wide"].content_hash == made.tta["default"].content_hash
    assert same.tta["wide"].content_hash != added.tta["wide"].content_hash


def test_preset_and_rule_are_part_of_the_set(made, kit):
    hashes = {made.tta["default"].content_hash}
    for change in ({"preset_returns": {0: 1.0, 1: 1.0}}, {"rule": {}}):
        added = add_tta(made.path, "x", replace(kit.tta(), **change))
        hashes.add(added.tta["x"].content_hash)
    assert len(hashes) == 3


def test_a_preset_that_no_float32_is_is_found_again(made, kit):
    """0.1 counts as it was typed, though the file keeps what is next to it."""
    added = add_tta(made.path, "x", replace(kit.tta(), preset_returns={0: 0.1, 1: 1.0}))
    (finding,) = verify(added.path, only=("hash",)).findings
    assert finding.outcome is Outcome.PASS, finding


def test_tta_needs_a_preset_per_task(made, kit):
    with pytest.raises(DataError, match="no preset return for task 'backward'"):
        add_tta(made.path, "x", replace(kit.tta(), preset_returns={0: 1.0}))
    assert list(open_dataset(made.path).tta) == ["default"]
    empty = TtaSource((), 0, 0, {})
    assert len(add_tta(made.path, "none", empty).tta["none"]) == 0


def test_a_cut_out_file_inherits(made, tmp_path):
    """Task `backward` alone: episode 3 becomes 0, and so does its TTA episode 2."""
    ids = made.select(task="backward")
    cut = write_file(tmp_path / "cut.h5", header_of(made, rows=[1]), episodes_of(made, ids),
                     {"default": tta_of(made, "default", rows=[1])})  # fmt: skip
    assert (cut.parent, cut.episodes.source.tolist()) == (made.content_hash, [3])
    assert (cut.tasks.names, cut.tasks.indices) == (("backward",), (1,))
    assert cut.tasks.ref_expert.tolist() == [9.0]
    assert (cut.spec_hash, cut.packages) == (made.spec_hash, made.packages)
    assert [policy.task for policy in cut.policy_infos()] == [1]
    assert cut.episodes.digest.tolist() == made.episodes.digest[[3]].tolist()
    tta = cut.tta["default"]
    assert tta.digest.tolist() == made.tta["default"].digest[[2]].tolist()
    assert (tta.preset_return.tolist(), tta.rule) == ([0.25], {"action_scale": 3.0})
    whole = write_file(tmp_path / "all.h5", header_of(made), episodes_of(made, made.select()),
                       {"default": tta_of(made, "default")})  # fmt: skip
    assert whole.content_hash == made.content_hash
    assert whole.tta["default"].content_hash == made.tta["default"].content_hash
