"""`mpdt-train report`: what is known of a run or a study, on stdout and as a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mpdt.errors import UsageError
from mpdt.train.report.study_tables import print_study
from mpdt.train.run.results import read_results
from mpdt.train.run.show import print_results
from mpdt.train.study.summary import is_study, read_cells, studies_in

if TYPE_CHECKING:
    from mpdt.train.options import Report


def show_report(command: Report) -> int:
    """Raises: UsageError for a folder of neither; MpdtError for a damaged one."""
    if not command.folder.is_dir():
        raise UsageError("no folder of a run or a study", where=str(command.folder),
                         expected="a folder with results.json, or with cells of a study",
                         hint="mpdt-train --data FILE makes a run; mpdt-data report FILE is for "
                              "data")  # fmt: skip
    # Files first: whoever reads the tables may leave before their end.
    if is_study(command.folder):
        if command.html is not None:
            from mpdt.train.report.page import study_content, write_result

            studies = [study.name for study in studies_in(command.folder)]
            content = study_content(read_cells(command.folder), command.folder.name, studies)
            write_result(command.html, content)
        print_study(command.folder, command.output, command.json)
        return 0
    results = read_results(command.folder)
    weights = command.folder / "weights.safetensors"
    if command.output is not None and weights.exists():
        from mpdt.train.report.pictures import draw_prompts

        draw_prompts(weights, command.output)
    if command.html is not None:
        from mpdt.train.report.page import run_content, write_result

        write_result(command.html, run_content(results, command.folder))
    print_results(results, command.json)
    return 0
