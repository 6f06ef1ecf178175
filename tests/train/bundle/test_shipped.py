"""The policies of the repository: proved, small, and what their page says they are."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from mpdt.errors import UsageError
from mpdt.train.bundle.build import Bundle
from mpdt.train.bundle.read import read_contents
from mpdt.train.bundle.select import policy_of_bundle

POLICIES = Path(__file__).parents[3] / "policies"
NAMES = ("ant_dir", "cheetah_vel", "ml10")
MOST_BYTES = 1_100_000


def test_there_are_three_and_a_page():
    assert sorted(path.name for path in POLICIES.iterdir()) == ["README.md", *NAMES]


@pytest.mark.parametrize("name", NAMES)
def test_it_can_be_read_and_is_small(name):
    folder = POLICIES / name
    config = read_contents(folder).config
    assert (config.name, config.family.name, config.data.name) == (name, name, name)
    assert config.backbone.shape is None and config.backbone.dtype == "float32"
    assert [one.name for one in config.prompts] == ["own", "infer", "none"]
    assert sum(path.stat().st_size for path in folder.iterdir()) < MOST_BYTES


@pytest.mark.parametrize(("task", "start", "hint"), [
    ("v0.675", "infer", 'v0.675 can act with start="own"'),
    ("v0.600", "own", 'v0.600 can act with start="infer" or start="none"'),
])  # fmt: skip
def test_a_task_without_a_prompt_from_that_start_is_told_which_it_has(task, start, hint):
    config = read_contents(POLICIES / "cheetah_vel").config
    with pytest.raises(UsageError, match=f"'{start}' has no prompt for {task}") as caught:
        policy_of_bundle(Bundle(config, None, None, {}, {}), task, start)
    assert caught.value.hint == hint


def level(card, row):
    """Of the mean over tasks; the last table of a card with that row is of unseen ones."""
    lines = [line for line in card.splitlines() if line.startswith(f"| {row} |")]
    return lines[-1].split("|")[4].strip()


@pytest.mark.parametrize("name", NAMES)
def test_the_page_has_the_levels_of_the_card(name):
    page = (POLICIES / "README.md").read_text()
    card = (POLICIES / name / "README.md").read_text()
    (row,) = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
    told = [row.split("|")[place].strip() for place in (3, 5, 6)]
    rows = ("MPDT-ones", "MPDT-ones infer", "zero action")
    assert told == [level(card, one) for one in rows]


@pytest.mark.parametrize("name", NAMES)
def test_its_card_tells_what_it_reaches_beside_trivial_rows(name):
    card = (POLICIES / name / "README.md").read_text()
    (model,) = yaml.safe_load(card.split("---")[1])["model-index"]
    told = {metric["name"]: metric["value"] for metric in model["results"][0]["metrics"]}
    for block in ("train", "test"):
        for row in ("zero action", "random", "best constant", "expert"):
            assert f"mean return, {block} tasks, {row}" in told
    assert "mean return, test tasks, MPDT-ones infer" in told


def test_the_page_names_the_settings_they_have():
    """One command each, as it stands there."""
    page = (POLICIES / "README.md").read_text().replace("\\\n", "")
    for name in NAMES:
        settings = read_contents(POLICIES / name).config.training.settings
        (line,) = [one for one in page.splitlines() if f"--data {name}.h5" in one]
        words = line.split()
        told = dict(zip(words[1::2], words[2::2], strict=True))
        assert told["--method"] == settings["method"] and told["--name"] == name
        assert told["--steps"] == str(settings["multitask"]["steps"])
        assert told["--prompts.length"] == str(settings["prompts"]["length"])
        assert told["--head.hidden"] == str(settings["head"]["hidden"])
        assert told["--inputs.time-table"] == str(settings["inputs"]["time_table"])
