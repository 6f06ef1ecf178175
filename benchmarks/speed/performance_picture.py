"""The picture of docs/performance.md: per path ours beside the fastest peer and the limit.

    collect cheetah        peer .......... ours . limit        rates, ours = 1, logarithmic

Of a path with several cases the one is shown that says most, named in SHOWN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpdt.draw.chart import Dot, axis_over, row_chart
from mpdt.draw.sheet import Sheet, write_sheet

SHOWN = [
    # path, beginnings of the names of its cases, what the row is called
    ("collecting", "cheetah, expert", "collect cheetah, network"),
    ("collecting", "cheetah, random", "collect cheetah, random"),
    ("collecting", "ant, expert", "collect ant, network"),
    ("collecting", "ant, random", "collect ant, random"),
    ("metaworld", "50 tasks", "collect Meta-World, 50 tasks"),
    ("metaworld_envpool", "ML10's 10 training tasks, uniform", "collect ML10, random"),
    ("metaworld_envpool", "ML10's 10 training tasks, scripts", "collect ML10, scripts"),
    ("storing", "pack", "pack"),
    ("storing", "verify", "verify"),
    ("sampling", "256 windows of 8 tasks", "draw windows"),
    ("training", "update, GPT-2|arithmetic of an update, GPT-2", "update, GPT-2 small"),
    ("acting", "acting, SmolLM2-135M, bfloat16, 1 block, 100", "act, 100 rows"),
    ("pretraining", "PPO on cheetah_dir, simulate", "PPO, simulate"),
]
WIDE, LETTERS = 720, 34
KEYS = {"ours": ("c0", "ours"), "peer": ("c1", "fastest peer"), "limit": ("c3", "limit"),
        "plain": ("c6", "without what makes it fast")}  # fmt: skip


def picture(records: Mapping[str, dict[str, Any]]) -> Sheet:
    """Rows of the cases that were measured."""
    rows, seen = [], set()
    for path, begins, name in SHOWN:
        cases = records.get(path, {"cases": []})["cases"]
        compared = [row for case in cases for row in case["rows"]
                    if case["case"].startswith(tuple(begins.split("|")))]  # fmt: skip
        if not compared:
            continue
        dots = []
        for kind in ("plain", "limit", "peer"):
            # Of several ways of one kind the fastest: the one that ours has to stand beside.
            shares = [1 / row["ours_over_this"] for row in compared if row["kind"] == kind]
            if shares:
                seen.add(kind)
                dots.append(Dot(KEYS[kind][0], max(shares)))
        rows.append((name, [*dots, Dot(KEYS["ours"][0], 1.0)]))
    axis = axis_over([0.01, 10.0, *(dot.value for _, dots in rows for dot in dots)],
                     "rate, ours = 1", is_log=True)  # fmt: skip
    drawn = replace(row_chart("", rows, axis), width=WIDE, letters=LETTERS)
    legend = [entry for kind, entry in KEYS.items() if kind == "ours" or kind in seen]
    return Sheet("ours, peers and limits", [drawn] if rows else [], legend, least_width=WIDE)


def draw(target: Path, records: Mapping[str, dict[str, Any]]) -> None:
    write_sheet(target, picture(records))
