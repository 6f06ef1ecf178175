"""Every way to spoil a file is found by the check it belongs to, and by no other.

tiny.h5: task forward holds episodes 0-15 (random 0-3, medium 4-7, expert 8-11, history 12-15),
backward 16-31; five steps each, so episode i has steps 5i to 5i+4 and observations 6i to 6i+5.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import CHECKS, verify
from mpdt.errors import MissingFileError

from .damages import Apply, copy_episode, finding, flip, outcomes, pay, put, swap_tiers


def end_early(file: h5py.File) -> None:
    file["steps/terminations"][37] = True


def terminate_only(file: h5py.File) -> None:
    file["steps/truncations"][39], file["steps/terminations"][39] = False, True


def split_roles(file: h5py.File) -> None:
    """forward trains, backward is tested; nothing else says otherwise."""
    file["tasks/role"][:] = [0, 1]
    del file["stats"], file["slices"]


def share_with_test(file: h5py.File) -> None:
    split_roles(file)
    copy_episode(1, 17)(file)


def leak_stats(file: h5py.File) -> None:
    file["tasks/role"][:] = [0, 1]
    del file["slices"]


def leak_slice(file: h5py.File) -> None:
    file["tasks/role"][:] = [0, 1]
    del file["stats"]


def leak_other_slice(file: h5py.File) -> None:
    leak_slice(file)
    file.move("slices/train", "slices/mine")


def widen_set(file: h5py.File) -> None:
    actions = file["tta/default/steps/actions"][:]
    del file["tta/default/steps/actions"]
    file["tta/default/steps/actions"] = np.concatenate([actions, actions[:, :1]], axis=1)


def miscount(file: h5py.File) -> None:
    file["stats/rewards/count"][:] = 80


def order_slice(file: h5py.File) -> None:
    file["slices/expert"][1] = 8


def foreign_slice(file: h5py.File) -> None:
    file["slices/expert"].attrs["parent"] = "0" * 64


def reward_column(file: h5py.File) -> None:
    file["tta/default/steps/rewards"] = file["tta/default/sim_rewards"][:]


def quality_column(file: h5py.File) -> None:
    file["tta/default/episodes/quality"] = np.zeros(4, "<i1")


def another_order(file: h5py.File) -> None:
    keys = file["tta/default/episodes/seed_key"]
    keys[:2] = keys[:2][::-1]


def respec(file: h5py.File) -> None:
    file.attrs["spec"] = file.attrs["spec"].replace('"seed":7', '"seed":8')


@pytest.mark.parametrize(
    ("what", "seal", "id", "text"),
    [
        (flip, False, "hash", "other bytes than the digest says: episode 5"),
        (put("steps/rewards", 3, 9.0), False, "hash returns", "digest says: episode 0"),
        (put("tta/default/sim_rewards", 0, 9.0), False, "hash", "episode 0 of tta default"),
        (put("episodes/digest", 31, 7), False, "hash", "content hash does not fit"),
        (lambda f: f.attrs.modify("content_hash", "0" * 64), False, "hash", "does not fit"),
        (respec, False, "hash", "the spec hash does not fit the spec"),
        (lambda f: f["tta/default"].attrs.modify("content_hash", "0"), False, "hash", "of the set"),
        (put("steps/observations", (33, 4), np.nan), True, "values", "not finite: episode 5"),
        (put("steps/observations", (5, 0), np.inf), True, "values", "not finite: episode 0"),
        (put("tta/default/steps/observations", (6, 4), np.nan), True, "values", "1 of tta default"),
        (put("steps/actions", (41, 2), 1.01), True, "values", "outside [-1, 1]: episode 8"),
        (put("steps/actions", (159, 5), -1.01), True, "values", "outside [-1, 1]: episode 31"),
        (put("steps/truncations", 44, False), True, "flags", "no end flag on the last row: epis"),
        (end_early, True, "flags", "an end flag before the last row: episode 7"),
        (terminate_only, True, "flags", "not truncated at the horizon: episode 7"),
        (put("tta/default/steps/truncations", 4, False), True, "flags", "episode 0 of tta default"),
        (put("episodes/start", 3, 14), False, "shapes", "start leaves a gap or overlaps: epis"),
        (put("episodes/obs_start", 3, 19), False, "shapes", "obs_start leaves a gap or overlaps"),
        (put("episodes/length", 31, 6), False, "shapes", "160 steps for episodes that have 161"),
        (put("episodes/length", 2, 0), False, "shapes", "without a step: episode 2"),
        (put("episodes/task", 20, 2), False, "shapes", "task points outside its table of 2: ep"),
        (put("episodes/policy", 20, -1), False, "shapes", "policy points outside its table"),
        (put("goals/dim", 0, 9), False, "shapes", "/goals/dim points outside"),
        (widen_set, False, "shapes", "(20, 7) columns instead of (20, 6) (tta default)"),
        (put("tta/default/episodes/start", 1, 4), False, "shapes", "episode 1 of tta default"),
        (put("episodes/return", 9, 5.1), False, "returns", "is not the sum of the rewards: epis"),
        (put("episodes/success", 9, True), False, "returns", "success is not any of its steps"),
        (put("tasks/ref_expert", 1, np.nan), False, "returns", "reference expert unknown: backwar"),
        (swap_tiers, True, "quality", "forward: random 5.0 is not below medium 2.5"),
        (put("episodes/progress", 13, 1.5), True, "quality", "progress outside [0, 1]: episode 13"),
        (put("episodes/progress", 1, 0.5), True, "quality", "random with another progress"),
        (put("episodes/quality", 15, 7), True, "quality", "no such quality code: episode 15"),
        (share_with_test, True, "duplicates", "train and test share episodes (tasks forward, back"),
        (leak_stats, False, "leak", "statistics saw test tasks: backward"),
        (leak_slice, False, "leak", "slice train holds test tasks: episodes 16, 17, 18 and 13"),
        (leak_other_slice, False, "leak", "slice mine holds test tasks: episodes 16, 17, 18"),
        (miscount, False, "leak", "statistics of rewards are over 80 rows, their tasks have 160"),
        (order_slice, False, "leak", "slice expert has an id twice: episode 8"),
        (put("slices/expert", 0, 10), False, "leak", "slice expert is not ascending"),
        (put("slices/expert", 7, 32), False, "leak", "slice expert points outside the file: epis"),
        (foreign_slice, False, "leak", "slice expert was made for another file"),
        (reward_column, False, "format", "/tta/default/steps/rewards is no array of the format"),
        (quality_column, False, "format", "/tta/default/episodes/quality is no array of"),
        (put("tta/default/episodes/preset_return", 1, np.nan), False, "tta", "no preset return: e"),
        (put("tta/default/steps/actions", (6, 0), 1.5), True, "tta", "[-1, 1]: episode 1 of tta d"),
        (another_order, True, "tta replay", "not in the order of their seed keys: episode 1"),
        (put("tta/default/episodes/seed_key", (1, 4), 0), True, "tta", "seed keys: episode 1 of"),
        (pay, True, "replay", "other rewards when simulated again: episode 1"),
        (put("steps/actions", (7, 0), 0.5), True, "replay", "other rewards when simulated again"),
        (put("steps/observations", (7, 3), 0.5), True, "replay", "other observations when simul"),
        (put("goals/values", (0, 0), 0.5), True, "replay", "other rewards when simulated"),
        (put("episodes/seed_key", (1, 4), 77), True, "replay", "other observations when"),
    ],
)  # fmt: skip
def test_each_kind_of_damage_is_found_by_its_check(
    change: Apply, what: Callable[[h5py.File], None], seal: bool, id: str, text: str
) -> None:
    # Episodes that were spoilt on purpose are simulated again only where that is the point.
    path = change(what, seal)
    # What follows from the episodes no longer does: test_claims.py is about that.
    skip = ("claims",) if "replay" in id else ("claims", "replay")
    report = verify(path, replay="all", skip=skip)
    assert outcomes(report) == set(id.split())
    found = finding(report, id.split()[0])
    assert text in found.text
    assert found.hint.strip()
    if id == "shapes":
        assert outcomes(report, Outcome.PASS) == {"format"}
        assert outcomes(report, Outcome.SKIP) == set(CHECKS) - {
            "format",
            "shapes",
            "replay",
            "claims",
        }


def rewrite(name: str, **options: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        values = file[name][:]
        del file[name]
        dtype = options.pop("dtype", values.dtype)
        file.create_dataset(name, data=values.astype(dtype), **options)

    return change


@pytest.mark.parametrize(
    ("what", "text"),
    [
        (rewrite("steps/rewards", chunks=(16,)), "/steps/rewards is not contiguous"),
        (rewrite("tta/default/sim_rewards", chunks=(2,), compression="gzip"), "not contiguous"),
        (rewrite("steps/actions", dtype=">f4"), "wrong type; expected <f4; found >f4"),
        (rewrite("episodes/return", dtype="<f4"), "wrong type"),
        (lambda f: f.__delitem__("episodes/digest"), "dataset /episodes/digest is missing"),
        (lambda f: f.__delitem__("policies"), "group /policies is missing"),
        (lambda f: f.attrs.modify("format", "mpdt/2"), "another format version; expected mpdt/1"),
        (lambda f: f.attrs.modify("complete", 0), "incomplete: its writer was stopped"),
        (lambda f: f.attrs.modify("spec", "{no json"), "not JSON"),
        (lambda f: f.attrs.__delitem__("spec_hash"), "attribute 'spec_hash' of / is missing"),
        (
            lambda f: f["slices/train"].attrs.__delitem__("rule"),
            "attribute 'rule' of /slices/train",
        ),
    ],
)
def test_format(change: Apply, what: Callable[[h5py.File], None], text: str) -> None:
    report = verify(change(what))
    assert outcomes(report) == {"format"}
    assert outcomes(report, Outcome.SKIP) == set(CHECKS) - {"format"}
    assert text in finding(report, "format").text
    assert finding(report, "format").hint
    assert report.content_hash == ""


def test_misaligned_steps(tiny: Path) -> None:
    with h5py.File(tiny, "r+") as file:  # without the writer's alignment
        file["odd"] = np.zeros(3, np.int8)
        file["new"] = file["steps/rewards"][:]
        del file["steps/rewards"]
        file.move("new", "steps/rewards")
        del file["odd"]
        assert file["steps/rewards"].id.get_offset() % 64
    assert "no multiple of 64" in finding(verify(tiny), "format").text


def test_what_is_no_such_file(tiny: Path, tmp_path: Path) -> None:
    for size in (0, 100, tiny.stat().st_size - 500):
        (tmp_path / "x.h5").write_bytes(tiny.read_bytes()[:size])
        assert outcomes(verify(tmp_path / "x.h5")) == {"format"}
    with pytest.raises(MissingFileError):
        verify(tmp_path / "none.h5")


@pytest.mark.parametrize("column", ["steps/rewards", "episodes/quality", "goals/dim"])
def test_columns_of_other_lengths_are_a_matter_of_shapes(change: Apply, column: str) -> None:
    def shorten(file: h5py.File) -> None:
        values = file[column][:-1]
        del file[column]
        file[column] = values

    report = verify(change(shorten))
    assert outcomes(report) == {"shapes"}
    assert "disagree in length" in finding(report, "shapes").text
