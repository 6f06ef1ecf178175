"""What is typed for a file that is written is a file's name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mpdt.data.cli import main
from mpdt.train.cli import main as train


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (main, "split x.h5 --quality medium -o d/"),
        (main, "plan ml10 --output=d/"),
        (main, "report x.h5 -o d/"),
        (main, "split x.h5 --quality medium -od/."),
        (train, "submit x --board d/"),
        (train, "rollout x -o d/"),
        (train, "report x --html d/"),
        (train, "evaluate x --keep d/"),
    ],
)
def test_a_folder_in_the_place_of_a_file_to_write(
    entry: Callable[[list[str]], int | None], words: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    try:
        code = entry(words.split())
    except SystemExit as stop:
        code = stop.code  # type: ignore[assignment]
    assert code == 2 and not list(tmp_path.iterdir())
    assert ": the name of a folder, and a file is to be written" in capsys.readouterr().err


def test_a_folder_may_be_named_as_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", "x.h5", "--to", "npz", "-o", "d/"]) == 2
    assert "x.h5: no such file" in capsys.readouterr().err
    for words in ("bundle x -o d/ --data parts/", "submit x --lock d/"):
        with pytest.raises(SystemExit):
            train(words.split())
        assert "and a file is to be written" not in capsys.readouterr().err
