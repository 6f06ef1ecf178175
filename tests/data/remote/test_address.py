"""What is left of a URL when its secrets are gone, by hand."""

from __future__ import annotations

import pytest

from mpdt.data.remote.address import hidden, hide, last_name, revealed, without_secrets


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("x.h5", "x.h5"),
        ("sftp://ann@host/x.h5", "sftp://ann@host/x.h5"),
        ("sftp://ann:pw@host:22/x.h5", "sftp://ann:***@host:22/x.h5"),
        ("sftp://ann:p@w/:@host/x", "sftp://ann:***@host/x"),
        ("https://:pw@host/x", "https://:***@host/x"),
        ("https://token@host/x", "https://***@host/x"),
        ("https://host/x?X-Sig=ab&k=c", "https://host/x?X-Sig=***&k=***"),
        ("s3://bucket/a@b/x.h5", "s3://bucket/a@b/x.h5"),
        ("hf://datasets/me/set@main/x.h5", "hf://datasets/me/set@main/x.h5"),
    ],
)
def test_hidden(url: str, shown: str) -> None:
    assert hidden(url) == shown
    assert hide(["push", "x.h5", url]) == ["push", "x.h5", shown]
    assert revealed(shown) == url


def test_a_librarys_words() -> None:
    url = "webdav://ann:p%40w@host/x?k=sig"
    words = without_secrets("GET http://ann:p%40w@host/x: p@w and sig refused", url)
    assert "p%40w" not in words and "p@w" not in words and "sig" not in words
    assert words.endswith("*** and *** refused")


def test_last_name() -> None:
    assert last_name("https://host/data/x.h5?sig=1/2") == "x.h5"
    assert last_name("sftp://host/data/") == ""
