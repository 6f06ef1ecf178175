"""CITATION.cff is well formed and of this version.

Its keys were validated against the schema of CFF 1.2.0; this guards what changes with releases.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from mpdt import __version__

FILE = Path(__file__).parent.parent / "CITATION.cff"
REQUIRED = {"authors", "cff-version", "message", "title"}


def test_it_names_this_version() -> None:
    found = yaml.load(FILE.read_text(), yaml.BaseLoader)
    assert set(found) >= REQUIRED
    assert (found["cff-version"], found["version"], found["license"]) == (
        "1.2.0", __version__, "MIT",
    )  # fmt: skip
    assert found["references"][0]["doi"].startswith("10.")
    names = [author["family-names"] for author in found["references"][0]["authors"]]
    assert names == ["Zheng", "Shen", "Luo", "Liu", "Shen", "Tao"]
