"""What verify says beside damage: doubts, the lock, replays, and which checks are chosen.

tiny.h5: task forward holds episodes 0-15 (random 0-3, medium 4-7, expert 8-11, history 12-15),
backward 16-31; five steps each.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.lock.file import lock_bytes, read_lock
from mpdt.data.lock.keeper import LockKeeper
from mpdt.data.store import provenance
from mpdt.data.store.digest import episode_digest
from mpdt.data.store.digests import Labels
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import CHECKS, verify
from mpdt.errors import FormatError, UsageError

from .damages import Apply, both_flags, copy_episode, finding, flip, outcomes, pay, put, swap_tiers


def respec(file: h5py.File) -> None:
    file.attrs["spec"] = file.attrs["spec"].replace('"seed":7', '"seed":8')


def test_the_untouched_file_passes_everything(tiny: Path) -> None:
    report = verify(tiny, replay="all")
    assert [one.id for one in report.findings] == list(CHECKS)
    assert outcomes(report, Outcome.PASS) == set(CHECKS)
    assert finding(report, "replay").text.startswith("36 episodes, 180 steps byte-equal")
    assert finding(report, "hash").text.startswith("36 digests, content ")
    assert "in 2/2 tasks; medium level 0.47 to 0.52" in finding(report, "quality").text


def test_both_flags_at_the_horizon_are_right(change: Apply) -> None:
    assert outcomes(verify(change(both_flags, seal=True), skip=["replay"])) == set()


def test_a_fail_names_three_episodes_and_a_command(change: Apply) -> None:
    path = change(lambda f: f["steps/observations"].__setitem__(slice(0, 60), np.nan), seal=True)
    found = finding(verify(path, skip=["replay"]), "values")
    assert found.text == "observations not finite: episodes 0, 1, 2 and 7 more"
    assert found.episodes == (0, 1, 2)
    assert found.hint == f"mpdt-data drop {path} --episodes 0,1,2 -o OUT.h5"


@pytest.mark.parametrize(
    ("what", "id", "text"),
    [
        (copy_episode(1, 3), "duplicates", "task forward, same observations and actions: epis"),
        (copy_episode(1, 18), "duplicates", ""),  # roles both: train and test share it
        (lambda f: f["steps/observations"].__setitem__((slice(None), 2), 3.0), "values",
         "observations: column 2 (bthigh [rad]) is always 3"),
        (lambda f: f["tta/default/steps/actions"].__setitem__(slice(None), 0.9), "tta",
         "mean of action component 0, 1, 2 is not that of uniform actions (tta default)"),
    ],
)  # fmt: skip
def test_doubts_warn(change: Apply, what: Callable[[h5py.File], None], id: str, text: str) -> None:
    report = verify(change(what, seal=True), skip=["replay", "claims"])
    if text:
        assert (outcomes(report), outcomes(report, Outcome.WARN)) == (set(), {id})
        assert text in finding(report, id).text
    else:
        assert outcomes(report) == {id}


def test_columns_that_may_be_zero_are_no_doubt(change: Apply) -> None:
    def zero(value: float) -> Callable[[h5py.File], None]:
        return lambda f: f["steps/observations"].__setitem__((slice(None), 18), value)  # torso_y

    assert outcomes(verify(change(zero(0.0), seal=True), only=["values"]), Outcome.WARN) == set()
    assert outcomes(verify(change(zero(1.0), seal=True), only=["values"]), Outcome.WARN) == {
        "values"
    }


def test_smoke_versions_and_imports_are_judged_softly(change: Apply) -> None:
    def smoke(file: h5py.File) -> None:
        swap_tiers(file)
        file.attrs["version"] = "1.0.0+smoke"

    assert outcomes(verify(change(smoke, seal=True), only=["quality"]), Outcome.WARN) == {"quality"}

    def unknown(file: h5py.File) -> None:
        file["episodes/quality"][:], file["episodes/progress"][:] = -1, -1
        file["tasks/ref_expert"][:] = np.nan

    report = verify(change(unknown, seal=True), skip=["replay", "claims"])
    assert (outcomes(report), outcomes(report, Outcome.WARN)) == (set(), {"returns"})


def test_any_flipped_byte_is_told_without_a_traceback(tiny: Path) -> None:
    """Each flip is found, or lies where nothing is stored that anybody reads."""
    whole = tiny.read_bytes()
    random = np.random.Generator(np.random.PCG64(5))
    for place in random.integers(0, len(whole), 20).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(random.integers(8))
        tiny.write_bytes(damaged)
        report = verify(tiny, skip=["replay"])
        assert "could not be looked at" not in " ".join(one.text for one in report.findings)


def test_digests_of_whole_chunks_equal_those_of_episodes(tiny: Path) -> None:
    """The slow twin: an Episode at a time."""
    data = open_dataset(tiny)
    labels = Labels(data)
    for i in (0, 13, 31):
        episode = data.episode(i)
        slow = episode_digest(episode, data.tasks.names[data.episodes.task[i]])
        assert slow == data.episodes.digest[i].tobytes()
        assert labels.episode(i).endswith(np.array(episode.seed_key, "<u4").tobytes())


def test_one_episode_per_chunk_finds_the_same(change: Apply, monkeypatch: Any) -> None:
    from mpdt.data.verify.material import Track

    path = change(flip)
    whole = verify(path, skip=["replay"]).findings
    chunks = Track.chunks
    monkeypatch.setattr(Track, "chunks", lambda self: chunks(self, 1))
    assert verify(path, skip=["replay"]).findings == whole


# ---- lock ----


@pytest.fixture
def lock(tiny: Path, tmp_path: Path) -> Path:
    path = tmp_path / "datasets.lock"
    LockKeeper(path).after(open_dataset(tiny))
    return path


def test_the_locked_file_passes(tiny: Path, lock: Path) -> None:
    assert finding(verify(tiny, lock=lock, skip=["replay"]), "hash").text.endswith(f"= {lock}")


def test_a_wrong_lock_fails_hash(tiny: Path, lock: Path, change: Apply) -> None:
    change(pay, seal=True)
    report = verify(tiny, lock=lock, skip=["replay", "claims"])
    assert outcomes(report) == {"hash"}
    text = finding(report, "hash").text
    assert f"not what {lock} holds" in text and "other episodes in forward/random" in text
    lock.write_bytes(lock_bytes({}))
    assert "has no entry tiny" in finding(verify(tiny, lock=lock, skip=["replay"]), "hash").text
    lock.write_text("no lock")
    with pytest.raises(FormatError, match="expected the keys"):
        verify(tiny, lock=lock)


def test_a_spec_that_changed_under_its_version_fails_hash(
    tiny: Path, lock: Path, change: Apply
) -> None:
    import hashlib

    def respecced(file: h5py.File) -> None:
        respec(file)
        file.attrs["spec_hash"] = hashlib.sha256(file.attrs["spec"].encode()).hexdigest()

    text = finding(verify(change(respecced), lock=lock, skip=["replay"]), "hash").text
    locked = read_lock(lock)["tiny"].hashes.spec[:8]
    assert "(seed 7 -> 8), but version is still 1.0.0: locked spec " + locked in text


def test_a_cut_out_of_the_locked_file_passes(tiny: Path, lock: Path, tmp_path: Path) -> None:
    from mpdt.data.slices.cut import Cut, cut_file

    cut = cut_file(open_dataset(tiny), Cut(quality="medium"), tmp_path / "m.h5").path
    report = verify(cut, lock=lock, replay="all")
    assert outcomes(report) == set()
    assert "cut out of what" in finding(report, "hash").text


def test_a_cut_out_of_another_file_fails_hash(change: Apply, lock: Path) -> None:
    path = change(lambda file: file.attrs.modify("parent", "1" * 64))
    text = finding(verify(path, lock=lock, only=["hash"]), "hash").text
    assert text.startswith("cut out of 11111111, but ")


# ---- replay ----


@pytest.mark.parametrize(("amount", "count"), [("2%", 10), ("1", 10), ("18", 18), ("100%", 36)])
def test_replay_takes_at_least_one_of_each_task_and_quality(
    tiny: Path, amount: str, count: int
) -> None:
    """8 runs of 4 episodes and 2 TTA runs of 2."""
    report = verify(tiny, only=["replay"], replay=amount)
    assert finding(report, "replay").text.startswith(f"{count} episodes, {5 * count} steps")


@pytest.mark.parametrize("amount", ["0%", "101%", "-1", "0", "some", "", "1e3"])
def test_amounts_that_make_no_sense(tiny: Path, amount: str) -> None:
    with pytest.raises(UsageError, match="cannot read the amount"):
        verify(tiny, replay=amount)


def test_on_another_mujoco_replay_warns_with_figures(
    change: Apply, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = change(pay, seal=True)
    real = provenance.packages()
    monkeypatch.setattr(provenance, "packages", lambda: real | {"mujoco": "9.9.9"})
    report = verify(path, only=["replay"], replay="all")
    assert outcomes(report, Outcome.WARN) == {"replay"}
    text = finding(report, "replay").text
    assert "35/36 episodes byte-equal" in text and "mujoco 3.3.0 -> 9.9.9" in text


def test_files_without_seeds_or_simulator_fail_only_where_replay_was_asked_for(
    change: Apply, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mpdt.data.verify import replay
    from mpdt.errors import SimulatorError

    def refuse(*args: Any) -> None:
        raise SimulatorError("mujoco is not installed")

    def forget(file: h5py.File) -> None:
        file["episodes/seed_key"][:] = 4294967295
        file["episodes/quality"][:] = -1

    with monkeypatch.context() as patch:
        patch.setattr(replay, "make_batch", refuse)
        path = change(lambda f: None)
        report = verify(path)
        assert outcomes(report, Outcome.WARN) == {"replay"}
        assert finding(report, "replay").text == "not checked: mujoco is not installed"
        for asked in ({"only": ["replay"]}, {"replay": "all"}, {"replay": "2%"}):
            report = verify(path, **asked)
            assert outcomes(report) == {"replay"}
            text = "asked for, but nothing was replayed: mujoco is not installed"
            assert finding(report, "replay").text == text
    path = change(forget, seal=True)
    told = finding(verify(path), "replay")
    assert told.outcome is Outcome.WARN and "without a seed" in told.text
    assert finding(verify(path, only=["replay"]), "replay") == told, "an import never has seeds"
    assert finding(verify(path, replay="1"), "replay").outcome is Outcome.FAIL


# ---- choosing ----


def test_only_and_skip(tiny: Path, change: Apply) -> None:
    assert [one.id for one in verify(tiny, only=["tta", "hash"]).findings] == ["hash", "tta"]
    assert "replay" not in {one.id for one in verify(tiny, skip=["replay"]).findings}
    with pytest.raises(UsageError, match=r"unknown check 'hasch' \(did you mean 'hash'"):
        verify(tiny, only=["hasch"])
    change(put("episodes/start", 3, 14))
    ids = [(one.id, one.outcome.value) for one in verify(tiny, only=["tta"]).findings]
    assert ids == [("shapes", "FAIL"), ("tta", "SKIP")]


def test_findings_are_json(tiny: Path) -> None:
    report = verify(tiny, only=["hash"])
    assert json.loads(json.dumps(report.findings[0].as_json()))["outcome"] == "PASS"
