"""Single checks of small changes: just beyond a bound, or where no other check looks."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from makers import make_episode, make_header, source_of, tta_source_of

from mpdt.data.store.writer import write_file
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify

from .damages import Apply, copy_episode, finding, outcomes


def test_episodes_that_share_only_their_ends_are_no_duplicates(change: Apply) -> None:
    """Same length, first and last row; the third observation of episode 1 is its own."""

    def alike(file: h5py.File) -> None:
        copy_episode(0, 1)(file)
        file["steps/observations"][8, 0] += 1

    report = verify(change(alike, seal=True), skip=["replay"])
    assert finding(report, "duplicates").outcome is Outcome.PASS


@pytest.mark.parametrize(
    ("horizon", "text"),
    [(4, "longer than the horizon of 4: ep"), (6, "truncated before the horizon: episodes 0, 1")],
)
def test_episodes_end_where_their_spec_says(change: Apply, horizon: int, text: str) -> None:
    """All have five steps."""

    def respec(file: h5py.File) -> None:
        spec = json.loads(file.attrs["spec"]) | {"horizon": horizon}
        file.attrs["spec"] = json.dumps(spec)

    assert text in finding(verify(change(respec), only=["flags"]), "flags").text


def test_a_change_that_no_digest_covers_breaks_the_seal(change: Apply) -> None:
    path = change(lambda file: file.attrs.modify("license", "MIT-0"), broken=True)
    found = finding(verify(path, only=["hash"]), "hash")
    assert found.outcome is Outcome.FAIL
    assert found.text == "the seal is broken: something outside the episodes was changed"


def test_a_preset_return_counts_as_it_was_typed(tmp_path: Path) -> None:
    """0.1 has no float32, which is what the file keeps; the hash of the set is that of 0.1."""
    episodes = [make_episode(2), make_episode(2, row=1)]
    asked = tta_source_of([make_episode(2, quality=4)], {0: 0.1}, {"action_scale": 1.0})
    data = write_file(tmp_path / "x.h5", make_header(episodes), source_of(episodes), {"x": asked})
    assert float(data.tta["x"].preset_return[0]) != 0.1
    assert finding(verify(data.path, only=["hash"]), "hash").outcome is Outcome.PASS


def test_equal_levels_are_in_no_order(change: Apply) -> None:
    path = change(lambda file: file["episodes/return"].__setitem__(slice(0, 8), 2.5))
    text = finding(verify(path, only=["quality"]), "quality").text
    assert "forward: random 2.5 is not below medium 2.5" in text


def test_a_return_of_no_number_is_the_sum_of_such_rewards(change: Apply) -> None:
    """`values` names it once; the sum is what is stored."""

    def unpaid(file: h5py.File) -> None:
        file["steps/rewards"][3] = file["episodes/return"][0] = np.nan

    assert outcomes(verify(change(unpaid), only=["returns"])) == set()


def test_our_own_file_that_lost_a_seed_is_damaged(change: Apply) -> None:
    path = change(lambda file: file["episodes/seed_key"].__setitem__(5, 4294967295))
    report = verify(path, only=["replay"], replay="all")
    assert outcomes(report) == {"replay"}
    assert "without a seed" in finding(report, "replay").text


def test_actions_that_avoid_the_middle_are_not_uniform(change: Apply) -> None:
    """Of mean 0, but three times as far from it."""

    def avoid(file: h5py.File) -> None:
        actions = file["tta/default/steps/actions"]
        actions[:] = np.where(np.arange(len(actions)) % 2, 0.99, -0.99)[:, None]

    text = finding(verify(change(avoid), only=["tta"]), "tta").text
    assert "spread of action component 0, 1, 2 is not that of uniform actions" in text
    assert "mean" not in text


def test_of_two_sets_of_one_rule_one_begins_the_other(change: Apply) -> None:
    def add(file: h5py.File) -> None:
        file.copy("tta/default", "tta/other")

    assert outcomes(verify(change(add), only=["tta"])) == set()
    path = change(lambda file: file["tta/other/episodes/digest"].__setitem__((0, 0), 1))
    assert "default and other have one rule, but" in finding(verify(path, only=["tta"]), "tta").text
