"""Parts: round trip, every kind of damage counts as missing, lock, plan changes."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from makers import make_episode

from mpdt.data.collect.parts import Part, PartsFolder
from mpdt.data.collect.plan import Block
from mpdt.data.collect.runner import BlockReport, Gap, report_part
from mpdt.data.episode import Episode
from mpdt.data.spec.tasks import get_family
from mpdt.errors import DataError, StorageError
from mpdt.seeding import Quality

TASK = get_family("cheetah_dir").tasks[1]
BLOCK = Block("episodes", "expert", TASK, Quality.EXPERT, 4, 2, 3)
REFERENCE = Block("reference", "zero", TASK, Quality.REFERENCE_ZERO, 0, 2, 3)

ACTOR = (b"\7" * 32, 0.5)
"""Hash of the policy that acts in the blocks below, and its progress."""


def row_of_block(row: int, length: int, successes: bool = False) -> Episode:
    """Of BLOCK; one of three steps was cut by the horizon, a shorter one ended by itself."""
    last = np.arange(length) == length - 1
    return make_episode(
        length, 0.1 + 100.0 * row, (4, 2), task=1, quality=2, block=4, row=row, policy=ACTOR[0],
        progress=ACTOR[1], goal=np.arange(row + 1, dtype=np.float64),
        terminations=last & (length < 3), truncations=last & (length == 3),
        successes=np.arange(length) > 1 if successes else None,
    )  # fmt: skip


def same(left: Episode, right: Episode) -> bool:
    def values(episode: Episode) -> list[Any]:
        return [v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(episode).values()]

    return values(left) == values(right)


@pytest.fixture
def folder(tmp_path: Path) -> PartsFolder:
    folder = PartsFolder(tmp_path / "x.h5")
    (folder.path / "blocks").mkdir(parents=True)
    return folder


@pytest.mark.parametrize("successes", [False, True])
def test_episodes_come_back_as_they_were(folder: PartsFolder, successes: bool) -> None:
    episodes = [row_of_block(0, 3, successes), row_of_block(1, 2, successes)]
    folder.part(BLOCK).save_episodes(episodes)
    loaded = folder.part(BLOCK).load_episodes()
    assert all(same(a, b) for a, b in zip(episodes, loaded, strict=True))
    report = report_part(folder, BLOCK, ACTOR)
    assert isinstance(report, BlockReport)
    assert report.steps == 5
    assert report.returns.tolist() == [6.0, 3.0]  # 1 + 2 + 3 and 1 + 2
    assert list((folder.path / "blocks").iterdir()) == [folder.part(BLOCK).path]


def test_returns_come_back_as_they_were(folder: PartsFolder) -> None:
    folder.part(REFERENCE).save_returns(np.array([0.1, -2.0]), ACTOR[0])
    returns, policy = folder.part(REFERENCE).load_returns()
    assert (returns.tolist(), policy) == ([0.1, -2.0], ACTOR[0])
    report = report_part(folder, REFERENCE, ACTOR)
    assert isinstance(report, BlockReport) and report.returns.tolist() == [0.1, -2.0]


def _flip_stored_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 1
    path.write_bytes(content)


def _change_reward(path: Path) -> None:
    """What a byte flip cannot show: an archive whose own checksums are right."""
    with np.load(path) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    arrays["rewards"][0] += 1
    with path.open("wb") as file:
        np.savez(file, **arrays)


def _drop_column(path: Path) -> None:
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "length"}
    with path.open("wb") as file:
        np.savez(file, **arrays)


@pytest.mark.parametrize(
    "damage",
    [
        _flip_stored_byte,
        _change_reward,
        _drop_column,
        lambda path: path.write_bytes(path.read_bytes()[:100]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"not a zip archive"),
    ],
)
def test_a_damaged_part_counts_as_missing(folder: PartsFolder, damage: Any) -> None:
    part = folder.part(BLOCK)
    part.save_episodes([row_of_block(0, 3), row_of_block(1, 2)])
    assert isinstance(report_part(folder, BLOCK, ACTOR), BlockReport)
    damage(part.path)
    assert report_part(folder, BLOCK, ACTOR) is Gap.DAMAGED
    with pytest.raises(DataError, match=r"backward-expert-4\.npz"):
        part.load_episodes()


def test_returns_of_another_policy_under_this_hash_are_damaged(folder: PartsFolder) -> None:
    part = folder.part(REFERENCE)
    part.save_returns(np.array([1.0, 2.0]), bytes(32))
    with np.load(part.path) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    arrays["policy"][:] = 7
    with part.path.open("wb") as file:
        np.savez(file, **arrays)
    assert report_part(folder, REFERENCE, ACTOR) is Gap.DAMAGED


def test_damaged_returns_count_as_missing(folder: PartsFolder) -> None:
    part = folder.part(REFERENCE)
    part.save_returns(np.array([1.0, 2.0]), ACTOR[0])
    with np.load(part.path) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    arrays["returns"][1] = 3.0
    with part.path.open("wb") as file:
        np.savez(file, **arrays)
    assert report_part(folder, REFERENCE, ACTOR) is Gap.DAMAGED


def test_a_part_of_another_policy_is_outdated(folder: PartsFolder) -> None:
    """After a new calibration: other weights or rate (hash), or the same at another level."""
    folder.part(BLOCK).save_episodes([row_of_block(0, 3), row_of_block(1, 2)])
    folder.part(REFERENCE).save_returns(np.array([1.0, 2.0]), ACTOR[0])
    for block in (BLOCK, REFERENCE):
        assert isinstance(report_part(folder, block, ACTOR), BlockReport)
        assert report_part(folder, block, (bytes(32), ACTOR[1])) is Gap.OUTDATED
    assert report_part(folder, BLOCK, (ACTOR[0], ACTOR[1] / 2)) is Gap.OUTDATED


def test_a_part_under_another_blocks_name_counts_as_missing(folder: PartsFolder) -> None:
    folder.part(BLOCK).save_episodes([row_of_block(0, 3), row_of_block(1, 2)])
    other = Block("episodes", "expert", TASK, Quality.EXPERT, 5, 2, 3)
    folder.part(BLOCK).path.rename(folder.part(other).path)
    assert report_part(folder, other, ACTOR) is Gap.DAMAGED
    longer = Block("episodes", "expert", TASK, Quality.EXPERT, 4, 3, 3)
    folder.part(other).path.rename(folder.part(longer).path)
    assert report_part(folder, longer, ACTOR) is Gap.DAMAGED


def test_a_full_disk_leaves_no_half_part(
    folder: PartsFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: Any, **arrays: Any) -> None:
        file.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(StorageError, match="the disk is full"):
        folder.part(BLOCK).save_episodes([row_of_block(0, 3), row_of_block(1, 2)])
    assert list((folder.path / "blocks").iterdir()) == []


def test_the_lock_names_its_holder_across_processes(tmp_path: Path) -> None:
    folder = PartsFolder(tmp_path / "x.h5")
    with folder.locked():
        code = (
            "import sys; from pathlib import Path\n"
            "from mpdt.data.collect.parts import PartsFolder\n"
            "try:\n"
            "    PartsFolder(Path(sys.argv[1])).locked().__enter__()\n"
            "except Exception as error:\n"
            "    print(type(error).__name__, error.exit_code, error.message())\n"
        )
        other = subprocess.run(
            [sys.executable, "-c", code, str(folder.target)],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    assert other.stdout.startswith("BusyError 4 ")
    assert f"process {os.getpid()}" in other.stdout
    with folder.locked():
        pass  # free again


def test_a_changed_plan_is_refused_with_its_keys(folder: PartsFolder) -> None:
    plan = {"spec": {"episodes": {"expert": 400}, "tasks": ("a", "b")}}
    folder.agree(plan)
    folder.agree(plan)
    changed = {"spec": {"episodes": {"expert": 500}, "tasks": ("a", "b")}}
    with pytest.raises(DataError, match=r"spec\.episodes\.expert 400 -> 500") as caught:
        folder.agree(changed)
    assert "--restart" in caught.value.hint
    folder.clear()
    folder.agree(changed)


def test_parts_without_a_readable_plan_are_dropped(folder: PartsFolder) -> None:
    folder.part(BLOCK).save_episodes([row_of_block(0, 3), row_of_block(1, 2)])
    (folder.path / "plan.json").write_text("{half")
    folder.agree({"spec": {}})
    assert report_part(folder, BLOCK, ACTOR) is Gap.MISSING


def test_part_path() -> None:
    assert Part(Path("blocks"), REFERENCE).path == Path("blocks/backward-ref_zero-0.npz")
