"""What a study says about the claims of the paper, and about ours.

    claim     two rows of a study's tables, the one the paper puts ahead first
    verdict   confirmed: its interval lies above the other's; reversed: below;
              not confirmed: they overlap; not run: a row is missing

The verdict is arithmetic on the tables and nobody's opinion. Our rows are MPDT-E's, whose input map
is trained, where the paper's are MPDT's, whose map is frozen: that is a claim of its own. Where a
row has one seed its interval is over episodes: the verdict holds for these weights, may fall with
the next seed, and says so.
Source of the published figures: Zheng et al. 2024, review text (zero-shot and ablation tables).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mpdt.draw.table import Table
from mpdt.train.evaluate.score import CONSTANT, RANDOM, ZERO
from mpdt.train.study.cells import CellResult
from mpdt.train.study.summary import Row, unseen_rows

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
CLAIMED_OF = ("one-block", "fifty")
"""The studies whose rows the claims name: three seeds of each on cheetah_vel; ml45 and mt50."""
_RANK_1 = "rank-1"
"""MPDT-no-distillation, as `fifty` calls it."""
_OTHER_WEIGHTS = (("MPDT-WP", "trained from scratch"), ("MPDT-WP-frozen", "random and frozen"))
_TOLD = (("", _CROSS), (": task inferred", "infer"))
"""What is compared: the published protocol, and prompts that X and its rewards point at."""


def _on_fifty(data: str, published: Mapping[str, float]) -> tuple[Claim, ...]:
    """The paper's ablations on ml45 or mt50; `published`: its figures by variant."""

    def claim(text: str, ahead: str, behind: str, *variants: str) -> Claim:
        known = [published[name] for name in variants if name in published]
        return Claim(text, data, ahead, behind, (known[0], known[1]) if len(known) == 2 else None)

    return (
        claim("decomposition helps", f"{_RANK_1} {_CROSS}", f"Soft-Prompt-TTA {_CROSS}"),
        claim("distillation helps", f"MPDT-E {_CROSS}", f"{_RANK_1} {_CROSS}"),
        claim("distillation helps: task inferred", "MPDT-E infer", f"{_RANK_1} infer"),
        claim("P_c, adapted, beats P_c o mean P_k, not adapted", f"MPDT-E {_CROSS}",
              f"MPDT-E {_MEAN_START}", "MPDT", "no TTA"),
        claim("adaptation on X helps: P_c o mean P_k", "MPDT-E from cross_mean, adapted",
              f"MPDT-E {_MEAN_START}", "mean start", "no TTA"),
        claim("adaptation on X helps: one soft prompt for all tasks", f"Soft-Prompt-TTA {_CROSS}",
              "Soft-Prompt-TTA not adapted"),
        claim("starting from P_c alone beats P_c o mean P_k", f"MPDT-E {_CROSS}",
              "MPDT-E from cross_mean, adapted", "MPDT", "mean start"),
        claim("a frozen input map is better", f"MPDT {_CROSS}", f"MPDT-E {_CROSS}",
              "MPDT", "MPDT-E"),
        claim("a frozen input map is better: task inferred", "MPDT infer", "MPDT-E infer"),
        *(claim(f"pretrained weights help (against {against}){how}", f"MPDT-E {row}",
                f"{method} {row}")
          for method, against in _OTHER_WEIGHTS for how, row in _TOLD),
        claim("rank 10 is better than rank 1", f"rank-10 {_CROSS}", f"{_RANK_1} {_CROSS}",
              "rank 10", "MPDT"),
        claim("rank 10 is better than rank 1: task inferred", "rank-10 infer", f"{_RANK_1} infer"),
        claim("length 30 is better than length 3", f"{_RANK_1} {_CROSS}", f"length-3 {_CROSS}",
              "MPDT", "length 3"),
        claim("length 30 is better than length 3: task inferred", f"{_RANK_1} infer",
              "length-3 infer"),
        claim("MPDT beats zero-shot Prompt-DT", f"MPDT-E {_CROSS}", "Prompt-DT not adapted",
              "MPDT", "Prompt-DT"),
    )  # fmt: skip


