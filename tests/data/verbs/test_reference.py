"""mpdt-data reference: its table and its refusals; measuring itself is tested in sim/."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from mpdt.data.cli import main
from mpdt.data.sim import measure as module
from mpdt.data.verbs.reference import table
from mpdt.errors import StorageError


def row(policy: str, mean: float, error: float, share: float | None, **more: Any) -> dict[str, Any]:
    return {"task": "reach", "horizon": 200, "policy": policy, "mean": mean, "error": error,
            "episodes": 20, "success": None, "share": share, **more}  # fmt: skip


def test_a_line_per_task_and_horizon() -> None:
    """The worst share is that of a candidate that no column shows."""
    rows = [
        row("random", 10.0, 1.0, 0.01), row("expert", 110.0, 1.5, 0.015, success=0.95),
        row("zero", 2.0, 0.0, 0.0), row("constant+2", 4.0, 1.9, 0.019),
        row("zero", 5.0, 0.5, None, horizon=500),
    ]  # fmt: skip
    _, short, long = table(rows).splitlines()
    assert short.split("  ")[0] == "reach" and "110.0 +- 1.5" in short
    assert short.split()[-4:] == ["80", "0.95", "1.90%", "constant+2"]
    assert long.split()[1] == "500" and long.split()[-3:] == ["20", "-", "-"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--policies", "expret"), "did you mean 'expert'"),
        (("--horizons", "200,x"), "steps, such as 200,500"),
        (("--horizons", "0"), "not an episode length"),
    ],
)
def test_mistakes_come_before_any_measuring(
    workplace: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...], text: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(module, "measure", None)
    assert main(["reference", "tiny", *words]) == 2
    assert text in capsys.readouterr().err


def test_a_file_that_cannot_be_changed_is_told_of_before_any_measuring(
    workplace: Path, collected: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """It takes what was measured at the end, after hours."""

    def refuse(target: Path) -> None:
        raise StorageError("the disk is read-only", where=str(target))

    shutil.copy(collected, "tiny.h5")
    monkeypatch.setattr("mpdt.disk.check_replaceable", refuse)
    monkeypatch.setattr(module, "measure", None)
    assert main(["reference", "tiny.h5"]) == 1
    assert "tiny.h5: the disk is read-only" in capsys.readouterr().err
