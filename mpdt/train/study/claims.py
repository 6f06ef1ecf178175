"""What a study says about the claims of the paper, and how far it is from its goals.

    claim     two rows of a study's tables, the one the paper puts ahead first
    verdict   confirmed: its interval lies above the other's; reversed: below;
              not confirmed: they overlap; not run: a row is missing

The verdict is arithmetic on the tables and nobody's opinion. Where a row has one seed its interval
is over episodes: the verdict holds for these weights, may fall with the next seed, and says so.
Source of the published figures: Zheng et al. 2024, review text (zero-shot and ablation tables).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mpdt.draw.table import Table
from mpdt.train.evaluate.score import MEAN, REFERENCES, ZERO
from mpdt.train.study.cells import CellResult
from mpdt.train.study.once import NOTHING
from mpdt.train.study.protocols import (
    FEW_SHOT,
    TRIALS,
    X_AND_TRIALS,
    ZERO_SHOT,
    has_own_episodes,
    own_episodes,
)
from mpdt.train.study.summary import Row, summarise

Verdict = Literal["confirmed", "reversed", "not confirmed", "not run"]


@dataclass(frozen=True)
class Claim:
    """`ahead` earns more than `behind` on the unseen tasks of `data`, says the paper."""

    text: str
    data: str
    ahead: str
    behind: str
    published: tuple[float, float] | None = None


_CROSS = "from cross, adapted"
_MEAN_START = "P_c o mean P_k, not adapted"
_VEL = "cheetah_vel"
_PLAIN = "MPDT-no-distillation"
CLAIMED_OF = "one-block"
"""The study whose rows the claims name: three seeds of each on cheetah_vel."""
CLAIMS = (
    Claim("decomposition helps", _VEL, f"{_PLAIN} {_CROSS}", f"Soft-Prompt-TTA {_CROSS}"),
    Claim("distillation helps", _VEL, f"MPDT-E {_CROSS}", f"{_PLAIN} {_CROSS}"),
    Claim("distillation helps: task inferred", _VEL, "MPDT-E infer", f"{_PLAIN} infer"),
    Claim("distillation beats the teacher's prompts as task parts", _VEL, f"MPDT-E {_CROSS}",
          f"MPDT-teacher-parts {_CROSS}", (-139.88, -169.50)),
    # As the paper compares them: another start, and no adaptation.
    *(Claim("P_c, adapted, beats P_c o mean P_k, not adapted", data,
            f"MPDT-E {_CROSS}", f"MPDT-E {_MEAN_START}", published)
      for data, published in ((_VEL, (-139.88, -145.27)), ("cheetah_dir", None), ("ant_dir", None),
                              ("ml10", None), ("mt10", None))),
    # The same start with and without.
    Claim("adaptation on X helps: P_c o mean P_k", _VEL, "MPDT-E from cross_mean, adapted",
          f"MPDT-E {_MEAN_START}"),
    Claim("adaptation on X helps: one soft prompt for all tasks", _VEL,
          f"Soft-Prompt-TTA {_CROSS}", "Soft-Prompt-TTA not adapted"),
    *(Claim("adaptation on X helps: inferred prompts", data, "MPDT-E infer, adapted",
            "MPDT-E infer")
      for data in (_VEL, "cheetah_dir", "ant_dir", "ml10", "mt10")),
    Claim("adaptation on X helps: inferred prompts", _VEL, "MPDT-ones infer, adapted",
          "MPDT-ones infer"),
    Claim("a frozen input map is better", _VEL, f"MPDT {_CROSS}", f"MPDT-E {_CROSS}",
          (-139.88, -186.07)),
    Claim("a frozen input map is better: task inferred", _VEL, "MPDT infer", "MPDT-E infer"),
    *(Claim(f"pretrained weights help (against {against}){how}", _VEL, f"MPDT-E {row}",
            f"{method} {row}")
      for method, against in (("MPDT-WP", "trained from scratch"),
                              ("MPDT-WP-frozen", "random and frozen"))
      for how, row in (("", _CROSS), (": task inferred", "infer"))),
    *(Claim(f"starting from P_c alone beats {what}", _VEL, f"MPDT-E {_CROSS}",
            f"MPDT-E from {start}, adapted", (-139.88, published))
      for what, start, published in (("P_c o mean P_k", "cross_mean", -148.50),
                                     ("P_c o one P_k", "cross_one", -159.26),
                                     ("a random task part", "cross_random", -171.75))),
    Claim("rank 10 is better than rank 1", _VEL, f"rank-10 {_CROSS}", f"{_PLAIN} {_CROSS}",
          (-135.51, -139.88)),
    Claim("rank 10 is better than rank 1: task inferred", _VEL, "rank-10 infer",
          f"{_PLAIN} infer"),
    Claim("length 30 is better than length 3", _VEL, f"{_PLAIN} {_CROSS}", f"length-3 {_CROSS}",
          (-139.88, -299.20)),
    Claim("length 30 is better than length 3: task inferred", _VEL, f"{_PLAIN} infer",
          "length-3 infer"),
    *(Claim("MPDT beats zero-shot Prompt-DT", data, f"MPDT-E {_CROSS}", "Prompt-DT not adapted",
            published)
      for data, published in ((_VEL, (-139.88, -192.38)), ("cheetah_dir", (50.32, -7.92)),
                              ("ant_dir", (121.84, 123.46)), ("ml10", (371.01, 317.31)),
                              ("mt10", (1317.52, 1087.54)))),
    Claim("ours: task parts near one can be averaged", _VEL, "MPDT-ones infer", "mixture infer"),
    Claim("ours: their mixture beats the nearest prompt", _VEL, "MPDT-ones infer",
          f"{_PLAIN} infer"),
    *(Claim("ours: MPDT-ones beats Prompt-DT, both told the task by X and rewards", data,
            "MPDT-ones infer", "Prompt-DT infer")
      for data in (_VEL, "cheetah_dir", "ant_dir", "ml10", "mt10")),
    Claim("ours: MPDT-ones beats its like trained from scratch (smaller rate)", _VEL,
          "MPDT-ones infer", "WP-ones infer"),
)  # fmt: skip


@dataclass(frozen=True)
class Goal:
    """What this project set out to reach on the unseen tasks of `data`.

    Attributes:
        mean: least mean return; None = any.
        share: least mean normalised return of the training tasks in the same cell; None = any.
        published: MPDT's figure in the paper; None = not public.
        success: least share of successes; None = any.
        reads: what a row may have read of the test tasks to count.
        own: episodes of its own on a test task that a row has read; 0 = none.
    """

    data: str
    mean: float | None
    share: float | None = None
    published: float | None = None
    success: float | None = None
    reads: tuple[str, ...] = ZERO_SHOT
    own: int = 0

    @property
    def name(self) -> str:
        if self.own:
            more = "X and " if self.reads == X_AND_TRIALS else ""
            return f"{self.data}, {more}{own_episodes(self.own)}"
        return self.data + {FEW_SHOT: ", few-shot", NOTHING: ", nothing read"}.get(self.reads, "")

    def counts(self, row: Row) -> bool:
        return row.reads in self.reads and has_own_episodes(row.method, self.own)


# What the best published figures and prototypes made look reachable, not what was reached.
# cheetah_dir and ant_dir: 0.97 and 0.95 of what the expert earns.
GOALS = (
    Goal("cheetah_dir", 1163, 0.9, 50.32),
    Goal("cheetah_vel", -18.6, 0.9, -139.88),
    Goal("ant_dir", 1093, 0.9, 121.84),
    Goal("ml10", 1000, 0.7, 371.01, success=0.3),
    Goal("ml45", 1300, success=0.35),
    Goal("ml45", None, success=0.3, reads=NOTHING),
    Goal("mt10", 4000, 0.9, 1317.52, success=0.98),
    Goal("mt50", None, 0.9, success=0.9),
    Goal("cheetah_vel", -30, published=-30.10, reads=FEW_SHOT),
    Goal("ml10", 1800, success=0.55, reads=FEW_SHOT),
    Goal("ml45", 1500, success=0.55, reads=FEW_SHOT),
    Goal("ml10", None, success=0.3, reads=X_AND_TRIALS, own=1),
    Goal("ml10", None, success=0.45, reads=X_AND_TRIALS, own=3),
    Goal("ml10", 2400, success=0.6, reads=X_AND_TRIALS, own=10),
    Goal("ml10", 2000, success=0.5, reads=TRIALS, own=10),
    Goal("ml45", None, success=0.45, reads=X_AND_TRIALS, own=3),
    Goal("ml45", 2200, success=0.6, reads=X_AND_TRIALS, own=10),
    Goal("ml45", None, success=0.5, reads=TRIALS, own=10),
    Goal("cheetah_vel", -24, reads=TRIALS, own=3),
    Goal("cheetah_vel", -20, reads=TRIALS, own=10),
    Goal("ant_dir_endless", 970, reads=TRIALS, own=10),
)


def judge_claim(rows: Mapping[str, Row], claim: Claim) -> Verdict:
    """Compare two intervals; `rows` are one data set's test rows by name."""
    ahead, behind = rows.get(claim.ahead), rows.get(claim.behind)
    if ahead is None or behind is None:
        return "not run"
    if ahead.interval[0] > behind.interval[1]:
        return "confirmed"
    return "reversed" if ahead.interval[1] < behind.interval[0] else "not confirmed"


