"""SFTP: how a URL is read, what is wrong with the own keys, and leaving a silent host."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mpdt.data.remote import secure_shell
from mpdt.data.remote.failure import refusal

Run = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("url", "host", "told", "path"),
    [
        ("sftp://[::1]:2222/data/", "::1", {"port": 2222}, "/data"),
        ("sftp://[::1]/a::b/x.h5", "::1", {}, "/a::b/x.h5"),
        ("sftp://ann@Gpu:7/x", "Gpu", {"username": "ann", "port": 7}, "/x"),
        ("sftp://a:p%40w@gpu/x", "gpu", {"username": "a", "password": "p@w"}, "/x"),
        ("sftp://gpu/~/my data/x.h5", "gpu", {}, "my data/x.h5"),
        ("sftp://gpu/~", "gpu", {}, "."),
        ("sftp://gpu", "gpu", {}, "/"),
        ("sftp://gpu/~ann/x", "gpu", {}, "/~ann/x"),
    ],
)  # fmt: skip
def test_a_url_is_read_as_typed(
    monkeypatch: pytest.MonkeyPatch, url: str, host: str, told: dict[str, Any], path: str
) -> None:
    seen: list[Any] = []

    def shell(*words: str, **options: Any) -> None:
        assert options.pop("skip_instance_cache")
        seen.extend((words, options))

    monkeypatch.setattr(secure_shell, "SecureShell", shell)
    assert secure_shell.connect(url)[1] == path
    assert seen == [(host,), told]


def test_a_login_folder_gets_a_file_and_its_sum(
    sftp: Any, run: Run, collected: Path, tmp_path: Path
) -> None:
    """No folder is before the name: sshfs's own way of writing small files fails there."""
    code, _, err = run("push", collected, f"sftp://127.0.0.1:{sftp.port}/~/home.h5")
    assert (code, err) == (0, "")
    assert Path("home.h5").exists() and Path("home.h5.sha256").exists()  # the server is in here


def test_a_broken_key_is_told_as_one(
    sftp: Any, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".ssh").mkdir()
    url = f"sftp://127.0.0.1:{sftp.port}/x.h5"
    (tmp_path / ".ssh/id_ed25519").write_text("garbage")
    code, _, err = run("pull", url)
    assert code == 1 and "keys or settings of ssh cannot be used" in err and "goes on" not in err
    (tmp_path / ".ssh/id_ed25519").unlink()
    (tmp_path / ".ssh/config").write_text("IdentityFile ~/.ssh/nowhere\n")
    code, _, err = run("pull", url)
    assert code == 1 and "/.ssh/nowhere: a file of ssh cannot be read" in err


def test_a_file_is_left_at_once_where_something_went_wrong() -> None:
    """Ctrl-C is not lost in the answer of a silent host, nor is it waited for at exit."""
    asked: list[bool] = []

    class File(secure_shell._File):
        def __init__(self) -> None:
            self._closed = False

        def _close(self) -> None:
            asked.append(True)

    with pytest.raises(KeyboardInterrupt), File() as broken:
        raise KeyboardInterrupt
    assert broken.closed and not asked
    with File():
        pass
    assert asked == [True]


def test_a_server_without_room_is_not_called_a_broken_connection() -> None:
    failure = type("SFTPFailure", (Exception,), {})()
    told = refusal("sftp://gpu/x.h5", "Failure", failure).render()
    assert "the server says that it failed" in told and "room" in told
    denied = refusal("sftp://gpu/x.h5", "", PermissionError()).render()
    assert "passphrase" in denied
    assert "passphrase" not in refusal("s3://gpu/x.h5", "", PermissionError()).render()
