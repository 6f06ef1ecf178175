"""A signal behind the last rename: the same command would refuse what it made itself."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from mpdt.data.store.reader import open_dataset


@pytest.mark.parametrize("late", [False, True])
def test_whoever_is_done_is_not_told_to_go_on(
    collected: Path, run: Callable[..., int], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], late: bool,
) -> None:  # fmt: skip
    assert run("export", collected, "--to", "npz", "-o", "arrays") == 0

    def signalled(path: Path) -> None:
        if path.is_dir() == late:  # the folder is flushed behind the rename
            signal.raise_signal(signal.SIGINT)

    calls = (
        ("again.h5", "sync", ("import", "arrays", "--from", "npz", "-o", "again.h5")),
        ("tables", "sync" if late else "sync_tree",
         ("export", collected, "--to", "d4rl", "-o", "tables")),
    )  # fmt: skip
    for name, flush, words in calls:
        told = signalled if flush == "sync" else lambda path: signal.raise_signal(signal.SIGINT)
        with monkeypatch.context() as patch:
            patch.setattr(f"mpdt.disk.replace.{flush}", told)
            capsys.readouterr()
            assert run(*words) == 130
        hint = capsys.readouterr().err.splitlines()[-1]
        if late:
            assert hint == f"interrupted; {name} is whole, nothing is left to do"
        else:
            assert hint.startswith("interrupted; go on with: mpdt-data ") and name in hint
            assert not Path(name).exists() and run(*words) == 0
    assert open_dataset("again.h5").content_hash == open_dataset(collected).content_hash
