"""What the system will not show is not called empty or damaged, and not left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from rights import without_rights

CLOSED = "cannot be opened; found [Errno 13] Permission denied"


@pytest.mark.long
def test_a_closed_folder_is_not_an_empty_one(tmp_path: Path) -> None:
    (tmp_path / "ex/sub").mkdir(parents=True)
    (tmp_path / "ex/a.txt").write_text("a")
    (tmp_path / "ex/sub/b.txt").write_text("b")
    (tmp_path / "ok").mkdir()
    (tmp_path / "ok/a.txt").write_text("a")
    (tmp_path / "x.h5").write_bytes(b"")
    (tmp_path / "x.h5").chmod(0)
    (tmp_path / "ex/sub").chmod(0)
    for words in (("push", "ex", "there"), ("push", "ex/sub", "there"), ("report", "ex/sub")):
        code, err = without_rights("mpdt.data.cli", *words, cwd=tmp_path)
        assert code == 1 and err.startswith(f"error: ex/sub: {CLOSED}"), err
        assert err.splitlines()[1] == "hint:  ask whoever owns it (ls -ld shows who)"
        assert not (tmp_path / "there").exists()
    code, err = without_rights("mpdt.data.cli", "push", "ok", "ex/sub/", cwd=tmp_path)
    assert code == 1 and "ask whoever owns it (ls -ld shows who)" in err, err
    code, err = without_rights("mpdt.train.cli", "report", "ex", cwd=tmp_path)
    assert code == 1 and err.startswith(f"error: ex/sub: {CLOSED}"), err
    code, err = without_rights("mpdt.train.cli", "--data", "ex/sub", cwd=tmp_path)
    assert code == 1 and err.startswith(f"error: ex/sub: {CLOSED}"), err
