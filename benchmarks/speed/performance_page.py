"""Write docs/performance.md and its picture from the JSON files of results/bench/.

    python benchmarks/speed/performance_page.py

Numbers and verdicts come from the files, whichever are there; what is said about a miss stands in
misses.toml and is printed only where a target was missed. A target that was missed and has no such
words is an error: a page may not leave a reader alone with it.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import performance_picture

from mpdt.draw.table import markdown_table

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results" / "bench"
PAGE, PICTURE = ROOT / "docs" / "performance.md", ROOT / "docs" / "performance.svg"
KNOWN = tomllib.loads(Path(__file__).with_name("misses.toml").read_text())
PATHS = {
    "collecting": "Collecting cheetah and ant",
    "metaworld": "Collecting Meta-World",
    "metaworld_envpool": "Collecting Meta-World, beside EnvPool",
    "own_families": "Families of one's own",
    "storing": "Packing, opening, verifying",
    "sampling": "Drawing windows",
    "larger": "Windows of a file larger than memory",
    "training": "Training",
    "acting": "Acting and adapting",
    "pretraining": "Behaviour networks",
    "remembering": "Memory",
    "growing": "Growth",
    "starting": "Start-up",
}
ACCELERATOR = RESULTS / "accelerator.json"
NO_ACCELERATOR = """
No figures of an accelerator: no machine with one could be had.
`bash benchmarks/speed/accelerator.sh` measures one in five minutes.
"""
HEAD = """# How fast it is, beside what the hardware allows and what others do

![ours, peers and limits of every path](performance.svg)

Written by `make bench` from `results/bench/`; do not edit. Each script runs alone as well
(`python benchmarks/speed/NAME.py`), says in its first lines what is compared, and takes `--rounds`.

Ways of doing the same work run in interleaved rounds; rates are medians, and "ours is" is the
median over rounds of our rate divided by theirs, so a machine that is busy is busy for all.
limit = what the hardware allows; peer = another package, as it comes from PyPI; plain = ours
without what makes it fast; +- is half of what lies between the fastest and the slowest round.

Nothing is judged on a machine that others use: each script looks at it first, and again at the end,
and leaves what is stored as it is where they had more than a tenth of it. Some targets hold for a
class of machine only, which is found out by the scripts.
"""


def number(value: float) -> str:
    if value == 0 or 0.01 <= abs(value) < 1000:
        return f"{value:.3g}"
    return f"{value:,.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.2e}"


def spread(row: dict[str, Any]) -> str:
    """Records of before this was kept have none."""
    return f"{row['spread'] / 2:.0%}" if "spread" in row else ""


def case_table(case: dict[str, Any]) -> str:
    rows = [
        [f"{row['kind']}: {row['name']}", number(row["rate"]), spread(row),
         f"{row['ours_over_this']:.2f} x"]
        for row in case["rows"]
    ]  # fmt: skip
    text = f"\n**{case['case']}** ({case['rounds']} rounds)\n\n"
    text += markdown_table(["", case["unit"], "+-", "ours is"], rows) + "\n"
    return text + (f"\n{case['note'][0].upper()}{case['note'][1:]}.\n" if case["note"] else "")


def verdicts(record: dict[str, Any]) -> list[list[str]]:
    """What was wanted of which class of machine, what was found, and whether that is enough."""
    found = [
        [case["case"], f">= {target['least']:g} x {target['way']}", target.get("only") or "any",
         f"{target['measured']:.2f}", "met" if target["met"] else "**missed**"]
        for case in record["cases"] for target in case["targets"]
    ]  # fmt: skip
    for fact in record["facts"]:
        if fact["met"] is not None:
            least = fact["least"] is not None
            bound = f"{'>=' if least else '<='} {fact['least' if least else 'most']:g}"
            found.append([fact["fact"], f"{bound} {fact['unit']}", "any", number(fact["value"]),
                          "met" if fact["met"] else "**missed**"])  # fmt: skip
    return found


def section(path: str, title: str, record: dict[str, Any]) -> str:
    text = f"\n## {title}\n\n`python benchmarks/speed/{SCRIPTS.get(path, path)}.py`\n"
    for case in record["cases"]:
        text += case_table(case)
    if record["facts"]:
        rows = [
            [fact["fact"] + (f" ({fact['note']})" if fact["note"] else ""),
             f"{number(fact['value'])} {fact['unit']}"]
            for fact in record["facts"]
        ]  # fmt: skip
        text += "\n" + markdown_table(["", "measured"], rows) + "\n"
    missed = any("missed" in row[-1] for row in verdicts(record))
    known = KNOWN.get(path, {})
    if missed:
        if "in_the_way" not in known:
            raise SystemExit(f"error: {path} misses a target; misses.toml does not say why")
        text += f"\n**What stands in the way.** {known['in_the_way']}\n"
    if "next_factor_of_two" in known:
        text += f"\n**What the next factor of two would need.** {known['next_factor_of_two']}\n"
    return text


SCRIPTS = {"metaworld": "metaworld_steps"}


def machine_line(record: dict[str, Any]) -> str:
    m = record["machine"]
    cores = f"{m['cores']} hardware threads"
    if "physical" in m:
        cores += f" of {m['physical']} core{'s' * (m['physical'] > 1)}"
        cores += ", bfloat16" if m["bfloat16"] else ", no bfloat16"
    return f"{m['cpu']}, {cores}, {m['memory_gib']} GiB, {m['system']}"


def accelerator() -> str:
    """What accelerator.sh measured on one."""
    record = json.loads(ACCELERATOR.read_text())
    rows = [[fact["fact"], f"{number(fact['value'])} {fact['unit']}"] for fact in record["facts"]]
    return f"\n## On {record['device']}\n\n" + markdown_table(["", "measured"], rows) + "\n"


def stored() -> dict[str, dict[str, Any]]:
    """The records that are there, in the order of the page."""
    return {path: json.loads(file.read_text())
            for path in PATHS if (file := RESULTS / f"{path}.json").exists()}  # fmt: skip


def page() -> str:
    """The whole page as Markdown."""
    records = stored()
    text = HEAD
    for one in dict.fromkeys(map(machine_line, records.values())):
        text += f"\nMachine: {one}."
    loads = [record["machine"]["load"] for record in records.values()]
    minutes = sum(record["seconds"] for record in records.values()) / 60
    text += (f" Load before the scripts' ends {min(loads):.1f} to {max(loads):.1f}; all of them"
             f" together {minutes:.0f} minutes.")  # fmt: skip
    others = [record["others"] for record in records.values() if record.get("others") is not None]
    text += f" Others had up to {max(others):.0%} of it." if others else ""
    text += "\n"
    versions: dict[str, str] = {}
    for record in records.values():
        versions |= record["versions"]
    text += "\nVersions: " + ", ".join(f"{k} {v}" for k, v in sorted(versions.items())) + ".\n"
    rows = [row for record in records.values() for row in verdicts(record)]
    met = sum("missed" not in row[-1] for row in rows)
    text += f"\n## Targets: {met} of {len(rows)} met\n\n"
    text += markdown_table(["what", "target", "machines", "measured", ""], rows) + "\n"
    text += accelerator() if ACCELERATOR.exists() else NO_ACCELERATOR
    for path, title in PATHS.items():
        if path in records:
            text += section(path, title, records[path])
    return text


def main() -> None:
    PAGE.write_text(page())
    performance_picture.draw(PICTURE, stored())
    print(f"written  {PAGE.relative_to(ROOT)}  {PICTURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
