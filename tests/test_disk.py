import errno

import pytest

from mpdt.disk import check_replaceable, disk, replacing
from mpdt.errors import DataError, MissingFileError, StorageError


def test_the_new_content_arrives_on_a_clean_exit_only(tmp_path):
    target = tmp_path / "a"
    target.write_text("old", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt), replacing(target) as temporary:
        temporary.write_text("half", encoding="utf-8")
        raise KeyboardInterrupt
    assert target.read_text(encoding="utf-8") == "old"
    with replacing(target) as temporary:
        temporary.write_text("new", encoding="utf-8")
        assert target.read_text(encoding="utf-8") == "old"
    assert target.read_text(encoding="utf-8") == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_stale_temporary_file_is_no_obstacle(tmp_path):
    (tmp_path / "a.tmp").write_text("of a killed writer", encoding="utf-8")
    with replacing(tmp_path / "a") as temporary:
        temporary.write_text("new", encoding="utf-8")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("error", "what"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "the disk is full"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "the disk is full"),
        (RuntimeError("Can't write (errno = 28, No space left on device)"), "the disk is full"),
        (OSError(errno.EROFS, "Read-only file system"), "the disk is read-only"),
        (RuntimeError("unable to open (Read-only file system)"), "the disk is read-only"),
        (PermissionError(errno.EACCES, "Permission denied"), "no permission to write"),
        (OSError("Unable to create file (error message = 'Permission denied')"),
         "no permission to write"),
        (OSError(errno.ENAMETOOLONG, "File name too long"), "cannot be written"),
    ],
)  # fmt: skip
def test_what_disks_say_becomes_one_error(tmp_path, error, what):
    with pytest.raises(StorageError, match=what) as caught, disk(tmp_path / "a"):
        raise error
    assert caught.value.where == str(tmp_path / "a")
    assert "-o" in caught.value.hint
    assert ("make room" in caught.value.hint) == (what == "the disk is full")


def test_our_own_errors_pass_through(tmp_path):
    # MissingFileError is an OSError too and would be told twice.
    for error in (DataError("mine"), MissingFileError("mine")):
        with pytest.raises(type(error), match=r"^mine$"), disk(tmp_path):
            raise error


def test_a_place_is_tried_before_the_work(tmp_path):
    check_replaceable(tmp_path / "a")
    assert list(tmp_path.iterdir()) == []
    for target, what in (
        (tmp_path / "no" / "a", "folder does not exist"),
        (tmp_path, "a folder is in the way"),
        (tmp_path / ("x" * 253), "cannot be written"),  # room for the name, none for `.tmp`
    ):
        with pytest.raises(StorageError, match=what) as caught:
            check_replaceable(target)
        assert caught.value.hint
