"""Pictures of episodes: what a notebook sets must not keep matplotlib from being imported."""

import os

import pytest

from mpdt.data.card.picture import forget_screen


@pytest.mark.parametrize(
    ("backend", "kept"),
    [("module://nowhere_at_all.inline", False), ("module://numpy.thing", True), ("agg", True)],
)  # fmt: skip
def test_only_a_backend_that_is_not_here_is_forgotten(
    backend: str, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", backend)
    forget_screen()
    assert (os.environ.get("MPLBACKEND") == backend) is kept
