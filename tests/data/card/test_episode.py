"""One episode in words, by hand."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np
import pytest

from mpdt.data.card.episode import episode_facts, episode_text, sparkline
from mpdt.data.card.picture import clip_frames
from mpdt.data.store.reader import open_dataset
from mpdt.errors import FormatError, UsageError


@pytest.mark.parametrize(
    ("values", "width", "drawn"),
    [
        ([0, 1, 2, 3, 4, 5, 6, 7], 8, "▁▂▃▄▅▆▇█"),
        ([3.0, 3.0, 3.0], 8, "▁▁▁"),
        ([0.0, math.nan, 1.0], 8, "▁ █"),
        ([math.nan], 8, " "),
        ([0, 2, 4, 6, 10, 12, 14, 16], 4, "▁▃▆█"),  # parts of means 1, 5, 11, 15
    ],
)
def test_sparklines(values: list[float], width: int, drawn: str) -> None:
    assert sparkline(values, width) == drawn


def test_an_episode_of_the_tiny_file(tiny_file: Path) -> None:
    """Episode 8 is the first expert one of forward: 5 steps of reward 1, every action 1."""
    found = episode_facts(open_dataset(tiny_file), 8)
    assert (found["task"], found["quality"], found["length"]) == ("forward", "expert", 5)
    assert found["return_so_far"] == [1, 2, 3, 4, 5] and found["return"] == 5
    assert (found["terminated"], found["truncated"], found["successes"]) == (False, True, None)
    assert found["goal"] == [1.0] and found["seed_key"] == [0, 0, 2, 0, 0]
    assert found["actions"][3] == {"column": 3, "mean": 1.0, "std": 0.0, "min": 1.0, "max": 1.0}
    text = "\n".join(episode_text(found))
    for words in ("tiny.h5   episode 8   forward   expert", "progress 1   goal 1",
                  "seed key 0/0/2/0/0", "truncated after 5 steps", "so far   ▁▃▅▆█",
                  "return 5.00"):  # fmt: skip
        assert words in text
    assert "success" not in text


def test_an_episode_that_is_not_there(tiny_file: Path) -> None:
    with pytest.raises(UsageError, match="no episode 32"):
        episode_facts(open_dataset(tiny_file), 32)


def test_success_is_told_from_its_first_step(tiny_file: Path) -> None:
    found = episode_facts(open_dataset(tiny_file), 8)
    assert "success from step 3" in "\n".join(
        episode_text(found | {"successes": 2, "first_success": 3})
    )
    assert "no success" in "\n".join(episode_text(found | {"successes": 0, "first_success": None}))


def test_clips_run_in_real_time() -> None:
    """80 steps a second: every second one; 20 a second: all, and the first observation."""
    assert clip_frames(500, 0.0125) == (251, 40.0)
    assert clip_frames(200, 0.05) == (201, 20.0)
    assert np.isclose(clip_frames(47, 0.05)[1], 20.0)


def test_a_damaged_episode_is_not_shown(tiny_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "rot.h5"
    with h5py.File(tiny_file) as file:
        at = file["steps/rewards"].id.get_offset() + 4 * (8 * 5 + 2) + 2
    content = bytearray(tiny_file.read_bytes())
    content[at] ^= 4
    path.write_bytes(content)
    assert episode_facts(open_dataset(path), 7)["id"] == 7
    with pytest.raises(FormatError, match="episode 8 does not have the bytes of its digest"):
        episode_facts(open_dataset(path), 8)
