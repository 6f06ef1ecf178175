"""The leaderboard of this repository: its file, page and pictures, from the stored results.

    python tools/write_leaderboard.py         what `make results` does after the tables

Rows that were submitted stay; rows of the stored cells are made again from them.
"""

from __future__ import annotations

from pathlib import Path

from mpdt.disk import write_bytes
from mpdt.train.board.page import board_page, draw_board, read_published
from mpdt.train.board.rows import read_board
from mpdt.train.board.submit import submit

ROOT = Path(__file__).parents[1]
BOARD = ROOT / "results/leaderboard.csv"
STUDIES = ROOT / "results/studies"


def main() -> None:
    cells = sorted(STUDIES.glob("*/*.json"))
    done = submit(cells, BOARD, ROOT / "datasets.lock", replace=True)
    rows = read_board(BOARD)
    page = board_page(rows, read_published(ROOT / "results/published.csv"), "results")
    write_bytes(ROOT / "docs/leaderboard.md", page.encode(), like=b"# ")
    draw_board(rows, ROOT / "docs/results")
    print(f"{len(rows)} rows, {len(done.added)} of them new; docs/leaderboard.md")


if __name__ == "__main__":
    main()
