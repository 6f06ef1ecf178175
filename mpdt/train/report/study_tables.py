"""The report of a study: goals and claims first, then the tables of every data set."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from mpdt.disk import disk, write_bytes
from mpdt.draw.table import Table, markdown_page, rich_tables
from mpdt.pipe import table_console
from mpdt.train.evaluate.tables import NORMALISED
from mpdt.train.study.cells import CellResult
from mpdt.train.study.claims import CLAIMED_OF
from mpdt.train.study.goals import GOALS, goals_table
from mpdt.train.study.protocols import protocols_table
from mpdt.train.study.summary import cells_csv, read_cells, studies_in, study_tables
from mpdt.train.study.verdicts import claims_table, verdicts_table


def report_tables(cells: Sequence[CellResult], studies: Sequence[str]) -> list[Table]:
    """All tables of studies, in the order of reading."""
    verdicts = []
    if {cell.data for cell in cells} & {goal.data for goal in GOALS}:
        verdicts = [goals_table(cells), protocols_table(cells)]
    if set(CLAIMED_OF) & set(studies):
        verdicts += [verdicts_table(cells), claims_table(cells)]
    return [*verdicts, *study_tables(cells, *studies)]


def print_study(folder: Path, output: Path | None, as_json: bool) -> None:
    """Tables on stdout (or the cells as JSON); with `output` also as files and pictures."""
    cells = read_cells(folder)
    studies = [study.name for study in studies_in(folder)]
    tables = report_tables(cells, studies)
    if output is not None:  # before anything is printed, whose reader may leave
        from mpdt.train.report.pictures import draw_kept_prompts, draw_study

        with disk(output):
            output.mkdir(parents=True, exist_ok=True)
        markdown = markdown_page({"name": folder.name}, tables, NORMALISED)
        write_bytes(output / "tables.md", markdown.encode(), like=b"# ")
        write_bytes(output / "tables.csv", cells_csv(cells).encode(), like=b"data,cell,seed")
        draw_study(cells, output)
        for study in studies_in(folder):
            draw_kept_prompts(cells, study, output)
    if as_json:
        sys.stdout.write(json.dumps([cell.content for cell in cells]) + "\n")
        return
    console = table_console()
    for table in rich_tables(tables):
        console.print(table)
