"""The leaderboard: rows from results made by hand, the file, what submit refuses, the page."""

import json
import math
from pathlib import Path

import pytest

from mpdt.data.lock.file import Hashes, LockEntry, Size, lock_bytes
from mpdt.data.spec.entry import spec_hash
from mpdt.errors import DataError, FormatError, UsageError
from mpdt.train.board.page import board_page, draw_board, picture_name, ranking, read_published
from mpdt.train.board.rows import Row, board_csv, read_board, rows_of, standings
from mpdt.train.board.submit import command_of, submit
from mpdt.train.cli import main, parse
from mpdt.train.evaluate.score import MEAN, Score, encode_results
from mpdt.train.run.config import to_plain
from mpdt.train.run.methods import apply_method
from mpdt.train.run.presets import get_preset
from mpdt.train.run.results import scores_in
from mpdt.train.run.show import command_text

ROOT = Path(__file__).parents[3]
CONTENT = "ab" * 32


def scores(method, levels, reads="X", block="test"):
    """Two tasks, returns ten times their levels; -1 where there is no level."""
    tasks = dict(zip(("left", "right"), levels, strict=True))
    tasks[MEAN] = sum(levels) / 2
    return [Score(block=block, task=task, method=method, low=0.0, high=1.0,
                  mean=-1.0 if math.isnan(level) else 10 * level,
                  normalised=level, reads=reads, num_episodes=5)
            for task, level in tasks.items()]  # fmt: skip


def result(folder, name="r", seed=0, levels=(0.2, 0.4), method="MPDT-ones", **header):
    config = to_plain(apply_method(get_preset("demo"), "MPDT-ones")) | {
        "seed": seed,
        "method": method,
    }
    data = {
        "name": "tiny",
        "version": "1.0.0",
        "content_hash": CONTENT,
        "horizon": 9,
        "slice": None,
    }
    head = {"format": "mpdt-results/2", "name": name, "data": data, "config": config,
            "versions": {"mpdt": "0.1.0"}, "complete": True}  # fmt: skip
    rows = [*scores("expert", (1.0, 1.0), None), *scores(f"{method} infer", levels)]
    path = folder / f"{name}.json"
    path.write_bytes(encode_results(head | header, rows))
    return path


@pytest.fixture
def lock(tmp_path):
    spec = {"name": "tiny", "version": "1.0.0"}
    entry = LockEntry(
        version="1.0.0", hashes=Hashes(spec=spec_hash(spec), content=CONTENT, file=CONTENT),
        size=Size(bytes=1, episodes=1, steps=1), spec=spec, runs={}, policies={}, returns={},
        packages={}, platform={},
    )  # fmt: skip
    path = tmp_path / "datasets.lock"
    path.write_bytes(lock_bytes({"tiny": entry}))
    return path


def test_seeds_stand_together_and_the_file_is_the_board(tmp_path, lock):
    """Levels .2 .4 and .6 .8: the IQM of four drops one off each end, (.4 + .6) / 2."""
    board = tmp_path / "board.csv"
    done = submit([result(tmp_path, "a"), result(tmp_path, "b", 1, (0.6, 0.8))], board, lock)
    assert [row.seed for row in done.added] == ["", "0", "1"]
    rows = read_board(board)
    assert board_csv(rows) == board.read_text()
    both, reference = standings(rows)
    assert (reference.rows[0].method, reference.iqm) == ("expert", 1.0)
    assert math.isnan(reference.low)
    assert [row.mean for row in both.rows] == [3.0, 7.0] and both.mean == 5.0
    assert both.iqm == pytest.approx(0.5) and both.low < 0.5 < both.high
    assert both.rows[0].protocol == "X alone (published)"
    assert both.rows[0].levels == (("left", 0.2), ("right", 0.4))
    again = submit([tmp_path / "a.json"], board, lock)
    assert (again.added, again.same) == ((), 2)


def test_seeds_of_trials_are_no_seeds_of_training():
    """Levels of seed 0: .2 and .4, of seed 1: .6 alone; each seed counts once."""
    rows = [
        Row(family="ml10", protocol="3 own episodes", method=f"m-t{again} 3 own episodes",
            seed=str(seed), mean=10 * level, success=level, normalised=level, reads="trials",
            episodes=2, horizon=9, data="ml10 1.0.0", content_hash=CONTENT, code="mpdt 0.1.0",
            command="", levels=(("left", level),))
        for seed, again, level in ((0, 0, 0.2), (0, 1, 0.4), (1, 0, 0.6))
    ]  # fmt: skip
    (one,) = standings(rows)
    assert (one.seeds, one.num_seeds) == ("2 (3 runs)", 2)
    assert one.levels.ravel().tolist() == pytest.approx([0.3, 0.6])
    assert (one.low, one.high) == pytest.approx((0.3, 0.6))
    assert [one.mean, one.success, one.normalised, one.iqm] == pytest.approx([4.5] + 3 * [0.45])
    assert "| m 3 own episodes | 2 (3 runs) | 4.5 | 45% | 0.45 |" in board_page(rows, [], "")
    (one,) = standings(rows[:2])
    assert one.seeds == "1 (2 runs)" and math.isnan(one.low)


