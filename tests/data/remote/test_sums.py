"""The list of sums: what it accepts, and what it refuses because it leads elsewhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from mpdt.data.remote.sums import dumped, loaded, sums_of
from mpdt.errors import DataError, FormatError

EMPTY = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"  # SHA-256 of nothing


def test_there_and_back(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a/b c.txt").touch()
    (tmp_path / "SHA256SUMS").write_text("an older list is not part of itself")
    found = sums_of(tmp_path)
    assert found == {"a/b c.txt": EMPTY}
    assert dumped(found) == f"{EMPTY}  a/b c.txt\n".encode()
    assert loaded(dumped(found), "here") == found
    assert loaded(f"{EMPTY} *x\n".encode(), "here") == {"x": EMPTY}  # sha256sum -b


@pytest.mark.parametrize(
    "name", ["../x", "/etc/x", "a/../../x", "a//b", "./x", "a\\b", "x.part", "SHA256SUMS", "a\x1bb"]
)
def test_names_that_lead_elsewhere(name: str) -> None:
    with pytest.raises(FormatError, match="not a list of SHA-256 sums"):
        loaded(f"{EMPTY}  ok\n{EMPTY}  {name}\n".encode(), "here")


@pytest.mark.parametrize("content", [b"", b"<html>", b"\xff\n", EMPTY.encode(), b"12  x\n"])
def test_other_pages(content: bytes) -> None:
    with pytest.raises(FormatError, match="not a list of SHA-256 sums"):
        loaded(content, "here")


def test_a_name_that_a_line_cannot_hold(tmp_path: Path) -> None:
    (tmp_path / "a\nb").touch()
    with pytest.raises(DataError, match="cannot be sent"):
        sums_of(tmp_path)
