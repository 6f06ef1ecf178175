"""What was opened is what is read, to the end, whatever takes its place meanwhile."""

from __future__ import annotations

import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.cli import main
from mpdt.data.lock.fingerprint import fingerprint
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.store import opening
from mpdt.data.store.opening import opened
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.verbs import pages
from mpdt.data.verify.verify import verify
from mpdt.errors import StorageError


@pytest.fixture
def replaced(tiny_file: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A file that is opened, and another one to take its place: other TTA rewards."""
    import h5py

    from mpdt.data.store.seal import seal

    other = tmp_path / "other.h5"
    shutil.copy(tiny_file, other)
    with h5py.File(other, "r+") as file:
        file["tta/default/sim_rewards"][...] += 1
        seal(file)
    return tiny_file, other


def test_a_cut_out_is_all_of_the_file_that_was_opened(replaced, tmp_path):
    path, other = replaced
    old, _ = open_tta_rewards(path, "default")
    data = open_dataset(path)
    other.replace(path)
    cut = cut_file(data, Cut(quality="expert"), tmp_path / "cut.h5")
    rewards, _ = open_tta_rewards(cut, "default")
    assert np.isin(rewards, old).all()
    assert not np.isin(open_tta_rewards(path, "default")[0], old).all(), "the other one is there"
    assert verify(cut.path, skip=("replay",)).findings


def test_a_file_that_is_replaced_between_looking_and_opening_is_not_read(replaced, monkeypatch):
    path, other = replaced
    old, file = open_tta_rewards(path, "default"), opening.h5py.File

    def late(name, *args):
        if other.exists() and isinstance(name, Path):
            other.replace(path)
        return file(name, *args)

    monkeypatch.setattr(opening.h5py, "File", late)
    found, _ = open_tta_rewards(path, "default")
    assert not other.exists()
    np.testing.assert_array_equal(found, old[0])


def test_elsewhere_another_file_is_refused(replaced, monkeypatch):
    path, other = replaced
    monkeypatch.setattr(opening, "_proc_name", lambda handle: None)
    data = open_dataset(path)
    with opened(path, source=data.source):
        pass
    other.replace(path)
    with pytest.raises(StorageError, match="took its place"):
        open_tta_rewards(data, "default")


def test_a_source_crosses_to_another_process_as_its_path(replaced):
    path, other = replaced
    source = open_dataset(path).source
    again = pickle.loads(pickle.dumps(source))
    with source.open() as one, again.open() as two:
        assert os.path.sameopenfile(one.fileno(), two.fileno())
    content = pickle.dumps(source)
    other.replace(path)
    with pytest.raises(StorageError, match="took its place"):
        pickle.loads(content)


def test_a_source_closes_its_file(tiny_file):
    before = len(list(Path("/proc/self/fd").iterdir()))
    data = open_dataset(tiny_file, preload=True)
    assert len(list(Path("/proc/self/fd").iterdir())) == before + 1
    del data
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_errors_name_the_path(tmp_path):
    path = tmp_path / "a.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(Exception) as caught:
        open_dataset(path)
    assert "/proc/" not in str(caught.value) and str(path) in str(caught.value)


def test_who_reads_by_path_as_well_is_told_of_another_file(replaced, capsys):
    """A card whose checks would be of the other file is not written."""
    path, other = replaced
    data = open_dataset(path)
    data.source.expect_there()
    before, wanted = fingerprint(data), path.read_bytes()
    other.replace(path)
    with pytest.raises(StorageError, match="took its place"):
        data.source.expect_there()
    assert path.read_bytes() != wanted and fingerprint(data) == before


def test_a_card_is_of_one_file(replaced, monkeypatch, capsys):
    path, other = replaced
    check = pages.Report._films

    def late(self, facts, ids):
        other.replace(path)
        return check(self, facts, ids)

    monkeypatch.setattr(pages.Report, "_films", late)
    assert main(["report", str(path), "--film", "none", "--no-verify", "-o", "card.html"]) == 1
    assert "another file took its place" in capsys.readouterr().err
    assert not Path("card.html").exists()
