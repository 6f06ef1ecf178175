"""A file or folder is there all at once or not at all, and nothing of anybody else is lost."""

import errno
import os
import stat
from pathlib import Path

import pytest

from mpdt.disk import (
    appearing,
    check_replaceable,
    disk,
    holding,
    last_put,
    replace,
    replacing,
    write_bytes,
)
from mpdt.errors import BusyError, DataError, MissingFileError, StorageError


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
    assert caught.value.hint
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
        (Path(__file__) / "a", "a file is in the way"),
        (Path(__file__) / "b" / "a", "a file is in the way"),
        (tmp_path / ("x" * 253), "cannot be written"),  # room for the name, none for `.tmp`
    ):
        with pytest.raises(StorageError, match=what) as caught:
            check_replaceable(target)
        assert caught.value.hint


def test_a_link_stays_a_link_and_mode_and_group_stay(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    real, link = home / "real", tmp_path / "link"
    real.write_text("old")
    real.chmod(0o440)
    if os.getuid() == 0:
        os.chown(real, 12345, 23456)
    link.symlink_to("home/real")
    before = real.stat()
    with replacing(link) as temporary:
        assert temporary.parent == home, "on the file system of the file itself"
        temporary.write_text("new")
    assert link.readlink() == Path("home/real")
    assert real.read_text() == "new"
    after = real.stat()
    assert (after.st_mode, after.st_uid, after.st_gid) == (
        before.st_mode, before.st_uid, before.st_gid,
    )  # fmt: skip
    assert after.st_ino != before.st_ino


def test_a_new_file_has_the_usual_mode(tmp_path):
    (tmp_path / "usual").write_text("x")
    with replacing(tmp_path / "a"):
        pass
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_link_to_nothing_yet_is_followed_and_one_in_a_circle_refused(tmp_path):
    (tmp_path / "link").symlink_to("real")
    with replacing(tmp_path / "link") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "real").read_text() == "new"
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(StorageError, match="lead nowhere"), replacing(tmp_path / "a"):
        pass


def test_a_users_own_files_of_the_old_names_stay(tmp_path):
    home = tmp_path / "home"
    home.write_text("mine")
    (tmp_path / "c.tmp").symlink_to(home)
    (tmp_path / "ex.tmp").mkdir()
    (tmp_path / "ex.tmp" / "notes").write_text("mine too")
    with replacing(tmp_path / "c") as temporary:
        temporary.write_text("new")
    with appearing(tmp_path / "ex") as folder:
        (folder / "x").write_text("new")
    assert home.read_text() == "mine"
    assert (tmp_path / "ex.tmp" / "notes").read_text() == "mine too"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c", "c.tmp", "ex", "ex.tmp", "home"]


@pytest.mark.parametrize("kind", ["fifo", "device"])
def test_what_is_no_file_is_not_replaced(tmp_path, kind):
    target = tmp_path / "x"
    if kind == "fifo":
        os.mkfifo(target)
    else:
        target.symlink_to("/dev/null")
    with pytest.raises(StorageError, match="not a file"), replacing(target):
        pass
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


@pytest.mark.parametrize("change", ["appears", "grows", "is replaced", "goes"])
def test_what_changed_meanwhile_is_not_replaced(tmp_path, change):
    """By a program that knows nothing of our locks."""
    target = tmp_path / "x"
    if change != "appears":
        target.write_text("old")
    with pytest.raises(BusyError, match="meanwhile"), replacing(target) as temporary:
        temporary.write_text("ours")
        if change in ("appears", "grows"):
            target.write_text("other")
        elif change == "is replaced":
            (tmp_path / "y").write_text("other")
            (tmp_path / "y").replace(target)
        else:
            target.unlink()
    left = [] if change == "goes" else ["x"]
    assert [path.name for path in tmp_path.iterdir()] == left
    assert not left or target.read_text() == "other"


def without_the_call(old, new):
    raise OSError(errno.ENOSYS, "Function not implemented")


@pytest.mark.parametrize("is_old", [False, True])
def test_what_appears_at_the_very_last_moment_is_not_replaced(tmp_path, monkeypatch, is_old):
    target = tmp_path / "x"
    place, name = (os, "link") if is_old else (replace, "_rename_new")
    step = getattr(place, name)

    def late(*args):
        target.write_text("other")
        step(*args)

    if is_old:
        monkeypatch.setattr(replace, "_rename_new", without_the_call)
    monkeypatch.setattr(place, name, late)
    with pytest.raises(BusyError, match="meanwhile"), replacing(target) as temporary:
        temporary.write_text("ours")
    assert target.read_text() == "other"
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


