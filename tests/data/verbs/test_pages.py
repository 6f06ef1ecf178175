"""report and view as users type them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import pytest

from mpdt.data.card import film, picture
from mpdt.data.cli import main
from mpdt.data.verify import replay
from mpdt.errors import SimulatorError

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def simulated(fake_sim: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "make_batch", fake_sim.FakeBatch)


def refuse(*_: Any, **__: Any) -> NoReturn:
    raise SimulatorError("nothing here can draw a picture", hint="apt-get install libosmesa6")


def test_report_writes_the_page_without_pictures_where_none_can_be_drawn(
    tiny_file: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "shoot", refuse)
    assert main(["report", "tiny.h5", "--json", "-q"]) == 0
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert (said["path"], said["films"], err) == ("tiny.html", 0, "")
    page = Path("tiny.html").read_text()
    assert "nothing here can draw a picture. To get them: apt-get install libosmesa6" in page
    assert said["bytes"] == len(page.encode()) and "12 passed" in page


def test_report_films_the_median_episodes_of_the_tasks_named(
    tiny_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """backward: random episodes 16 to 19, of equal expert ones (24 to 27) the second."""
    asked: list[list[int]] = []

    def note(path: Path, ids: list[int]) -> list[film.Film]:
        asked.append(ids)
        return []

    monkeypatch.setattr(film, "shoot", note)
    words = ["report", "tiny.h5", "--no-verify", "-q", "-o", "card.html"]
    for named in (["--film", "backward"], ["--film", "all"], [], ["--film", "none"]):
        assert main([*words, *named]) == 0
    backward, both, default = asked
    assert backward[0] == 25 and backward[1] in range(16, 20)
    assert len(both) == 4 and both[2:] == backward and default == both[:2]
    assert "Not for this page" in Path("card.html").read_text()


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["report", "tiny.h5", "--film", "forwrad"], 2, "did you mean 'forward'"),
        (["report", "tiny.h5:expret"], 2, "did you mean 'expert'"),
        (["report", "tiny.h5", "-o", "no/such/card.html"], 1, "folder does not exist"),
        (["report", "tiny.h5", "--replay", "some"], 2, "cannot read the amount"),
        (["view", "tiny.h5", "-e", "99"], 2, "no episode 99"),
        (["view", "tiny.h5", "-e", "0", "--png", "no/such.png"], 1, "folder does not exist"),
    ],
)
def test_refusals(
    tiny_file: Path, capsys: Capture, words: list[str], code: int, text: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(film, "shoot", refuse)
    monkeypatch.setattr(picture, "expect_package", lambda name: None)
    assert main([*words, "-q"]) == code
    assert text in capsys.readouterr().err
    assert not list(Path().glob("*.html"))


def test_a_slice_gets_a_page_of_its_own_name(tiny_file: Path, capsys: Capture) -> None:
    assert main(["report", "tiny.h5:expert", "--no-verify", "--film", "none"]) == 0
    assert capsys.readouterr().out.startswith("tiny-expert.html   0.")
    assert "slice expert" in Path("tiny-expert.html").read_text()


def test_several_files_are_shown_and_reported_as_one(tiny_file: Path, capsys: Capture) -> None:
    Path("parts").mkdir()
    for name in ("expert", "random"):
        assert main(["split", "tiny.h5", "--quality", name, "-o", f"parts/{name}.h5"]) == 0
    capsys.readouterr()
    assert main(["show", "parts/*.h5", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [file["path"] for file in shown["files"]] == ["parts/expert.h5", "parts/random.h5"]
    assert shown["episodes"] == 16 and set(shown["slices"]) >= {"expert", "random"}
    assert main(["show", "parts/expert.h5,parts/random.h5:expert"]) == 0
    text = capsys.readouterr().out
    assert "8 episodes" in text and "file     parts/random.h5   tiny 1.0.0   content" in text
    assert main(["report", "parts", "--film", "none", "-q"]) == 0
    page = Path("parts/expert-and-1-more.html").read_text()
    assert page.count("expert.h5: ") == page.count("random.h5: ") == 12
    assert "mpdt-data verify expert.h5; mpdt-data verify random.h5" in page


def test_view(tiny_file: Path, capsys: Capture) -> None:
    assert main(["view", "tiny.h5", "-e", "8"]) == 0
    out = capsys.readouterr().out
    assert "tiny.h5   episode 8   forward   expert" in out
    assert out.splitlines()[-1].split() == ["5", "1.000", "0.000", "1.000", "1.000"]
    assert main(["view", "tiny.h5", "-e", "8", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rewards"] == [1.0] * 5


def test_pictures_name_the_extra_they_need(
    tiny_file: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "find_spec", lambda name: None)
    assert main(["view", "tiny.h5", "-e", "8", "--mp4", "x.mp4"]) == 2
    assert "mpdt[pages]" in capsys.readouterr().err


def test_a_picture_and_a_clip(tiny_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of ready-made frames: what the files begin with says what they are."""
    import numpy as np

    def drawn(path: Path, ids: list[int], num_frames: int = 6) -> list[film.Film]:
        frames = np.full((num_frames, film.HEIGHT, film.WIDTH, 3), 120, np.uint8)
        return [film.Film(ids[0], frames, tuple(range(num_frames)), True)]

    monkeypatch.setattr(film, "shoot", drawn)
    assert main(["view", "tiny.h5", "-e", "8", "--png", "e.png", "--mp4", "e.mp4", "-q"]) == 0
    assert Path("e.png").read_bytes().startswith(b"\x89PNG")
    assert Path("e.mp4").read_bytes()[4:8] == b"ftyp"
    assert not list(Path().glob("*.tmp"))


@pytest.mark.parametrize("words", [
    ("report", "--no-verify", "--film", "none", "-o"), ("view", "-e", "0", "--png"),
    ("view", "-e", "0", "--mp4"), ("verify", "--skip", "replay", "--markdown"),
])  # fmt: skip
def test_the_data_are_not_replaced_by_a_page(
    tiny_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    path = Path(shutil.copy(tiny_file, tmp_path / "x.h5"))
    verb, *options = words
    assert main([verb, str(path), *options, str(path)]) == 1
    assert "would replace a file of another kind" in capsys.readouterr().err
    assert path.read_bytes() == tiny_file.read_bytes()
