"""Verdicts on claims, claim by claim and family by family.

    confirmed: the interval of the row said to be ahead lies above the other's; reversed: below;
    not confirmed: they overlap; not run: a row is missing

The verdict is arithmetic on the tables and nobody's opinion. Where a row has one seed its interval
is over episodes: the verdict holds for these weights, may fall with the next seed, and says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from mpdt.draw.table import Table
from mpdt.train.evaluate.score import CONSTANT, RANDOM, ZERO
from mpdt.train.study.cells import CellResult
from mpdt.train.study.claims import CLAIMS, FAMILIES, Claim
from mpdt.train.study.summary import Row, unseen_rows

Verdict = Literal["confirmed", "reversed", "not confirmed", "not run"]


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
    asked = {claim.data for claim in CLAIMS}
    families = [data for data in FAMILIES if data in asked]
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