_FIFTY_CLAIMS = (
    *_on_fifty("ml45", {"MPDT": 347.21, "no TTA": 337.80, "mean start": 332.80, "MPDT-E": 301.49,
                        "rank 10": 350.33, "length 3": 110.83, "Prompt-DT": 294.55}),
    *_on_fifty("mt50", {"MPDT": 1559.94, "no TTA": 1304.07, "mean start": 1482.75,
                        "MPDT-E": 380.36, "Prompt-DT": 994.63}),
)  # fmt: skip
_ON_ONE_BLOCK = (_VEL, "cheetah_dir", "ant_dir", "ml10")
"""Families on which `one-block` plans every method; three to five seeds of each on cheetah_vel."""
CLAIMS = (
    *(Claim("decomposition helps", data, f"{_PLAIN} {_CROSS}", f"Soft-Prompt-TTA {_CROSS}")
      for data in _ON_ONE_BLOCK),
    *(Claim(f"distillation helps{how}", data, f"MPDT-E {row}", f"{_PLAIN} {row}")
      for how, row in _TOLD for data in _ON_ONE_BLOCK),
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
    *(Claim("adaptation on X helps: one soft prompt for all tasks", data,
            f"Soft-Prompt-TTA {_CROSS}", "Soft-Prompt-TTA not adapted") for data in _ON_ONE_BLOCK),
    *(Claim("adaptation on X helps: inferred prompts", data, "MPDT-E infer, adapted",
            "MPDT-E infer")
      for data in (_VEL, "cheetah_dir", "ant_dir", "ml10", "mt10")),
    *(Claim("adaptation on X helps: inferred prompts of MPDT-ones", data,
            "MPDT-ones infer, adapted", "MPDT-ones infer")
      for data in (_VEL, "cheetah_dir", "ant_dir", "ml10", "mt10")),
    # Its input map is trained, as MPDT-E's.
    Claim("a sparse loss helps", _VEL, f"MPDT+sparse {_CROSS}", f"MPDT-E {_CROSS}",
          (-138.24, -139.88)),
    *(Claim(f"a frozen input map is better{how}", data, f"MPDT {row}", f"MPDT-E {row}",
            (-139.88, -186.07) if data == _VEL and not how else None)
      for how, row in _TOLD for data in _ON_ONE_BLOCK),
    *(Claim(f"pretrained weights help (against {against}){how}", data, f"MPDT-E {row}",
            f"{method} {row}")
      for method, against in _OTHER_WEIGHTS for how, row in _TOLD for data in _ON_ONE_BLOCK),
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
    *_FIFTY_CLAIMS,
    Claim("ours: task parts near one can be averaged", _VEL, "MPDT-ones infer", "mixture infer"),
    Claim("ours: their mixture beats the nearest prompt", _VEL, "MPDT-ones infer",
          f"{_PLAIN} infer"),
    *(Claim("ours: MPDT-ones beats Prompt-DT, both told the task by X and rewards", data,
            "MPDT-ones infer", "Prompt-DT infer")
      for data in (_VEL, "cheetah_dir", "ant_dir", "ml10", "mt10", "ml45", "mt50")),
    Claim("ours: MPDT-ones beats its like trained from scratch (smaller rate)", _VEL,
          "MPDT-ones infer", "WP-ones infer"),
)  # fmt: skip


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
    if idle is not None and max(ahead.interval[0], behind.interval[0]) <= idle.interval[1]:
        said.append("no better than zero action")
    return ", ".join(said)


def claims_table(cells: Sequence[CellResult]) -> Table:
    """One line per claim, with the rows and intervals behind it."""
    rows = {data: unseen_rows(cells, data) for data in {claim.data for claim in CLAIMS}}
    lines = tuple(
        (claim.text, qualified_verdict(rows[claim.data], claim), claim.data,
         _told(rows[claim.data].get(claim.ahead), claim.ahead),
         _told(rows[claim.data].get(claim.behind), claim.behind),
         " / ".join(f"{value:.1f}" for value in claim.published or ()) or "not public")
        for claim in CLAIMS
    )  # fmt: skip
    columns = ("claim", "verdict", "data", "said to be ahead", "said to be behind", "published")
    return Table("Claims of the paper, and ours", columns, lines)


def verdicts_table(cells: Sequence[CellResult]) -> Table:
    """One line per claim, one column per family: the verdict and both means, - where the claim is
    not asked of the family. What holds on one and not on another stands side by side. The last
    line is what a policy has that has learnt nothing."""
    families = list(dict.fromkeys(claim.data for claim in CLAIMS))
    rows = {data: unseen_rows(cells, data) for data in families}
    lines: dict[str, dict[str, str]] = {}
    for claim in CLAIMS:
        known = rows[claim.data]
        said = qualified_verdict(known, claim)
        if claim.ahead in known and claim.behind in known:
            said += f": {known[claim.ahead].mean:,.0f} / {known[claim.behind].mean:,.0f}"
        lines.setdefault(claim.text, {})[claim.data] = said
    lines["best of zero, random and constant action"] = {
        data: _best_trivial(known) for data, known in rows.items()
    }
    return Table(
        "Verdicts by family", ("claim", *families),
        tuple((text, *(said.get(data, "-") for data in families)) for text, said in lines.items()),
        ("behind each verdict: mean return of the row said to be ahead / behind",),
    )  # fmt: skip


def _best_trivial(rows: Mapping[str, Row]) -> str:
    means = [rows[name].mean for name in (ZERO, RANDOM, CONSTANT) if name in rows]
    known = [mean for mean in means if math.isfinite(mean)]
    return f"{max(known):,.1f}" if known else "-"


def _told(row: Row | None, name: str) -> str:
    if row is None:
        return f"{name}: not run"
    seeds = "1 seed" if row.num_seeds == 1 else f"{row.num_seeds} seeds"
    return f"{name}: {row.mean:.1f} [{row.interval[0]:.1f}, {row.interval[1]:.1f}], {seeds}"
