"""MTDiff prompts: object arrays of dicts with a visible goal and unclipped actions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.store.dataset import Dataset

Make = Callable[..., Any]
ML10 = ("--from", "mtdiff", "--family", "ml10", "--horizon", 4)


@pytest.fixture
def prompts(tmp_path: Path, episode: Make) -> Path:
    """reach and push of ml10, assembly of none of its tasks; two episodes each."""
    folder = tmp_path / "metaworld_prompts"
    folder.mkdir()
    for first, task in enumerate(("reach", "push", "assembly")):
        episodes = np.empty(2, dtype=object)
        for i in range(2):
            one = episode(4, first * 1000.0 + 10 * i, sizes=(39, 4))
            ends = one.pop("terminals").astype(np.float32)
            episodes[i] = one | {"terminals": ends, "task": f"{task}-v2"}
        if task == "push":
            episodes[1]["actions"][0, 0] = -4.1
        np.save(folder / f"{task}-v2_prompt.npy", episodes, allow_pickle=True)
    (folder / "notes.npy").write_bytes(b"")
    return folder


def test_tasks_of_the_family_with_hidden_goals_and_clipped_actions(
    prompts: Path, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    data: Dataset = imported(prompts, *ML10, "--hide-goal", "--clip-actions")
    assert data.tasks.names == ("reach", "push")
    assert data.episodes.length.tolist() == [4] * 4 and (data.episodes.quality == -1).all()
    assert not data.steps.observations[:, 36:].any()
    np.testing.assert_array_equal(data.episode(0).observations[1, :36], np.arange(39, 75))
    assert data.episode(3).actions[0].tolist() == [-1.0, 0.25, 0.25, 0.25]
    assert data.steps.truncations.sum() == 4 and not data.steps.terminations.any()
    assert data.goals.of(0).shape == (0,) and data.steps.successes is None
    record = data.spec["import"]
    assert record["hide_goal"] and record["sources"][1]["clipped"]["largest"] == 4.1
    error = capsys.readouterr().err
    assert "assembly-v2_prompt.npy: no task of ml10" in error
    assert "notes.npy: not <task>-v2_prompt.npy" in error
    assert "clipped 1 numbers in the actions of 1 episodes, up to 4.1" in error


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        ((*ML10, "--clip-actions"), 1, "reach-v2_prompt.npy: episode 0: columns [36, 37, 38] show"),
        ((*ML10, "--hide-goal"), 1, "push-v2_prompt.npy: episode 1: 1 numbers in actions outside"),
        (("--from", "mtdiff", "--family", "ml10", "--hide-goal"), 1, "--horizon 4"),
        (("--from", "mtdiff", "--family", "ant_dir"), 2, "ant_dir is not of Meta-World"),
        (("--from", "mtdiff", "--family", "mt10", "--hide-goal"), 2, "mt10 hides no columns"),
    ],
)  # fmt: skip
def test_refusals(
    prompts: Path, run: Make, capsys: pytest.CaptureFixture[str],
    words: tuple[Any, ...], code: int, text: str,
) -> None:  # fmt: skip
    assert run("import", prompts, *words, "-o", "x.h5") == code
    assert text in capsys.readouterr().err


def test_families_that_show_the_goal_keep_it(prompts: Path, imported: Make) -> None:
    words = ("--from", "mtdiff", "--family", "mt50", "--horizon", 4, "--clip-actions")
    data: Dataset = imported(prompts, *words, "--quality", "expert")
    assert data.tasks.names == ("assembly", "push", "reach")
    assert data.steps.observations[0, 36:].tolist() == [2036, 2037, 2038]
    assert (data.episodes.quality == 2).all()


def test_a_name_that_says_another_task_than_the_option_is_no_reason_to_skip(
    prompts: Path, run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (*ML10, "--hide-goal", "--clip-actions", "--task", "reach")
    assert run("import", prompts / "assembly-v2_prompt.npy", *words, "-o", "x.h5") == 1
    assert "assembly" in capsys.readouterr().err and not Path("x.h5").exists()