@pytest.mark.parametrize("links", [True, False])
def test_a_system_without_that_call_or_without_hard_links_will_do(tmp_path, monkeypatch, links):
    def refuse(*args):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(replace, "_rename_new", without_the_call)
    if not links:
        monkeypatch.setattr(os, "link", refuse)
    with replacing(tmp_path / "x") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "x").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


def test_a_new_file_gets_its_name_in_one_step(tmp_path, monkeypatch):
    """Killed between two there would be two names, of which one is nobody's."""
    monkeypatch.setattr(os, "link", None)
    with replacing(tmp_path / "x") as temporary:
        temporary.write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


@pytest.mark.parametrize("end", ["is tried", "begins"])
def test_a_signal_behind_the_first_moment_leaves_nothing(tmp_path, monkeypatch, end):
    def signalled(step):
        def after(*args, **options):
            step(*args, **options)
            raise KeyboardInterrupt

        return after

    monkeypatch.setattr(replace, "_make_file", signalled(replace._make_file))
    with pytest.raises(KeyboardInterrupt):
        if end == "is tried":
            check_replaceable(tmp_path / "x")
        else:
            write_bytes(tmp_path / "x", b"new")
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []


def test_a_call_within_another_leaves_its_file(tmp_path):
    with replacing(tmp_path / "x") as temporary:
        for inner in (lambda: write_bytes(tmp_path / "x", b"inner"),
                      lambda: check_replaceable(tmp_path / "x")):  # fmt: skip
            with pytest.raises(StorageError):
                inner()
        temporary.write_text("outer")
    assert (tmp_path / "x").read_text() == "outer"


def test_several_files_in_one_hold_are_no_change_by_others(tmp_path):
    with holding(tmp_path / "x"):
        for text in ("one", "two"):
            write_bytes(tmp_path / "x", text.encode())
    assert (tmp_path / "x").read_text() == "two"


@pytest.mark.parametrize("there", ["file", "folder", "late", "late empty"])
def test_a_folder_appears_where_nothing_is(tmp_path, there):
    target = tmp_path / "ex"
    if there == "file":
        target.write_text("mine")
    if there == "folder":
        target.mkdir()
    with pytest.raises(BusyError), appearing(target) as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "x").write_text("new")
        if there.startswith("late"):
            target.mkdir()
        if there == "late":
            (target / "mine").write_text("mine")
    assert [path.name for path in tmp_path.iterdir()] == ["ex"]
    assert there == "file" or [path.name for path in target.iterdir()] == ["mine"] * (
        there == "late"
    )


def test_everything_is_on_the_disk_before_the_rename_and_the_rename_after(tmp_path, monkeypatch):
    done = []
    fsync, rename, replace = os.fsync, Path.rename, Path.replace

    def note_fsync(handle):
        done.append(Path(f"/proc/self/fd/{handle}").readlink().name[:4])
        fsync(handle)

    def note(kind, act):
        def noted(self, other):
            done.append(kind)
            return act(self, other)

        return noted

    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(Path, "rename", note("rename", rename))
    monkeypatch.setattr(Path, "replace", note("rename", replace))
    place = tmp_path / "p"
    place.mkdir()
    (place / "x").write_text("old")
    write_bytes(place / "x", b"new")
    assert [one[:3] for one in done] == [".x.", "ren", "p"]
    done.clear()
    with appearing(place / "ex") as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "file").write_text("new")
    assert done[-2:] == ["rename", "p"]
    assert sorted(done[:-2]) == [".ex.", "file", "sub"]


def test_a_page_replaces_pages_alone(tmp_path: Path) -> None:
    """Somebody may name it after the data it is about."""
    data, page = tmp_path / "x.h5", tmp_path / "x.html"
    data.write_bytes(b"\x89HDF\r\n\x1a\n")
    page.touch()
    for _ in range(2):  # an empty file, and one of its kind
        check_replaceable(page, like=b"<!doctype")
        write_bytes(page, b"<!doctype html>", like=b"<!doctype")
    for tried in (check_replaceable, lambda path, like: write_bytes(path, b"<!", like=like)):
        with pytest.raises(StorageError, match=r"x.h5: would replace a file of another kind"):
            tried(data, like=b"<!doctype")
    assert data.read_bytes() == b"\x89HDF\r\n\x1a\n"
    assert {path.name for path in tmp_path.iterdir()} == {"x.h5", "x.html"}


def test_what_was_put_last_is_what_is_at_its_place(tmp_path, monkeypatch):
    """A signal may come before the rename or behind it, and the caller has to tell which."""
    target = tmp_path / "a"

    def stopped(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("mpdt.disk.replace._put_new", stopped)
        with pytest.raises(KeyboardInterrupt), replacing(target):
            pass
    assert last_put() is None and not target.exists()
    with replacing(target):
        pass
    assert last_put() == target
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "b"):
        raise KeyboardInterrupt
    assert last_put() is None, "of what was begun since"
