"""Addresses without their secrets: what may be printed, stored or parsed of a URL.

    sftp://ann:pw@host/x.h5           sftp://***@host/x.h5
    https://host/x.h5?Signature=ab#c  https://host/x.h5?***
    https://host/x.h5;sig=ab          https://host/x.h5;***
    hf://datasets/me/set@main/x.h5    as it is: a revision, no user

Of user, password, parameters, query and fragment nothing stays, whatever they hold: a password
may be typed with the very marks that a URL would have to escape, so all before the last @ goes,
and all of it where a ? or # before that @ leaves open which part is which. `mpdt-data` hides what
was typed before anything else sees it, and `revealed` gives it to the library that connects.
Nothing here imports more than the standard library.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

# One slash is a slip of the hand that must not print a password either.
_URL = re.compile(r"([A-Za-z][\w+.-]*:{1,2})+/+")
_URL_IN_TEXT = re.compile(r"[A-Za-z][\w+.:-]*:/+[^\s'\"<>]+")
# Their keys and revisions hold an @; a user is before one only with a colon, or in the bucket.
_OF_NO_USER = ("s3", "gs", "gcs", "az", "abfs", "hf")
MARK = "***"

_typed: dict[str, str] = {}  # hidden -> as typed, for this process alone


def _parts(url: str) -> tuple[str, str, str, str]:
    """(scheme with its slashes, user and password, host and path, query and fragment)."""
    match = _URL.match(url)
    if match is None:
        return "", "", url, ""
    start, rest = match[0], url[match.end() :]
    authority = rest.partition("/")[0]
    named = "@" in authority or ":" in authority or start.rstrip(":/") not in _OF_NO_USER
    user, at, place = rest.rpartition("@") if named else ("", "", rest)
    if re.search("[?#]", user):
        return start, "", "", rest
    end = re.search(r"[?#]", place)
    cut = end.start() if end else len(place)
    return start, user + at, place[:cut], place[cut:]


def hidden(url: str) -> str:
    """The URL with `***` where its user, password, query or fragment was."""
    start, user, place, query = _parts(url)
    end = query[:1] * bool(place) + MARK if query else ""
    if start and start.rstrip(":/") not in _OF_NO_USER:
        place = without_parameters(place)
    return start + f"{MARK}@" * bool(user) + place + end


def without_parameters(place: str) -> str:
    """A path with `;***` for all from its first parameter on, which may hold slashes."""
    path, mark, _ = place.partition(";")
    return path + mark + MARK * bool(mark)


def hide(words: Sequence[str]) -> list[str]:
    """A command line to show and to parse; `revealed` knows what was typed."""
    safe = [hidden(word) for word in words]
    _typed.update((a, b) for a, b in zip(safe, words, strict=True) if a != b)
    return safe


def revealed(url: str) -> str:
    """What was typed for a URL out of `hide`; any other URL as it is."""
    return _typed.get(url, url)


def without_secrets(text: str, url: str) -> str:
    """A library's words about `url`; none where the URL holds secrets.

    They may quote any part of it in any spelling (escaped, decoded, base64 in a header), so no
    search for the parts would find them all.
    """
    return "" if hidden(url) != url else _URL_IN_TEXT.sub(lambda match: hidden(match[0]), text)


def last_name(url: str) -> str:
    """`x.h5` of `sftp://host/data/x.h5`; empty for a URL that ends with a slash, or a bare host."""
    start, _, place, _ = _parts(url)
    if start:
        place = place.partition(";")[0]
    return place.rpartition("/")[2] if "/" in place or not start else ""
