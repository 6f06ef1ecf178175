from __future__ import annotations

import pytest

from mpdt.data.verbs.make import _steps
from mpdt.errors import UsageError


def test_horizons_are_steps_in_one_word_or_several():
    assert _steps(("200,500", "77")) == (200, 500, 77)
    assert _steps(()) == ()


@pytest.mark.parametrize("word", ["0", "-5", "fast", "2.5"])
def test_what_is_no_episode_length_is_refused(word):
    with pytest.raises(UsageError, match=f"--horizons: not an episode length.*found {word}"):
        _steps((f"200,{word}",))