def test_columns_that_are_made_of_others_are_made_again(tmp_path, lock):
    """A board of an older version, which put its rows together in another way."""
    board = tmp_path / "board.csv"
    places = [result(tmp_path, "a"), result(tmp_path, "b", 1, (0.6, 0.8))]
    submit(places, board, lock)
    whole = board.read_text()
    assert whole.count(",0.5000,") == 2
    board.write_text(whole.replace(",0.5000,", ",0.7777,"))
    done = submit(places, board, lock)
    assert (done.added, done.remade) == ((), True) and board.read_text() == whole
    assert not submit(places, board, lock).remade


def test_order_does_not_matter(tmp_path, lock):
    a, b = result(tmp_path, "a"), result(tmp_path, "b", 1, (0.6, 0.8))
    for name, order in (("one.csv", [a, b]), ("two.csv", [b, a])):
        for path in order:
            submit([path], tmp_path / name, lock)
    assert (tmp_path / "one.csv").read_text() == (tmp_path / "two.csv").read_text()


def test_data_that_is_not_locked_is_refused(tmp_path, lock):
    board, own = tmp_path / "board.csv", {"version": "1.0.0", "horizon": 9, "slice": None}
    other = {"name": "tiny", "content_hash": "cd" * 32} | own
    with pytest.raises(DataError, match="other episodes of tiny than") as error:
        submit([result(tmp_path, data=other)], board, lock)
    assert error.value.expected == "content abababababab" and error.value.found == "cdcdcdcdcdcd"
    with pytest.raises(
        DataError, match="does not hold; expected a data set of that lock, found my"
    ):
        submit([result(tmp_path, data=other | {"name": "my"})], board, lock)
    good = result(tmp_path, "good")
    with pytest.raises(DataError):
        submit([good, result(tmp_path, data=other)], board, lock)
    assert not board.exists(), "all or none"


def test_what_else_is_refused(tmp_path, lock, capsys):
    board = tmp_path / "board.csv"
    with pytest.raises(UsageError, match="ended by its time limit"):
        submit([result(tmp_path, complete=False)], board, lock)
    with pytest.raises(UsageError, match="no result there"):
        submit([tmp_path / "none"], board, lock)
    for label in ("", "a|b", "a\nb", "expert"):
        with pytest.raises(UsageError, match="--as: no name of a method"):
            submit([result(tmp_path)], board, lock, label)
    with pytest.raises(UsageError, match=r"MPDT-ones infer has no level.* found 9 steps"):
        submit([result(tmp_path, "shorter", levels=(math.nan, math.nan))], board, lock)
    assert not board.exists()
    text = result(tmp_path).read_text()
    (tmp_path / "edited.json").write_text(text.replace('"mean": 2.0', '"mean": 9.0'))
    with pytest.raises(FormatError, match="changed after it was written"):
        submit([tmp_path / "edited.json"], board, lock)
    (tmp_path / "any.json").write_text("{}")
    with pytest.raises(FormatError, match="found no scores"):
        submit([tmp_path / "any.json"], board, lock)
    for words in (["submit"], ["submit", str(tmp_path), "--lock", str(tmp_path / "no.lock")]):
        with pytest.raises(SystemExit) as stopped:
            main(words)
        assert stopped.value.code == 2
    assert "no lock there" in capsys.readouterr().err


def test_another_row_of_the_same_name(tmp_path, lock):
    board = tmp_path / "board.csv"
    submit([result(tmp_path)], board, lock)
    better = result(tmp_path, "better", levels=(0.9, 0.9))
    before = board.read_bytes()
    with pytest.raises(
        UsageError, match=r"another row of tiny, X alone .published.: MPDT-ones infer, seed 0"
    ):
        submit([better], board, lock)
    assert board.read_bytes() == before
    assert submit([better], board, lock, label="mine").added[0].method == "mine infer"
    assert submit([better], board, lock, replace=True).replaced == 1
    ranked = ranking(standings(read_board(board)), "X alone (published)")
    assert [(one.rows[0].method, one.mean) for one in ranked] == [
        ("MPDT-ones infer", 9.0), ("mine infer", 9.0)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new"),
    [("tiny,", "tiny"), ("2.0000", "two"), ("left=", "="), (",seed,", ",seeds,")],
)  # fmt: skip
def test_a_damaged_board_is_refused(tmp_path, lock, old, new):
    board = tmp_path / "board.csv"
    submit([result(tmp_path, levels=(0.2, 0.2))], board, lock)
    board.write_text(board.read_text().replace(old, new, 1))
    with pytest.raises(FormatError, match=r"board.csv, line [123]: not a leaderboard"):
        submit([result(tmp_path, "b", 1)], board, lock)


