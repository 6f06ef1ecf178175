"""mpdt.open, collect and windows are the layer below by shorter names."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mpdt
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError, UsageError


def test_collect_is_the_command(
    fakes: Callable[..., None], tiny_file: Path, workplace: Path
) -> None:
    before = open_dataset(tiny_file)
    assert mpdt.open(tiny_file).content_hash == before.content_hash
    again = mpdt.collect("tiny", workplace / "other.h5", workers=0)
    assert again.content_hash == before.content_hash
    few = mpdt.collect("tiny", tasks=["backward"], workers=0, smoke=True)
    assert (few.path.name, few.tasks.names) == ("tiny-smoke.h5", ("backward",))
    with pytest.warns(DeprecationWarning, match="called smoke= now"):
        old = mpdt.collect("tiny", tasks=["backward"], workers=0, tiny=True)
    assert old.path == few.path and old.content_hash == few.content_hash
    with pytest.raises(UsageError, match="did you mean 'tiny'"):
        mpdt.collect("tinny")


def test_remarks_are_warnings(
    fakes: Callable[..., None], tiny_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mpdt.data.collect.collect.check_levels", lambda *_: ["medium is high"])
    with pytest.warns(UserWarning, match="medium is high"):
        mpdt.collect("tiny", "again.h5", workers=0)


def test_windows_by_hand(tiny_file: Path) -> None:
    """Episodes of 5 steps: expert ones of `forward` are 8 to 11 and act 1 in every component."""
    sampler = mpdt.windows(tiny_file, window=3, per_task=4, seed=1, tasks=["forward"],
                           quality="expert")  # fmt: skip
    batch = sampler.batch(0)
    assert batch.observations.shape == (1, 4, 3, 20)
    assert set(batch.episodes.ravel().tolist()) <= {8, 9, 10, 11}
    assert (batch.actions[batch.mask] == 1).all()
    # paid 1 a step: at step t of 5 there are 5 - t to go
    assert (batch.returns_to_go == 5 - batch.timesteps)[batch.mask].all()
    data = mpdt.open(tiny_file)
    again = mpdt.windows(data, window=3, per_task=4, seed=1, tasks=[0], quality="expert")
    assert np.array_equal(again.batch(0).observations, batch.observations)
    other = mpdt.windows(data, window=3, per_task=4, seed=2, tasks=[0], quality="expert")
    assert not np.array_equal(other.batch(0).observations, batch.observations)


def test_windows_of_slices_and_mistakes(tiny_file: Path) -> None:
    sampler = mpdt.windows(f"{tiny_file}:medium", per_task=64)
    assert sampler.batch(0).episodes.shape == (2, 64), "both tasks are trained on"
    quality = mpdt.open(tiny_file).episodes.quality[sampler.batch(0).episodes]
    assert set(quality.ravel().tolist()) == {1}
    with pytest.raises(DataError, match="no episode to train on"):
        mpdt.windows(f"{tiny_file}:medium", quality="expert")
    with pytest.raises(UsageError, match="did you mean 'medium'"):
        mpdt.windows(tiny_file, quality="medum")


def test_names_are_looked_up_late() -> None:
    """Importing costs nothing; using the data layer loads no torch."""
    code = (
        "import sys, mpdt\n"
        "assert not {'numpy', 'h5py', 'torch', 'gymnasium'} & set(sys.modules)\n"
        "assert {'open', 'collect', 'windows', 'load_policy'} <= set(dir(mpdt))\n"
        "mpdt.open, mpdt.collect, mpdt.windows\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'opn'"):
        mpdt.opn  # noqa: B018
