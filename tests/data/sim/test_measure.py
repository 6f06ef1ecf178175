"""When to stop, what to play next, and that neither order nor interruption counts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mpdt.data.sim import measure as module
from mpdt.data.sim.measure import Campaign, episodes_wanted, measure
from mpdt.data.sim.portions import Player, Portion, kind_of, score_of
from mpdt.data.sim.record import Score, load_entries, place_of
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec
from mpdt.errors import DataError

EXPERT = "expert:" + "00" * 32


def spec(**changes: Any) -> DatasetSpec:
    return msgspec.structs.replace(
        load_catalog().get("cheetah_dir"), **({"tasks": ("forward",), "horizon": 4} | changes)
    )


@pytest.mark.parametrize(
    ("episodes", "std", "wanted"),
    [
        (20, 8.9, 20),  # 8.9 / sqrt(20) = 1.99, under 2 % of 100
        (20, 9.0, 40),  # 2.01
        (40, 12.6, 40),  # 1.99
        (40, 12.7, 80),
        (640, 60.0, 1280),  # 2.37
        (1280, 80.0, 1280),  # 2.24, but nobody plays more
        (30, 0.0, 40),  # an interrupted doubling is finished, whatever is known by then
        (60, 99.0, 80),
    ],
)
def test_episodes_are_doubled_until_two_percent_of_the_span(
    episodes: int, std: float, wanted: int
) -> None:
    assert episodes_wanted(Score(episodes, 7.0, std), 100.0) == wanted
    assert episodes_wanted(Score(episodes, 7.0, std), -100.0) == wanted


def test_without_a_span_or_below_the_cap() -> None:
    assert episodes_wanted(None, None) == episodes_wanted(None, 100.0) == 20
    assert episodes_wanted(Score(20, 0.0, 99.0), None) == 20
    assert episodes_wanted(None, None, cap=10) == 10
    assert episodes_wanted(Score(20, 0.0, 99.0), 100.0, cap=30) == 30


def test_kinds() -> None:
    names = ("zero", "random", "constant+0", "constant-12", EXPERT)
    assert [kind_of(name) for name in names] == ["zero", "random", "constant", "constant", "expert"]


class FakePlayer:
    """Expert 100, random 0 +- 20, all else 0; +- by row. An episode of 2 steps returns half."""

    played: list[Portion] = []  # noqa: RUF012  one list for all copies

    def __init__(self, spec: DatasetSpec, seed: int) -> None: ...

    def __call__(self, portion: Portion) -> tuple[Portion, dict[int, Score]]:
        self.played.append(portion)
        rows = np.arange(portion.first, portion.first + portion.rows)
        middle = 100.0 * (kind_of(portion.policy) == "expert")
        noise = 20.0 * (portion.policy == "random") * (-1.0) ** rows + 1e-3 * rows
        return portion, {h: score_of((middle + noise) * h / 4) for h in portion.horizons}


@pytest.fixture
def player(monkeypatch: pytest.MonkeyPatch) -> type[FakePlayer]:
    FakePlayer.played = []
    monkeypatch.setattr(module, "Player", FakePlayer)
    monkeypatch.setattr(module, "expert_name", lambda ladder, task: EXPERT)
    monkeypatch.setattr(module, "load_shipped", dict)
    return FakePlayer


def rounds(player: type[FakePlayer], policy: str) -> list[tuple[int, int]]:
    return [(p.first, p.rows) for p in player.played if p.policy == policy]


def test_a_campaign_by_hand(player: type[FakePlayer], tmp_path: Path) -> None:
    """Random: std 20.5 / sqrt(20) = 4.6, / sqrt(40) = 3.2, / sqrt(80) = 2.3, / sqrt(160) = 1.6."""
    found = measure(spec(), tmp_path / "r.json", horizons=(2, 4), workers=0)
    assert rounds(player, "random") == [(0, 20), (20, 20), (40, 40), (80, 40), (120, 40)]
    assert rounds(player, EXPERT) == rounds(player, "zero") == [(0, 20)]
    assert {p.horizons for p in player.played} == {(2, 4)}, "both at once"
    (task,) = found.policies
    assert found.done(task, "random", 2) == found.done(task, "random", 4) == 160
    assert found.span(task, 2) == pytest.approx(found.span(task, 4) / 2, abs=1e-5)
    assert load_entries(tmp_path / "r.json") == found.entries
    assert found.steps_left() == 0 and len(player.played) == 5 + 1 + 13


def test_what_is_on_record_is_not_played_again(player: type[FakePlayer], tmp_path: Path) -> None:
    measure(spec(), tmp_path / "r.json", workers=0)
    before = (tmp_path / "r.json").read_bytes()
    player.played = []
    measure(spec(), tmp_path / "r.json", workers=0)
    assert player.played == [] and (tmp_path / "r.json").read_bytes() == before
    measure(spec(), tmp_path / "r.json", horizons=(2, 4), workers=0)
    assert {p.horizons for p in player.played} == {(2,)}
    player.played = []
    measure(spec(), tmp_path / "r.json", workers=0, restart=True)
    assert rounds(player, "zero") == [(0, 20)]


def test_another_seed_counts_anew(player: type[FakePlayer], tmp_path: Path) -> None:
    measure(spec(), tmp_path / "r.json", workers=0)
    player.played = []
    found = measure(spec(), tmp_path / "r.json", workers=0, seed=2)
    assert rounds(player, "zero") == [(0, 20)]
    assert {entry.seed for entry in found.entries.values()} == {2}


def test_some_kinds_need_a_rough_span_only(player: type[FakePlayer], tmp_path: Path) -> None:
    measure(spec(), tmp_path / "r.json", kinds=("zero",), workers=0)
    assert {p.policy: p.rows for p in player.played} == {"random": 20, EXPERT: 20, "zero": 20}


@pytest.mark.parametrize("after", [1, 3, 8, 17])
def test_interrupted_is_uninterrupted(
    player: type[FakePlayer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    measure(spec(), tmp_path / "whole.json", workers=0)
    plain: Callable[..., Any] = module.map_blocks

    def broken(*arguments: Any) -> Any:
        for count, answer in enumerate(plain(*arguments)):
            if count == after:
                raise KeyboardInterrupt
            yield answer

    path = tmp_path / "broken.json"
    with monkeypatch.context() as patch:
        patch.setattr(module, "map_blocks", broken)
        try:
            measure(spec(), path, workers=0)
        except KeyboardInterrupt:
            assert path.exists()
    measure(spec(), path, workers=0)
    assert path.read_bytes() == (tmp_path / "whole.json").read_bytes()


def test_the_order_of_arrival_changes_no_digit(player: type[FakePlayer], tmp_path: Path) -> None:
    def campaign() -> Campaign:
        made = measure(spec(), tmp_path / "r.json", workers=0, cap=80)
        made.cap = 320
        return made

    forward, backward = campaign(), campaign()
    (portions,) = [[p for p in forward.portions() if p.policy == "random"]]
    assert [p.first for p in portions] == [80, 120]
    answers = [FakePlayer(spec(), 1)(p) for p in portions]
    for answer in answers:
        forward.take(*answer)
    backward.take(*answers[1])
    assert backward.done(portions[0].task, "random", 4) == 80, "the early one waits"
    backward.take(*answers[0])
    assert forward.entries == backward.entries


def test_a_target_that_is_something_else_is_refused_first(
    player: type[FakePlayer], tmp_path: Path
) -> None:
    (tmp_path / "r.json").write_text("[]")
    with pytest.raises(DataError):
        measure(spec(), tmp_path / "r.json", workers=0)
    assert player.played == []


@pytest.mark.parametrize("policy", ["random", "constant+1", "expert"])
def test_a_short_horizon_is_the_beginning_of_a_long_one(policy: str) -> None:
    """The simulator, 5 of 12 steps: the same as an episode of 5."""
    player, task = Player(spec(), 1), spec().resolve_tasks()[0]
    _, both = player(Portion(task, policy, (5, 12), 0, 3))
    _, short = player(Portion(task, policy, (5,), 0, 3))
    assert both[5] == short[5] != both[12]


def test_a_portion_is_the_same_inside_a_larger_one() -> None:
    """Networks are evaluated at one width, so the last digit does not depend on the portion."""
    player, task = Player(spec(), 1), spec().resolve_tasks()[0]
    whole = player.episodes(Portion(task, "expert", (4,), 0, 5))
    part = player.episodes(Portion(task, "expert", (4,), 2, 2))
    for one, other in zip(whole[2:4], part, strict=True):
        assert one.observations.tobytes() == other.observations.tobytes()
        assert one.actions.tobytes() == other.actions.tobytes()


def test_metaworld_keys_are_those_of_mt50() -> None:
    """So ml10 and mt50 share what is measured; success is counted per horizon."""
    ml10 = msgspec.structs.replace(load_catalog().get("ml10"), tasks=("reach",), horizon=4)
    task = ml10.resolve_tasks()[0]
    (episode,) = Player(ml10, 1).episodes(Portion(task, "zero", (3,), 6, 1))
    assert episode.seed_key == (6, 43, 5, 0, 6)
    _, scores = Player(ml10, 1)(Portion(task, "zero", (2, 3), 0, 2))
    assert {score.success for score in scores.values()} == {0.0}
    assert place_of(ml10, task, 3)[0] == "sawyer/metaworld/reach"


def test_what_another_process_measures_meanwhile_is_kept(tmp_path: Path) -> None:
    """Two campaigns that add to one file at once: other policies, and other tasks."""
    target = tmp_path / "r.json"
    one = Campaign(spec(), (4,), {}, ("zero",))
    (task,) = spec().resolve_tasks()
    place = place_of(spec(), task, 4)
    empty = module.Entry(scene=place[0], horizon=4, env={}, scores={}, seed=1,
                         versions=module.versions())  # fmt: skip
    one.entries[place] = msgspec.structs.replace(empty, scores={"zero": Score(20, 0.0, 0.0)})
    known = module._save(target, {}, one, 1)
    elsewhere = msgspec.structs.replace(empty, scene="other")
    theirs = msgspec.structs.replace(
        empty, scores={"zero": Score(20, 0.0, 0.0), "random": Score(20, -1.0, 4.0)}
    )
    module.save_entries(target, [theirs, elsewhere], "")
    one.entries[place] = msgspec.structs.replace(empty, scores={"zero": Score(40, 1.0, 0.0)})
    module._save(target, known, one, 1)
    found = load_entries(target)
    assert len(found) == 2
    assert found[place].scores == {"zero": Score(40, 1.0, 0.0), "random": Score(20, -1.0, 4.0)}