def test_a_policy_from_outside_has_no_seed(tmp_path, lock, capsys):
    data = {"name": "tiny", "version": "1.0.0", "content_hash": CONTENT, "horizon": 9}
    rows = [*scores("random", (0.0, 0.0), None), *scores("mine:act", (0.5, 0.7), "nothing")]
    path = tmp_path / "mine.json"
    path.write_bytes(encode_results({"name": "mine:act", "data": data}, rows))
    board = tmp_path / "board.csv"
    with pytest.raises(SystemExit) as stopped:
        main(["submit", str(path), "--board", str(board), "--lock", str(lock)])
    assert stopped.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("2 rows added, 0 were there")
    assert lines[2].split() == [
        "tiny",
        "nothing",
        "mine:act",
        "-",
        "6.0",
        "-",
        "0.60",
        "1",
        "of",
        "1",
    ]
    assert read_board(board)[0].command == "mpdt-train evaluate --policy mine:act --data tiny.h5"


@pytest.mark.parametrize("name", ["MPDT-ones", "Prompt-DT", "LaMo"])
@pytest.mark.parametrize("preset", ["demo", "base"])
def test_a_command_brings_back_its_settings(name, preset):
    from mpdt.train.cli import parse_settings

    config = apply_method(get_preset(preset), name)
    plain = to_plain(config) | {"seed": 3, "threads": 2}
    plain["inputs"] |= {"return_clip": False, "previous_action": True}
    plain["adapt"] |= {"starts": ["none", "infer"]}
    from mpdt.train.run.config import from_plain

    changed = from_plain(plain)
    text = command_text(changed, "tiny.h5")
    assert f"--method {name}" in text and len(text) < 250, text
    command, rest = parse("run", text.split(" ")[1:])
    assert to_plain(parse_settings(command, rest)) == to_plain(changed)
    assert command_text(config, "t.h5").split(" ")[-2:] == ["--method", name]


def test_a_cell_is_made_again_by_its_study(tmp_path):
    path = ROOT / "results/studies/one-block/mt10.ones-long.s1.json"
    assert command_of(json.loads(path.read_text()), path) == (
        "mpdt-train study one-block --only mt10.ones-long.s1 --restart"
    )


def test_the_page_shows_what_is_best(tmp_path, lock):
    board = tmp_path / "board.csv"
    submit([result(tmp_path), result(tmp_path, "b", 1, (0.6, 0.8))], board, lock)
    submit([result(tmp_path, "c", 0, (0.1, 0.9))], board, lock, label="mine")
    rows = read_board(board)
    page = board_page(rows, [["tiny", "zero-shot", "theirs", "7", "x", "y"]], "pictures")
    assert "### tiny, reads X alone (published)\n" in page and "| theirs |" in page
    assert page.index("| mine infer | 1 | 5.0 |") > page.index("| MPDT-ones infer | 2 | 5.0 |")
    (picture,) = draw_board(rows, tmp_path)
    drawn = picture.read_text()
    assert picture.name == picture_name("tiny") and "share of tasks and seeds above" in drawn
    assert "chance that MPDT-ones infer beats" in drawn


def test_the_page_counts_weights_that_read_nothing_once():
    """few-shot-all judged them again; ml10's other row and what reads X stay."""
    rows = [
        Row(family="ml10", protocol=protocol, method=f"{label} row", seed="0", mean=mean,
            success=None, normalised=0.1, reads=reads, episodes=2, horizon=9, data="ml10 1.0.0",
            content_hash=CONTENT, code="mpdt 0.1.0", command="", levels=(("left", mean / 10),))
        for label, mean in (("few-shot-all", 3.0), ("ones-long", 3.0), ("MPDT-E", 2.0))
        for protocol, reads in (("nothing", "nothing"), ("X alone (published)", "X"))
    ]  # fmt: skip
    own = standings(rows)
    names = [one.rows[0].method for one in ranking(own, "nothing")]
    assert names == ["ones-long row", "MPDT-E row"]
    assert len(ranking(own, "X alone (published)")) == 3


def test_the_boards_of_this_repository_are_fresh():
    """Else: make results. Of one family; all take seconds."""
    text = (ROOT / "results/leaderboard.csv").read_text()
    rows = read_board(ROOT / "results/leaderboard.csv")
    made = {}
    for path in sorted((ROOT / "results/studies").glob("*/ant_dir.*.json")):
        content = json.loads(path.read_text())
        for row in rows_of(content, scores_in(content), "ant_dir", command_of(content, path)):
            made.setdefault(row.key, row)
    assert len(made) > 30
    assert {row.key: row for row in rows if row.key in made} == made
    assert [line for line in text.splitlines() if line.startswith("ant_dir,")] == (
        board_csv(row for row in rows if row.family == "ant_dir").splitlines()[1:]
    )
    page = (ROOT / "docs/leaderboard.md").read_text()
    others = read_published(ROOT / "results/published.csv")
    own = board_page([row for row in rows if row.family == "ant_dir"], others, "results")
    assert own[own.index("## ant_dir") : own.index("## Pub")] in page
    assert own[own.index("## Pub") :] in page
