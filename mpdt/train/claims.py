"""What a study says about the claims of the paper, and how far it is from its goals.

    claim     two rows of a study's tables, the one the paper puts ahead first
    verdict   confirmed: its interval lies above the other's; reversed: below;
              not confirmed: they overlap; not run: a row is missing

The verdict is arithmetic on the tables and nobody's opinion. With one seed the intervals are
over episodes, so it holds for these weights and may fall with the next seed.
Source of the published figures: Zheng et al. 2024, review text (zero-shot and ablation tables).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mpdt.train.report import Table
from mpdt.train.results import EXPERT, MEAN, ZERO
from mpdt.train.summary import CellResult, Row, summarise

Verdict = Literal["confirmed", "reversed", "not confirmed", "not run"]
ZERO_SHOT = ("nothing", "X", "X+rewards")


@dataclass(frozen=True)
class Claim:
    """`ahead` earns more than `behind` on the unseen tasks of `data`, says the paper."""

    text: str
    data: str
    ahead: str
    behind: str
    published: tuple[float, float] | None = None


_CROSS = "from cross, adapted"
_VEL = "cheetah_vel"
CLAIMS = (
    Claim("decomposition helps", _VEL, f"MPDT-no-distillation {_CROSS}",
          f"Soft-Prompt-TTA {_CROSS}"),
    Claim("distillation helps", _VEL, f"MPDT-E {_CROSS}", f"MPDT-no-distillation {_CROSS}"),
    Claim("adaptation on X helps", _VEL, f"MPDT-E {_CROSS}",
          "MPDT-E P_c o mean P_k, not adapted", (-139.88, -145.27)),
    Claim("a frozen input map is better", _VEL, f"MPDT {_CROSS}", f"MPDT-E {_CROSS}",
          (-139.88, -186.07)),
    Claim("pretrained weights help (against trained from scratch)", _VEL, f"MPDT-E {_CROSS}",
          f"MPDT-WP {_CROSS}"),
    Claim("pretrained weights help (against random and frozen)", _VEL, f"MPDT-E {_CROSS}",
          f"MPDT-WP-frozen {_CROSS}"),
    Claim("starting from P_c alone beats P_c o mean P_k", _VEL, f"starts {_CROSS}",
          "starts from cross_mean, adapted", (-139.88, -148.50)),
    Claim("starting from P_c alone beats P_c o one P_k", _VEL, f"starts {_CROSS}",
          "starts from cross_one, adapted", (-139.88, -159.26)),
    Claim("starting from P_c alone beats a random task part", _VEL, f"starts {_CROSS}",
          "starts from cross_random, adapted", (-139.88, -171.75)),
    Claim("rank 10 is better than rank 1", _VEL, f"rank-10 {_CROSS}",
          f"MPDT-no-distillation {_CROSS}", (-135.51, -139.88)),
    Claim("length 30 is better than length 3", _VEL, f"MPDT-no-distillation {_CROSS}",
          f"length-3 {_CROSS}", (-139.88, -299.20)),
    *(Claim("MPDT beats zero-shot Prompt-DT", data, f"MPDT-E {_CROSS}",
            "Prompt-DT not adapted", published)
      for data, published in ((_VEL, (-139.88, -192.38)), ("cheetah_dir", (50.32, -7.92)),
                              ("ant_dir", (121.84, 123.46)), ("ml10", (371.01, 317.31)),
                              ("mt10", (1317.52, 1087.54)))),
)  # fmt: skip


@dataclass(frozen=True)
class Goal:
    """What this project set out to reach, zero-shot, reading at most X and its rewards.

    Attributes:
        share: least mean normalised return of the training tasks in the same cell.
        published: MPDT's figure in the paper.
    """

    mean: float
    share: float
    published: float
    success: float | None = None


GOALS: Mapping[str, Goal] = {
    "cheetah_dir": Goal(850, 0.9, 50.32),
    "cheetah_vel": Goal(-35, 0.9, -139.88),
    "ant_dir": Goal(400, 0.9, 121.84),
    "ml10": Goal(1000, 0.7, 371.01, success=0.3),
    "mt10": Goal(3600, 0.9, 1317.52, success=0.9),
}


def judge_claim(rows: Mapping[str, Row], claim: Claim) -> Verdict:
    """Compare two intervals; `rows` are one data set's test rows by name."""
    ahead, behind = rows.get(claim.ahead), rows.get(claim.behind)
    if ahead is None or behind is None:
        return "not run"
    if ahead.interval[0] > behind.interval[1]:
        return "confirmed"
    return "reversed" if ahead.interval[1] < behind.interval[0] else "not confirmed"


def claims_table(cells: Sequence[CellResult]) -> Table:
    """One line per claim, with the rows and intervals behind it."""
    rows = {data: _test_rows(cells, data) for data in {claim.data for claim in CLAIMS}}
    lines = tuple(
        (claim.text, claim.data, _told(rows[claim.data].get(claim.ahead), claim.ahead),
         _told(rows[claim.data].get(claim.behind), claim.behind),
         " / ".join(f"{value:.1f}" for value in claim.published or ()) or "not public",
         judge_claim(rows[claim.data], claim))
        for claim in CLAIMS
    )  # fmt: skip
    columns = ("claim", "data", "said to be ahead", "said to be behind", "published", "verdict")
    return Table("Claims of the paper", columns, lines)


def goals_table(cells: Sequence[CellResult]) -> Table:
    """Per data set the best zero-shot row, with the number of rows it is the best of."""
    lines = []
    for data, goal in GOALS.items():
        rows = _test_rows(cells, data)
        tried = [row for row in rows.values() if row.reads in ZERO_SHOT]
        if not tried:
            lines.append((data, f">= {goal.mean:g}", "not run", *["-"] * 6))
            continue
        best = max(tried, key=lambda row: row.mean)
        share = _training_share(cells, data, best.method)
        met = best.mean >= goal.mean and share >= goal.share
        if goal.success is not None:
            met = met and (best.success or 0.0) >= goal.success
        lines.append((
            data, f">= {goal.mean:g}" + (f", {goal.success:.0%}" if goal.success else ""),
            f"{best.mean:.1f} [{best.interval[0]:.1f}, {best.interval[1]:.1f}]"
            + ("" if best.success is None else f", {best.success:.0%}"),
            f"{best.method} ({best.reads}; best of {len(tried)})",
            f"{share:.2f} of {goal.share:g}", f"{goal.published:g}",
            *(f"{rows[name].mean:.1f}" if name in rows else "-" for name in (ZERO, EXPERT)),
            "met" if met else "missed",
        ))  # fmt: skip
    columns = ("data", "goal", "reached", "by (reads)", "training tasks", "published", ZERO,
               EXPERT, "verdict")  # fmt: skip
    return Table("Zero-shot goals", columns, tuple(lines))


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
    return f"{name}: {row.mean:.1f} [{row.interval[0]:.1f}, {row.interval[1]:.1f}]"
