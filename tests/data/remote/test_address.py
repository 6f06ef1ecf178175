"""What is left of a URL when its secrets are gone, by hand."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mpdt.data.remote.address import hidden, hide, last_name, revealed, without_secrets
from mpdt.train.bundle.travel import cached_name


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("x.h5", "x.h5"),
        ("data/a@b:c?d.h5", "data/a@b:c?d.h5"),
        ("a;b/x;y.h5", "a;b/x;y.h5"),
        ("sftp://host:22/x.h5", "sftp://host:22/x.h5"),
        ("sftp://ann@host/x.h5", "sftp://***@host/x.h5"),
        ("sftp://ann:pw@host:22/x.h5", "sftp://***@host:22/x.h5"),
        ("sftp://ann:p@w/:@host/x", "sftp://***@host/x"),
        ("https://ann:p?w#d@host/x", "https://***"),
        ("https://:pw@host/x", "https://***@host/x"),
        ("https://to/ken@host/x", "https://***@host/x"),
        ("https://host/x?X-Sig=ab&k=c", "https://host/x?***"),
        ("https://host/x?sig", "https://host/x?***"),
        ("https://host/x#sig", "https://host/x#***"),
        ("https://host/x;sig=ab", "https://host/x;***"),
        ("https://host/d;sig=a/b?q", "https://host/d;***?***"),
        ("s3://bucket/a;b/x.h5", "s3://bucket/a;b/x.h5"),
        ("https:/ann:pw@host/x", "https:/***@host/x"),
        ("simplecache::https://ann:pw@host/x", "simplecache::https://***@host/x"),
        ("zip://a.h5::https://ann:pw@host/x.zip", "zip://***@host/x.zip"),
        ("s3://bucket/a@b/x.h5", "s3://bucket/a@b/x.h5"),
        ("s3://KEY:sec/ret@bucket/x.h5", "s3://***@bucket/x.h5"),
        ("s3://KEY@bucket/x.h5", "s3://***@bucket/x.h5"),
        ("hf://datasets/me/set@main/x.h5", "hf://datasets/me/set@main/x.h5"),
    ],
)
def test_hidden(url: str, shown: str) -> None:
    assert hidden(url) == shown
    assert hide(["push", "x.h5", url]) == ["push", "x.h5", shown]
    assert revealed(shown) == url


SECRET = st.text(string.ascii_letters + string.digits + ":/?#@&=%+ '\"\\é", min_size=8)


@given(SECRET, SECRET)
def test_no_secret_of_any_shape_is_shown(user: str, password: str) -> None:
    url = f"https://§{user}§:§{password}§@host.example/d;§{user}§/x.h5;k=§{user}§?sig=§{password}§#§{user}§"
    assert "§" not in hidden(url) and "§" not in last_name(url)


def test_a_librarys_words() -> None:
    text = "GET http://bob:other@host/x?t=1 refused"
    assert without_secrets(text, "webdav://host/x") == "GET http://***@host/x?*** refused"
    assert without_secrets(text, "webdav://ann:p%40w@host/x") == ""


def test_last_name() -> None:
    assert last_name("https://host/data/x.h5?sig=1/2") == "x.h5"
    assert last_name("https://host/data/x.h5#a/b") == "x.h5"
    assert last_name("https://host/data/x.h5;sig=ab") == "x.h5"
    assert last_name("https://ann:s3cret@host") == ""
    assert last_name("sftp://host/data/") == ""
    assert last_name("data/x.h5") == last_name("x.h5") == "x.h5"


def test_the_cache_is_named_after_no_secret() -> None:
    urls = ("sftp://ann:s3cret@host", "https://h/p?k=s3cret", "https://h/p;k=s3cret", "s3://b/ml10")
    names = [cached_name(url) for url in urls]
    assert "s3cret" not in "".join(names) and names[3].startswith("ml10-")
