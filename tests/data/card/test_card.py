"""The page as a whole: what stands on it, and what a hostile file cannot put there."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from makers import make_episode, make_header, source_of

from mpdt.data.card.card import card_page
from mpdt.data.card.facts import Facts
from mpdt.data.card.film import HEIGHT, WIDTH, Film
from mpdt.data.episode import PolicyInfo
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.tables import TaskRow
from mpdt.data.store.writer import write_file
from mpdt.data.verify.verify import CHECKS, verify
from mpdt.draw.html import number, write_page

EVIL = '</title></style><script>alert(1)</script><img src="http://x/y" onerror=alert(1)>{{ 7*7 }}'
EVIL_NAME = EVIL.replace("/", "")  # one with a slash is no name


class Seen(HTMLParser):
    """Every tag and attribute of a page, and its words."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        self.words += data


def film_of(episode: int) -> Film:
    frames = np.zeros((2, HEIGHT, WIDTH, 3), np.uint8)
    return Film(episode, frames, (0, 5), True)


def test_the_card_of_the_tiny_file(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    report = verify(tiny_file, skip=["replay"])
    seen = Seen(card_page(Facts.of(data), None, report, [film_of(8)]))
    for text in ("tiny", "2 tasks", "32 episodes", "160 steps", "licence MIT", data.content_hash,
                 "mpdt-data collect tiny", "not locked", "11 passed", "Every episode has 5 steps",
                 "forward, expert", "byte-equal to what is stored"):  # fmt: skip
        assert text in " ".join(seen.words.split())
    assert all(check in seen.words for check in CHECKS if check != "replay")
    # 1 overview, 1 of all ladders, per task returns and ladder, 6 actions
    assert seen.tags.count("svg") == 1 + 1 + 2 * 2 + 6
    assert seen.tags.count("img") == 2
    assert "step 5" in seen.words and "return 5" in seen.words


def test_the_page_needs_no_network_and_runs_nothing(tiny_file: Path) -> None:
    page = card_page(Facts.of(open_dataset(tiny_file)), None, films=[film_of(8)])
    seen = Seen(page)
    assert not {"script", "link", "iframe", "object"} & set(seen.tags)
    assert all(value.startswith("data:") for name, value in seen.attributes if name == "src")
    assert not [name for name, _ in seen.attributes if name.startswith("on")]
    assert ("content", "default-src 'none'; img-src data:; style-src 'unsafe-inline'") in (
        seen.attributes
    )
    assert "url(" not in page and "@import" not in page


def hostile_file(folder: Path) -> Path:
    """Every text of the file is an attack; of a family that nobody knows."""
    episode = make_episode(
        2, actions=np.full((2, 1), 1e30, np.float32), rewards=np.array([1e30, -3e38], np.float32),
        terminations=np.array([False, True]), truncations=np.zeros(2, bool), quality=-1,
        progress=-1.0, policy=bytes(32), seed_key=(4294967295,) * 5,
    )  # fmt: skip
    header = make_header(
        [episode], [TaskRow(EVIL_NAME, 0, "test", {})], family=EVIL_NAME, name=EVIL_NAME,
        version=EVIL_NAME, license=EVIL, spec={"name": EVIL, EVIL: [EVIL]},
        policies=(PolicyInfo(bytes(32), 0, 0, 0.0, -1, 1.0, EVIL),),
        lineage=({"verb": EVIL, "rule": {EVIL: EVIL + "\n" + EVIL}, "from": [EVIL]},),
        parent="0" * 64,
    )  # fmt: skip
    path = folder / "'><b>.h5"
    return write_file(path, header, source_of([episode])).path


def test_a_hostile_file_shows_its_names_and_nothing_else(tmp_path: Path) -> None:
    path = hostile_file(tmp_path)
    page = card_page(Facts.of(open_dataset(path)), None, verify(path))
    seen = Seen(page)
    assert not {"script", "img"} & set(seen.tags)
    assert not [name for name, _ in seen.attributes if name.startswith("on")]
    assert EVIL in seen.words and EVIL_NAME in seen.words  # as it is, not the 49 of a template
    assert "nan" not in page


@pytest.mark.parametrize(
    ("value", "text"),
    [(-36.14, "-36.1"), (4835.4, "4,835"), (1.23e9, "1.23e+09"), (float("nan"), "–"),  # noqa: RUF001
     (None, "–"), (-0.04, "-0.0"), (float("inf"), "inf")],  # noqa: RUF001
)  # fmt: skip
def test_numbers(value: float | None, text: str) -> None:
    assert number(value) == text


def test_a_name_that_is_no_text_can_be_written(tmp_path: Path) -> None:
    write_page(tmp_path / "p.html", "half a pair: \ud800")
    assert (tmp_path / "p.html").read_bytes() == b"half a pair: ?"


@pytest.mark.parametrize("slice_name", [None, "expert", "paper-mixed"])
def test_every_slice_has_a_card(tiny_file: Path, slice_name: str | None) -> None:
    assert "<svg" in card_page(Facts.of(open_dataset(tiny_file), slice_name), None)
