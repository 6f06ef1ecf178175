"""What must not cost the old file: failing sources, full disks, disks that lie."""

from __future__ import annotations

import errno
import resource
import shutil
from dataclasses import replace

import numpy as np
import pytest

from mpdt.data.store import writer
from mpdt.data.store.columns import StepTable
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.writer import EpisodeSource, check_digests, write_file
from mpdt.disk import content, disk
from mpdt.errors import FormatError, StorageError


def test_a_failing_source_leaves_the_old_file(made, kit):
    before = made.path.read_bytes()

    def broken():
        yield kit.episodes[0]
        raise RuntimeError("the simulator fell over")

    with pytest.raises(RuntimeError, match="fell over"):
        write_file(made.path, kit.header, EpisodeSource(broken(), 4, 7))
    assert made.path.read_bytes() == before
    assert [path.name for path in made.path.parent.iterdir()] == ["hand-made.h5"]


def test_a_full_disk_is_one_clean_error(made, kit):
    before = made.path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    long = kit.episode(100_000)  # 2 MB of steps against 1 MB of room
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, hard))
        with pytest.raises(StorageError, match=r"hand-made\.h5: the disk is full") as caught:
            write_file(made.path, kit.header, kit.source((long,)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "make room" in caught.value.hint
    assert made.path.read_bytes() == before
    assert [path.name for path in made.path.parent.iterdir()] == ["hand-made.h5"]


def test_a_full_disk_is_known_before_the_first_episode(tmp_path, kit, monkeypatch):
    def refuse(path, num_bytes, later):
        raise OSError(errno.ENOSPC, f"No space left for {num_bytes} bytes")

    def episodes():
        raise AssertionError("asked for an episode although there is no room")
        yield

    monkeypatch.setattr(writer, "reserve", refuse)
    with pytest.raises(StorageError, match="the disk is full"):
        write_file(tmp_path / "a.h5", kit.header, EpisodeSource(episodes(), 4, 7))


def test_room_for_the_tables_is_looked_for_as_well(made, kit, monkeypatch):
    """HDF5 cannot close a file whose last part the disk refuses: it would end the process."""
    usage = shutil.disk_usage(made.path)
    monkeypatch.setattr(content.shutil, "disk_usage", lambda path: usage._replace(free=50_000))
    with pytest.raises(StorageError, match="the disk is full"):
        write_file(made.path, kit.header, kit.source((kit.episode(5),)))


def test_of_hdf5_only_the_reason_is_told(tmp_path):
    said = ("Can't write data (file write failed: time = Mon Nov 30, filename = '/x/.y.tmp', "
            "file descriptor = 4, errno = 28, error message = 'No space left on device', "
            "buf = 0x7f)")  # fmt: skip
    with pytest.raises(StorageError, match="the disk is full") as caught, disk(tmp_path):
        raise RuntimeError(said)
    assert caught.value.found == "[Errno 28] No space left on device"


def test_what_was_written_is_read_back(made, kit, monkeypatch):
    append = StepTable.append

    def bad_disk(self, episode, task_row, goal_row):
        append(self, replace(episode, rewards=episode.rewards + 1), task_row, goal_row)

    monkeypatch.setattr(StepTable, "append", bad_disk)
    with pytest.raises(FormatError, match="episodes 0, 1, 2 and 1 more do not have"):
        write_file(made.path, kit.header, kit.source())
    assert made.content_hash == open_dataset(made.path).content_hash


def test_what_was_written_last_is_read_back_as_well(made, kit, monkeypatch):
    before = made.path.read_bytes()
    monkeypatch.setattr(writer, "seal", lambda file: file.attrs.__setitem__("seal", "0" * 64))
    with pytest.raises(FormatError, match="the seal is broken"):
        write_file(made.path, kit.header, kit.source())
    assert made.path.read_bytes() == before


def test_a_folder_that_takes_no_files(tmp_path, kit):
    with pytest.raises(StorageError, match="folder does not exist"):
        write_file(tmp_path / "no" / "a.h5", kit.header, kit.source())
    (tmp_path / ".a.h5.lock").mkdir()
    with pytest.raises(StorageError, match=r"a\.h5\.lock: something is in the place"):
        write_file(tmp_path / "a.h5", kit.header, kit.source())
    (tmp_path / "b.h5").mkdir()
    with pytest.raises(StorageError, match="a folder is in the way"):
        write_file(tmp_path / "b.h5", kit.header, kit.source())


def test_open_readers_keep_the_old_episodes(made, kit):
    write_file(made.path, kit.header, kit.source(kit.episodes[2:]))
    assert made.episode(0).observations.tolist() == [[100, 101], [102, 103]]
    assert open_dataset(made.path).num_episodes == 2


def test_a_flipped_bit_is_found(made):
    with made.path.open("r+b") as stream:
        raw = stream.read()
        stream.seek(raw.index(np.array([200, 201, 202], np.float32).tobytes()))
        stream.write(np.float32(200.5).tobytes())
    with pytest.raises(FormatError, match="episode 1 does not have the bytes of its"):
        check_digests(open_dataset(made.path))