def qualified_verdict(rows: Mapping[str, Row], claim: Claim) -> str:
    """The verdict, what it rests on, and whether either side has learnt anything."""
    verdict, (ahead, behind) = judge_claim(rows, claim), map(rows.get, (claim.ahead, claim.behind))
    if ahead is None or behind is None:
        return verdict
    said: list[str] = [verdict]
    if min(ahead.num_seeds, behind.num_seeds) == 1:
        said.append("1 seed" if ahead.num_seeds == behind.num_seeds else "1 seed of one side")
    idle = rows.get(ZERO)
    if idle is not None and max(ahead.mean, behind.mean) <= idle.interval[1]:
        said.append("no better than zero action")
    return ", ".join(said)


def claims_table(cells: Sequence[CellResult]) -> Table:
    """One line per claim, with the rows and intervals behind it."""
    rows = {data: _test_rows(cells, data) for data in {claim.data for claim in CLAIMS}}
    lines = tuple(
        (claim.text, qualified_verdict(rows[claim.data], claim), claim.data,
         _told(rows[claim.data].get(claim.ahead), claim.ahead),
         _told(rows[claim.data].get(claim.behind), claim.behind),
         " / ".join(f"{value:.1f}" for value in claim.published or ()) or "not public")
        for claim in CLAIMS
    )  # fmt: skip
    columns = ("claim", "verdict", "data", "said to be ahead", "said to be behind", "published")
    return Table("Claims of the paper, and ours", columns, lines)


