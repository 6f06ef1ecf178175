"""datasets.lock under a collection of the fake simulator: refusals, claims, --locked.

tiny: 2 tasks, 4 episodes of each quality in blocks of 3, history on 3 rungs, TTA sets of 2.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mpdt.data.cli import main
from mpdt.data.lock.file import read_lock
from mpdt.data.lock.fingerprint import digests_by_run, fingerprint, lost_runs
from mpdt.data.lock.keeper import LockKeeper, plain_spec
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.store import provenance
from mpdt.data.store.reader import open_dataset

Capture = pytest.CaptureFixture[str]
Edit = Callable[[str, str], None]
LOCK = Path("datasets.lock")


@pytest.fixture
def edit(workplace: Path) -> Edit:
    """Replace text in datasets.yaml; a new version is given as well."""

    def change(old: str, new: str) -> None:
        path = workplace / "datasets.yaml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return change


def collect(*words: str) -> int:
    return main(["collect", "tiny", "--workers", "0", *words])


@pytest.fixture
def locked(tiny_file: Path) -> Path:
    """tiny.h5 and its lock entry in the working folder."""
    LockKeeper(LOCK).after(open_dataset(tiny_file))
    return tiny_file


def test_runs_by_hand(tiny_file: Path) -> None:
    runs = digests_by_run(open_dataset(tiny_file))
    assert list(runs) == ["forward", "backward"]
    counts = {name: len(digests) // 32 for name, digests in runs["forward"].items()}
    assert counts == {
        "random": 4, "medium": 4, "expert": 4, "history-00": 2, "history-01": 1, "history-02": 1,
        "tta-default": 2,
    }  # fmt: skip


def test_the_first_entry_is_added(fakes: object, workplace: Path, capsys: Capture) -> None:
    assert collect() == 0
    assert "lock    datasets.lock: tiny 1.0.0 added\n" in capsys.readouterr().err
    entry = read_lock(LOCK)["tiny"]
    data = open_dataset("tiny.h5")
    assert entry == fingerprint(data)
    assert entry.hashes.content == data.content_hash
    assert entry.size.bytes == Path("tiny.h5").stat().st_size
    assert entry.spec == plain_spec(load_catalog().get("tiny"))
    assert entry.returns["backward"]["expert"] == 5.0
    assert entry.policies["forward"]["fake-2"] == bytes([0, 2, 200, 0]).hex() * 2
    before = LOCK.stat().st_mtime_ns
    assert collect("--locked") == 0
    assert "tiny 1.0.0 as locked" in capsys.readouterr().err
    assert LOCK.stat().st_mtime_ns == before


def test_an_absent_file_is_made_again_to_the_locked_hash(locked: Path, capsys: Capture) -> None:
    locked.unlink()
    assert collect("--locked") == 0
    assert "tiny 1.0.0 as locked" in capsys.readouterr().err


def test_what_is_not_in_the_lock_cannot_be_locked(
    fakes: object, workplace: Path, capsys: Capture
) -> None:
    assert collect("--locked") == 1
    assert "datasets.lock: not in the lock; found tiny\nhint:  mpdt-data collect tiny" in (
        capsys.readouterr().err
    )
    assert not Path("tiny.h5").exists()


def test_a_spec_changed_without_a_version_is_refused_with_hashes_and_keys(
    locked: Path, edit: Edit, capsys: Capture
) -> None:
    old = read_lock(LOCK)["tiny"].hashes.spec
    before = locked.read_bytes()
    edit("expert: 4", "expert: 6")
    for words in ((), ("--locked",), ("--restart",), ("--update-lock",)):
        assert collect(*words) == 1
        text = capsys.readouterr().err
        assert (
            "error: tiny: the spec changed (episodes.expert 4 -> 6) but version is still 1.0.0; "
            f"expected spec {old}, found spec " in text
        )
        assert 'hint:  set version "1.1.0", then run: mpdt-data collect tiny\n' in text
    assert locked.read_bytes() == before
    edit("seed: 7", "seed: 8")
    assert collect() == 1
    assert 'set version "2.0.0"' in capsys.readouterr().err
    edit("1.0.0", "0.9.0")
    assert collect() == 1
    assert "its version went back" in capsys.readouterr().err


def test_a_license_is_a_patch(locked: Path, edit: Edit, capsys: Capture) -> None:
    edit("license: MIT", "license: CC0-1.0")
    assert collect() == 1
    assert 'set version "1.0.1"' in capsys.readouterr().err
    edit("1.0.0", "1.0.1")
    assert collect("--restart") == 0
    assert "datasets.lock: 1.0.0 -> tiny 1.0.1 (patch)" in capsys.readouterr().err
    assert read_lock(LOCK)["tiny"].version == "1.0.1"


def test_a_patch_that_changes_data_is_refused_and_its_blocks_are_kept(
    locked: Path, edit: Edit, capsys: Capture
) -> None:
    before = LOCK.read_bytes(), locked.read_bytes()
    edit("expert: 4", "expert: 5")
    edit("1.0.0", "1.0.1")
    assert collect("--restart") == 1
    text = capsys.readouterr().err
    assert "tiny: 1.0.0 -> 1.0.1 claims a patch change; expected the same data, found other" in text
    assert 'set version "1.1.0" and collect again: finished blocks are kept' in text
    assert (LOCK.read_bytes(), locked.read_bytes()) == before
    locked.unlink()
    edit("1.0.1", "1.1.0")
    assert collect() == 0
    text = capsys.readouterr().err
    assert "resuming: 22 of 22 blocks done" in text
    assert "datasets.lock: 1.0.0 -> tiny 1.1.0 (minor)" in text


def test_more_episodes_are_a_minor_change(locked: Path, edit: Edit, capsys: Capture) -> None:
    """random 4 -> 8 fills the short block and adds one; history 4 -> 6 adds to rungs 1 and 2."""
    old = read_lock(LOCK)["tiny"]
    edit("random: 4", "random: 8")
    edit("history: 4", "history: 6")
    edit("episodes: 2,", "episodes: 4,")
    edit("1.0.0", "1.1.0")
    locked.unlink()
    assert collect() == 0
    data = open_dataset("tiny.h5")
    assert data.num_episodes == 2 * (8 + 4 + 4 + 6)
    assert lost_runs(data, old) == []


@pytest.mark.parametrize(
    ("old", "new", "lost"),
    [
        ("expert: 4", "expert: 3", "forward/expert, backward/expert"),
        ("horizon: 5", "horizon: 6", "forward/random, forward/medium, forward/expert and 11 more"),
        ("episodes: 2,", "episodes: 1,", "forward/tta-default, backward/tta-default"),
    ],
)
def test_a_minor_version_that_loses_episodes_names_the_runs(
    locked: Path, edit: Edit, capsys: Capture, old: str, new: str, lost: str
) -> None:
    edit(old, new)
    edit("1.0.0", "1.1.0")
    locked.unlink()
    assert collect() == 1
    text = capsys.readouterr().err
    assert "claims a minor change; expected every old episode as it was" in text
    assert f"changed or missing: {lost}\n" in text
    assert 'set version "2.0.0"' in text
    assert not locked.exists()
    edit("1.1.0", "2.0.0")
    assert collect("-q") == 0
    assert read_lock(LOCK)["tiny"].version == "2.0.0"


def test_a_raised_version_is_not_the_locked_one(locked: Path, edit: Edit, capsys: Capture) -> None:
    edit("1.0.0", "1.1.0")
    assert collect("--locked", "--restart") == 1
    assert "another version than the locked one; expected 1.0.0, found 1.1.0" in (
        capsys.readouterr().err
    )


def test_other_policies_are_refused_or_told(
    locked: Path, fakes: Callable[..., None], capsys: Capture
) -> None:
    before, content = LOCK.read_bytes(), open_dataset(locked).content_hash
    fakes(0.45)  # medium and rung 1 of history
    assert collect("--locked", "--restart") == 1
    text = capsys.readouterr().err
    runs = "forward/medium, forward/history-01, backward/medium and 1 more"
    assert f"tiny: other episodes than locked; expected content {content[:8]}, found " in text
    assert f"other episodes in {runs}\n" in text
    assert open_dataset(locked).content_hash == content
    assert collect("--restart") == 0
    text = capsys.readouterr().err
    assert f"warning: tiny 1.0.0 is not what datasets.lock holds: other episodes in {runs}" in text
    assert "--update-lock replaces the entry" in text
    assert LOCK.read_bytes() == before
    assert collect("--update-lock") == 0
    assert "datasets.lock: tiny 1.0.0 updated" in capsys.readouterr().err
    assert read_lock(LOCK)["tiny"].hashes.content == open_dataset(locked).content_hash


def test_other_packages_stop_locked_and_warn_otherwise(
    locked: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = provenance.packages()
    others = real | {"mujoco": "9.9.9", "torch": "0.1", "metaworld": "1.0"}  # cheetah needs one
    monkeypatch.setattr(provenance, "packages", lambda: others)
    assert collect("--locked", "--restart") == 3
    text = capsys.readouterr().err
    assert f"tiny: other versions than locked: mujoco {real['mujoco']} -> 9.9.9\n" in text
    assert f"mujoco=={real['mujoco']}" in text
    assert collect("--restart") == 0
    text = capsys.readouterr().err
    assert f"warning: tiny 1.0.0 was locked with other versions: mujoco {real['mujoco']}" in text


def test_smoke_has_an_entry_of_its_own_and_only_if_asked(
    fakes: object, workplace: Path, capsys: Capture
) -> None:
    assert collect("--smoke") == 0
    assert not LOCK.exists()
    assert "datasets.lock" not in capsys.readouterr().err
    assert collect("--smoke", "--update-lock") == 0
    assert list(read_lock(LOCK)) == ["tiny-smoke"]
    assert collect() == 0
    assert list(read_lock(LOCK)) == ["tiny", "tiny-smoke"]
    assert collect("--smoke", "--locked", "--restart") == 0
    assert "tiny-smoke 1.0.0+smoke as locked" in capsys.readouterr().err


def test_some_tasks_leave_the_lock_alone(fakes: object, workplace: Path, capsys: Capture) -> None:
    assert collect("--tasks", "forward") == 0
    assert not LOCK.exists()
    assert collect("--tasks", "forward", "--locked") == 2
    assert "the lock holds whole entries" in capsys.readouterr().err


def test_a_damaged_lock_stops_before_anything_is_made(
    fakes: object, workplace: Path, capsys: Capture
) -> None:
    LOCK.write_text("schema: 1\ndatasets: {tiny: {version: 1}}\n")
    assert collect() == 1
    text = capsys.readouterr().err
    assert "tiny.version: expected text" in text and "version control" in text
    assert not Path("tiny.h5").exists()
