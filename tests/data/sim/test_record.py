"""The record of references: merging by hand, a strict file, whose expert counts."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mpdt.data.reference import Reference
from mpdt.data.sim import record as module
from mpdt.data.sim.portions import Player, Portion, expert_ladder, score_of
from mpdt.data.sim.record import (
    LOCAL_FILE,
    Entry,
    Score,
    check_target,
    constant_names,
    expert_name,
    find_records,
    load_entries,
    load_shipped,
    local_notice,
    place_of,
    save_entries,
)
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.spec.tasks import get_family
from mpdt.errors import DataError

FORWARD = get_family("cheetah_dir").tasks[0]


def spec(**changes: Any) -> DatasetSpec:
    return msgspec.structs.replace(load_catalog().get("cheetah_dir"), **changes)


def entry(scores: dict[str, Score], horizon: int = 200) -> Entry:
    return Entry(scene="cheetah/direction/1.0", horizon=horizon, env={}, scores=scores, seed=1,
                 versions={"mujoco": "3.3.0"})  # fmt: skip


def test_joined_by_hand() -> None:
    """1, 3 and 5, 7: mean 4; squares 9 + 1 + 1 + 9 = 20 over 3."""
    one, other = score_of(np.array([1.0, 3.0])), score_of(np.array([5.0, 7.0]))
    joined = one.joined(other)
    assert (joined.episodes, joined.mean) == (4, 4.0)
    assert joined.std == pytest.approx(math.sqrt(20 / 3), abs=1e-6)
    assert joined.error == pytest.approx(math.sqrt(20 / 3) / 2, abs=1e-6)


def test_joined_is_the_score_of_all_episodes() -> None:
    """The slow twin: all at once."""
    rng = np.random.default_rng(0)
    returns, wins = rng.normal(1000.0, 300.0, 60), rng.random(60) < 0.3
    parts = [score_of(returns[a:b], wins[a:b]) for a, b in ((0, 20), (20, 45), (45, 60))]
    joined, whole = parts[0].joined(parts[1]).joined(parts[2]), score_of(returns, wins)
    assert joined.episodes == 60 and joined.success == pytest.approx(whole.success)
    assert (joined.mean, joined.std) == pytest.approx((whole.mean, whole.std), abs=1e-5)


def test_scenes_belong_to_no_family() -> None:
    assert get_family("cheetah_vel").scene_of(get_family("cheetah_vel").tasks[2]) == (
        "cheetah/velocity/0.225"
    )
    assert {get_family(n).scene_of(get_family(n).task("reach")) for n in ("ml10", "mt50")} == {
        "sawyer/metaworld/reach"
    }
    assert place_of(spec(env={"control_cost": 0.1}), FORWARD, 50) == (
        "cheetah/direction/1.0", 50, '{"control_cost":0.1}',
    )  # fmt: skip


def test_a_file_comes_back_and_is_written_the_same(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    entries = [entry({"zero": Score(20, 1.5, 0.25, 0.5)}, horizon) for horizon in (200, 100)]
    save_entries(path, entries, "by hand")
    found = load_entries(path)
    assert [place[1] for place in found] == [100, 200]
    assert found[entries[0].place] == entries[0]
    lines = path.read_text().splitlines()
    assert json.loads(path.read_text())["rule"] == "by hand" and len(lines) == 3 + 2 + 1
    before = path.read_bytes()
    save_entries(path, found.values(), "by hand")
    assert path.read_bytes() == before
    assert load_entries(tmp_path / "none.json") == {}


@pytest.mark.parametrize(
    "text",
    [
        "{",
        '{"format":"mpdt-references/1","rule":"","entries":[],"more":1}',
        '{"format":"mpdt-references/1","rule":"","entries":[{"scene":"x"}]}',
        '{"format":"mpdt-references/1","rule":"","entries":[{"scene":"x","horizon":1,"env":{},'
        '"scores":{"zero":{"episodes":1.5,"mean":0,"std":0}},"seed":1,"versions":{}}]}',
    ],
)
def test_another_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / LOCAL_FILE
    path.write_text(text)
    with pytest.raises(DataError, match="not a record of references"):
        check_target(path)
    assert path.read_text() == text


def test_another_format_and_another_kind_of_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / LOCAL_FILE
    path.write_text('{"format":"mpdt-references/2","rule":"","entries":[]}')
    with pytest.raises(DataError, match="another format"):
        load_entries(path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(DataError, match="a folder, not a file"):
        load_entries(tmp_path / "folder")


def ladder(digest: int) -> Any:
    info = SimpleNamespace(hash=bytes([digest]) * 32)
    return SimpleNamespace(policy=lambda *_: (SimpleNamespace(info=info), 1.0))


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch) -> dict[str, Score]:
    """Everything is known of `forward`, of the expert whose hash is all sevens."""
    scores = {name: Score(20, float(i), 2.0) for i, name in enumerate(constant_names(6))}
    scores |= {"random": Score(40, -1.0, 4.0), f"expert:{'07' * 32}": Score(80, 90.0, 8.0, 0.5)}
    one = entry(scores)
    monkeypatch.setattr(module, "load_shipped", lambda: {one.place: one})
    return scores


def test_what_is_on_record(shipped: dict[str, Score], tmp_path: Path) -> None:
    assert expert_name(ladder(7), FORWARD) == "expert:" + "07" * 32
    found = find_records(spec(), ladder(7), tmp_path)
    assert set(found) == {"forward"}, "nothing is known of backward"
    record = found["forward"]
    assert record.by_name["expert"] == Reference(90.0, 8 / math.sqrt(80), 80, 0.5, "shipped")
    assert record.by_name["random"].episodes == 40
    assert [candidate.mean for candidate in record.constants] == [float(i) for i in range(13)]
    assert record.constants[0] == record.by_name["zero"]


def test_another_expert_is_not_on_record(shipped: dict[str, Score], tmp_path: Path) -> None:
    record = find_records(spec(), ladder(8), tmp_path)["forward"]
    assert set(record.by_name) == {"zero", "random"} and len(record.constants) == 13


@pytest.mark.parametrize("changes", [{"horizon": 100}, {"env": {"control_cost": 0.1}}])
def test_another_horizon_or_simulator_is_not_on_record(
    shipped: dict[str, Score], tmp_path: Path, changes: dict[str, Any]
) -> None:
    assert find_records(spec(**changes), ladder(7), tmp_path) == {}


def test_some_candidates_are_no_table(shipped: dict[str, Score], tmp_path: Path) -> None:
    del shipped["constant-3"]
    assert find_records(spec(), ladder(7), tmp_path)["forward"].constants == ()


def test_a_local_score_wins(shipped: dict[str, Score], tmp_path: Path) -> None:
    save_entries(tmp_path / LOCAL_FILE, [entry({"random": Score(1280, -2.0, 3.0)})], "")
    record = find_records(spec(), ladder(7), tmp_path)["forward"]
    assert record.by_name["random"].mean == -2.0 and record.by_name["random"].source == "local"
    assert record.by_name["zero"].source == "shipped"
    assert local_notice({"forward": record}) == "references of 1 task from ./references.json"
    (tmp_path / LOCAL_FILE).unlink()
    assert local_notice(find_records(spec(), ladder(7), tmp_path)) == ""


def test_the_shipped_record_is_precise_and_canonical(tmp_path: Path) -> None:
    """Two percent of the span; Meta-World, whose successes are all or nothing, within seven."""
    book = load_shipped()
    path = Path(module.__file__).parents[1] / "weights" / "references.json"
    rule = json.loads(path.read_text())["rule"]
    save_entries(tmp_path / "again.json", book.values(), rule)
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()
    for found in book.values():
        experts = {name: s for name, s in found.scores.items() if name.startswith("expert:")}
        assert experts, found.scene
        for expert in experts.values():
            span = abs(expert.mean - found.scores["random"].mean)
            rest = [found.scores[name] for name in ("zero", "random")]
            for score in (expert, *rest):
                limit = 0.07 if found.scene.startswith("sawyer") else 0.02
                assert score.error <= limit * span, (found.scene, score)


def test_the_first_shipped_episodes_can_be_played_again() -> None:
    """Zero action of cheetah_dir has 20 episodes: a simulator that changed would show here."""
    _, scores = Player(spec(), seed=1)(Portion(FORWARD, "zero", (200,), 0, 20))
    assert load_shipped()[place_of(spec(), FORWARD, 200)].scores["zero"] == scores[200]


def test_the_shipped_expert_is_the_shipped_network() -> None:
    name = expert_name(expert_ladder(spec()), FORWARD)
    assert name in load_shipped()[place_of(spec(), FORWARD, 200)].scores