def goals_table(cells: Sequence[CellResult]) -> Table:
    """Per goal the best row that may count, with the number of rows it is the best of."""
    columns = ("goal", "verdict", "at least", "reached", "by (reads)", "training tasks",
               "published", *REFERENCES)  # fmt: skip
    lines = tuple(_goal_line(cells, goal) for goal in GOALS)
    return Table("Goals on unseen tasks", columns, lines)


def _goal_line(cells: Sequence[CellResult], goal: Goal) -> tuple[str, ...]:
    asked = [f"{goal.mean:g}"] if goal.mean is not None else []
    wanted = ", ".join(asked + ([f"{goal.success:.0%}"] if goal.success else []))
    rows = _test_rows(cells, goal.data)
    # A cell that judges the weights of another one again says nothing of its training tasks.
    shares = {name: _training_share(cells, goal.data, name) for name in rows}
    tried = [row for row in rows.values() if goal.counts(row)
             and (goal.share is None or math.isfinite(shares[row.method]))]  # fmt: skip
    if not tried:
        return (goal.name, "not run", wanted, *["-"] * 8)
    best = max(tried, key=lambda row: row.mean)
    share = shares[best.method]
    met = (
        (goal.mean is None or best.mean >= goal.mean)
        and (goal.share is None or share >= goal.share)
        and (goal.success is None or (best.success or 0.0) >= goal.success)
    )
    trained = "-" if math.isnan(share) else f"{share:.2f}"
    reached = f"{best.mean:.1f} [{best.interval[0]:.1f}, {best.interval[1]:.1f}]"
    return (
        goal.name, "met" if met else "missed", wanted,
        reached if best.success is None else f"{reached}, {best.success:.0%}",
        f"{best.method} ({best.reads}; seeds: {best.num_seeds}; best of {len(tried)})",
        trained if goal.share is None else f"{trained} of {goal.share:g}",
        "not public" if goal.published is None else f"{goal.published:g}",
        *(_mean(rows.get(name)) for name in REFERENCES),
    )  # fmt: skip


def _test_rows(cells: Sequence[CellResult], data: str) -> dict[str, Row]:
    return {row.method: row for row in summarise([c for c in cells if c.data == data], "test")}


def _training_share(cells: Sequence[CellResult], data: str, method: str) -> float:
    """Mean normalised return of the training tasks in the cells that made a test row."""
    shares = [
        score.normalised
        for cell in cells
        if cell.data == data and method in {own.method for own in cell.scores}
        for score in cell.scores
        if (score.block, score.task, score.method) == ("train", MEAN, cell.label)
    ]
    return sum(shares) / len(shares) if shares else math.nan


def _told(row: Row | None, name: str) -> str:
    if row is None:
        return f"{name}: not run"
    seeds = "1 seed" if row.num_seeds == 1 else f"{row.num_seeds} seeds"
    return f"{name}: {row.mean:.1f} [{row.interval[0]:.1f}, {row.interval[1]:.1f}], {seeds}"


def _mean(row: Row | None) -> str:
    return "-" if row is None or not math.isfinite(row.mean) else f"{row.mean:.1f}"
