from pathlib import Path

import pytest

from mpdt.data.spec.catalog import load_catalog, parse_catalog
from mpdt.data.spec.entry import Behaviour, EpisodeCounts, TtaRule
from mpdt.errors import MissingFileError, SpecError, StorageError, UsageError

GOOD = """
schema: 1
datasets:
  tiny:
    version: "1.0.0"
    family: cheetah_dir
    tasks: [backward, 0]
    horizon: 5
    seed: 7
    block: 3
    behaviour: {network: cheetah_dir, rungs: 4, noise: 1e-1}
    episodes: {random: 2}
    tta: {default: {episodes: 2, preset_return: 3}}
    env: {control_cost: 0}
    license: CC0-1.0
"""


def mistakes(old: str, new: str) -> str:
    assert old in GOOD
    with pytest.raises(SpecError) as caught:
        parse_catalog(GOOD.replace(old, new), "datasets.yaml")
    return caught.value.render()


def test_a_good_entry_is_typed():
    spec = parse_catalog(GOOD, "datasets.yaml")["tiny"]
    assert spec.name == "tiny"
    assert spec.tasks == ("backward", 0)
    assert spec.behaviour == Behaviour(network="cheetah_dir", rungs=4, noise=0.1)
    assert spec.episodes == EpisodeCounts(random=2)
    assert spec.tta == {"default": TtaRule(episodes=2, preset_return=3.0)}
    assert spec.env == {"control_cost": 0.0}


def test_unknown_key_text_is_pinned():
    assert mistakes("{random: 2}", "{mediun: 2}") == (
        "error: datasets.yaml: tiny.episodes: unknown key 'mediun' (did you mean 'medium'?)\n"
        "hint:  allowed: random, medium, expert, history"
    )


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('"1.0.0"', "1.0", ["tiny.version: expected text, found number 1.0", "in quotes"]),
        ("horizon: 5", "horizon: 1e5", ["tiny.horizon: expected a whole number, found number",
                                        "write 100000"]),
        ("seed: 7", "seed: on", ["tiny.seed: expected a whole number, found text 'on'"]),
        ("seed: 7", "seed: true", ["tiny.seed: expected a whole number, found boolean True"]),
        ("control_cost: 0", "control_cost: on", ["tiny.env.control_cost", "write true or false"]),
        ("tasks: [backward, 0]", "tasks: some", ["tiny.tasks: expected 'all' or a list of"]),
        ("preset_return: 3", "preset_return: aut", ["tiny.tta.default.preset_return", "'auto'"]),
        ("episodes: 2, ", "", ["tiny.tta.default: missing key 'episodes'"]),
        ("    block: 3\n", "", ["tiny: missing key 'block'"]),
        ("    block: 3\n", "    blok: 3\n", ["unknown key 'blok' (did you mean 'block'?)",
                                              "missing key 'block'"]),
        ("block: 3", "block: 3\n    block: 4", ["repeated key", "'block' in line 11"]),
        ("block: 3", "name: x\n    block: 3", ["tiny: unknown key 'name'"]),
        ("schema: 1", "schema: 2", ["datasets.yaml: schema: expected 1, found 2"]),
        ("schema: 1", "scheme: 1", ["unknown key 'scheme' (did you mean 'schema'?)"]),
        ("{random: 2}", "3", ["tiny.episodes: expected a block of keys, found number 3"]),
        ("family: cheetah_dir", "family: cheetah_dirr", ["tiny.family: unknown family",
                                                         "did you mean 'cheetah_dir'"]),
    ],
)  # fmt: skip
def test_mistakes_name_the_full_key(old, new, parts):
    text = mistakes(old, new)
    assert all(part in text for part in parts), text
    assert "datasets.yaml" in text


def test_mistakes_of_type_and_of_meaning_come_together():
    text = mistakes("horizon: 5", "horizon: x\n    taks: 3").replace("\n", " ")
    assert "2 mistakes" in text
    other = GOOD.replace("horizon: 5", "horizon: x").replace("backward", "bakward")
    other += "  second: {}\n"
    with pytest.raises(SpecError) as caught:
        parse_catalog(other, "datasets.yaml")
    lines = str(caught.value).splitlines()
    assert lines[0] == "10 mistakes"  # two in the first entry, eight missing keys in the second
    assert "unknown task 'bakward' (did you mean 'backward'?)" in lines[2]


def test_unknown_entry_gets_the_nearest(tmp_path):
    (tmp_path / "d.yaml").write_text(GOOD, encoding="utf-8")
    with pytest.raises(UsageError, match=r"unknown dataset 'tinny' \(did you mean 'tiny'\?\)"):
        load_catalog(tmp_path / "d.yaml").get("tinny")


def test_the_working_folder_comes_before_the_shipped_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = load_catalog()
    assert {"cheetah_dir", "ml10"} <= set(shipped.specs)
    Path("datasets.yaml").write_text(GOOD, encoding="utf-8")
    assert list(load_catalog().specs) == ["tiny"]


def test_shipped_entries():
    specs = load_catalog(Path(__file__).parents[3] / "datasets.yaml").specs
    cheetah, ml10 = specs["cheetah_dir"], specs["ml10"]
    assert (cheetah.horizon, cheetah.block, cheetah.behaviour.noise) == (200, 50, 0.1)
    assert cheetah.episodes == EpisodeCounts(random=200, medium=200, expert=400, history=400)
    assert (ml10.horizon, ml10.block, ml10.behaviour.script) == (500, 10, "metaworld")
    assert ml10.tta["default"] == TtaRule(episodes=20, action_scale=3.0)
    assert len(ml10.resolve_tasks()) == 15


@pytest.mark.parametrize("kind", ["folder", "broken link"])
def test_what_stands_in_for_the_local_file_is_not_passed_over(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    if kind == "folder":
        Path("datasets.yaml").mkdir()
    else:
        Path("datasets.yaml").symlink_to("nowhere.yaml")
    with pytest.raises((StorageError, MissingFileError), match=r"^datasets\.yaml: ") as caught:
        load_catalog()
    assert ("a folder, not a file" in str(caught.value)) == (kind == "folder")
    assert caught.value.hint


def test_missing_and_unreadable_files(tmp_path):
    with pytest.raises(MissingFileError, match=r"nope\.yaml: no such file"):
        load_catalog(tmp_path / "nope.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"a: \xe9")
    with pytest.raises(SpecError, match="not UTF-8"):
        load_catalog(tmp_path / "latin.yaml")
