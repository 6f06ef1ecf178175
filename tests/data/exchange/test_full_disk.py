"""An export that the disk refuses is one error, whatever library writes it."""

from __future__ import annotations

import gc
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mpdt.data.exchange import hdf5

RUN = "import sys; from mpdt.data.cli import main; sys.exit(main())"


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.parametrize("form", ["d4rl", "minari", "npz", "parquet"])
def test_one_error_and_nothing_left(form: str, collected: Path, tmp_path: Path) -> None:
    words = ["export", str(collected), "--to", form, "-o", str(tmp_path / "ex")]
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words], capture_output=True, text=True, check=False,
        preexec_fn=limited,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr[-500:]
    assert done.stderr.startswith(f"error: {tmp_path / 'ex'}: the disk is full; found")
    assert len(done.stderr.strip().splitlines()) == 2, "the error and its hint"
    assert not list(tmp_path.iterdir())


def test_a_new_hdf5_file_holds_what_was_written(tmp_path: Path) -> None:
    values = np.random.Generator(np.random.PCG64(0)).normal(size=(5000, 7))
    with hdf5.created(tmp_path / "x.hdf5") as file:
        file["a/b"] = values
        file["a"].attrs["text"] = "word"
        np.testing.assert_array_equal(file["a/b"][4000:4010], values[4000:4010])
    with hdf5.opened(tmp_path / "x.hdf5") as file:
        np.testing.assert_array_equal(hdf5.array(file, "a/b", "x"), values)
        assert file["a"].attrs["text"] == "word"


def test_what_fails_for_another_reason_is_that(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), hdf5.created(tmp_path / "x.hdf5"):
        raise ZeroDivisionError


def test_a_signal_before_the_file_is_closed_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 closes it with its last object, when the stream is gone, and would complain of that."""

    def ended(self: object) -> None:
        raise KeyboardInterrupt

    told: list[object] = []
    monkeypatch.setattr("sys.unraisablehook", told.append)
    with monkeypatch.context() as patch:
        patch.setattr("h5py.File.close", ended)
        with pytest.raises(KeyboardInterrupt), hdf5.created(tmp_path / "x.hdf5") as file:
            file["a"] = np.arange(3)
    del file
    gc.collect()
    assert told == []


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    return lambda: monkeypatch.setattr(hdf5._Kept, "_put", refuse)


def test_a_refusal_in_the_middle_comes_once(tmp_path: Path, refused: Callable[[], None]) -> None:
    with (
        pytest.raises(OSError, match="No space left") as caught,
        hdf5.created(tmp_path / "x") as file,
    ):
        file["a"] = np.zeros(100)
        refused()
        for i in range(50):
            file[f"b{i}"] = np.zeros(1000)
    assert caught.value.errno == 28
