"""What the system will not show is not called empty or damaged, and not left out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from rights import without_rights

from mpdt.data.cli import main as of_data
from mpdt.train.cli import main as of_training

CLOSED = "cannot be opened; found [Errno 13] Permission denied"


def test_a_closed_folder_is_not_an_empty_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(main: Callable[[list[str]], int], *words: str) -> tuple[int, str]:
        capsys.readouterr()
        code: object = 0
        with without_rights():
            try:
                code = main(list(words))
            except SystemExit as stopped:
                code = stopped.code
        return int(str(code)), capsys.readouterr().err

    monkeypatch.chdir(tmp_path)
    (tmp_path / "ex/sub").mkdir(parents=True)
    (tmp_path / "ex/a.txt").write_text("a")
    (tmp_path / "ex/sub/b.txt").write_text("b")
    (tmp_path / "ok").mkdir()
    (tmp_path / "ok/a.txt").write_text("a")
    (tmp_path / "x.h5").write_bytes(b"")
    (tmp_path / "x.h5").chmod(0)
    (tmp_path / "ex/sub").chmod(0)
    for words in (("push", "ex", "there"), ("push", "ex/sub", "there"), ("report", "ex/sub")):
        code, err = told(of_data, *words)
        assert code == 1 and err.startswith(f"error: ex/sub: {CLOSED}"), err
        assert err.splitlines()[1] == "hint:  ask whoever owns it (ls -ld shows who)"
        assert not (tmp_path / "there").exists()
    for where in ("ex/sub", "ex/sub/"):
        code, err = told(of_data, "push", "ok", where)
        assert code == 1 and "ask whoever owns it (ls -ld shows who)" in err, err
    with without_rights():
        assert of_data(["list"]) == 0
    shown = capsys.readouterr().out
    assert "x.h5" in shown and "cannot be opened" in shown and "damaged" not in shown
    code, err = told(of_training, "report", "ex")
    assert code == 1 and err.startswith(f"error: ex/sub: {CLOSED}"), err
    code, err = told(of_training, "--data", "ex/sub")
    assert code == 1 and err.startswith(f"error: ex/sub: {CLOSED}"), err
