"""Build the documentation site from the pages of the repository.

    make site                       the generator in an environment of its own, then the walk
    python tools/build_site.py      build/site/html/index.html, which can be opened from the disk

Pages are laid out in build/site/pages and nothing is written twice: the start page is the README,
links between files become links between pages, a page named in a text (`docs/trust.md`) becomes
a link, a data set's card stands under its heading, and the Python reference is rendered from the
docstrings of the names that docs/reference/api.md lists. The notebook is a page with what it
showed when it was run. A link that leads to no page, and any
warning of the generator, ends the build.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

ROOT = Path(__file__).parent.parent
PLACE = ROOT / "build/site"
SETTINGS = ROOT / "tools/site"
NOTEBOOK = "docs/first_steps.ipynb"
OUTSIDE = {
    "README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md", "policies/README.md": "policies/index.md",
    "examples/families/README.md": "families.md", NOTEBOOK: "first_steps.md",
}  # fmt: skip
# Repository folders and files that a page links to, and the page that shows them.
STANDS_FOR = {"docs/decisions": "decisions/index.md", "policies": "policies/index.md"}

FENCE = re.compile(r"^(```.*?^```[^\n]*$)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<=\]\()(?!https?:|#|mailto:)([^)#\s]+)(#[^)\s]*)?(?=\))")
NAMED = re.compile(r"(?<!\[)`((?:docs|policies)/[\w/.-]+|[A-Z]+\.md)`(?!\])")
LIST_BEHIND_TEXT = re.compile(r"^((?![-*] |\d+\. |\s|\|)[^\n]+\n)(?=[-*] |1\. )", re.MULTILINE)
FRONT_MATTER = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
HEADING = re.compile(r"^## (\S+)$", re.MULTILINE)


def main() -> int:
    lay_out()
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    said = subprocess.run(
        command, cwd=PLACE, text=True, check=False, capture_output=True,
        env=os.environ | {"NO_COLOR": "1"},
    )  # fmt: skip
    # griffe's complaints about a docstring are no warnings to the generator.
    complaints = [
        line for line in said.stderr.splitlines() if line.strip() not in ("", "No issues found")
    ]
    if said.returncode or complaints:
        print("\n".join([said.stdout, *complaints]), file=sys.stderr)
        return said.returncode or 1
    pages = sum(1 for _ in (PLACE / "html").rglob("*.html"))
    size = sum(file.stat().st_size for file in (PLACE / "html").rglob("*") if file.is_file())
    print(f"{(PLACE / 'html/index.html').relative_to(ROOT)}   {pages} pages   {size / 1e6:.1f} MB")
    return 0


def lay_out() -> None:
    """build/site: settings and every page, as the generator wants them."""
    shutil.rmtree(PLACE, ignore_errors=True)
    pages = PLACE / "pages"
    shutil.copytree(ROOT / "docs", pages, ignore=shutil.ignore_patterns("*.ipynb"))
    shutil.copy(SETTINGS / "zensical.toml", PLACE)
    shutil.copy(SETTINGS / "style.css", pages)
    where = site_paths()
    for source, page in where.items():
        if source.endswith(".md"):
            target = pages / page
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(page_text(source, where), encoding="utf-8")
    (pages / "decisions/index.md").write_text(decision_list(), encoding="utf-8")
    book = json.loads((ROOT / NOTEBOOK).read_text(encoding="utf-8"))
    text = notebook_text(book["cells"], pages)
    text = outside_fences(text, lambda prose: for_the_site(prose, NOTEBOOK, where))
    (pages / OUTSIDE[NOTEBOOK]).write_text(text, encoding="utf-8")


def site_paths() -> dict[str, str]:
    """Path in the repository -> path in the site, of all that a page may link to."""
    where = {
        file.relative_to(ROOT).as_posix(): file.relative_to(ROOT / "docs").as_posix()
        for file in (ROOT / "docs").rglob("*")
        if file.is_file()
    }
    cards = (ROOT / "policies").glob("*/README.md")
    return (
        where
        | OUTSIDE
        | {f"policies/{card.parent.name}/README.md": f"policies/{card.parent.name}.md"
           for card in cards}
        | STANDS_FOR
    )  # fmt: skip


def notebook_text(cells: list[dict[str, Any]], pages: Path) -> str:
    """A notebook as a page: text, code, and what it showed; pictures become files of `pages`."""
    parts = []
    for number, cell in enumerate(cells):
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for shown in (out["data"] for out in cell.get("outputs", ())):
            if "image/png" in shown:
                name = f"first_steps-{number}.png"
                (pages / name).write_bytes(base64.b64decode("".join(shown["image/png"])))
                parts.append(f'<img alt="What the cell above drew" src="{name}">')
            elif "text/html" in shown:
                parts.append("".join(shown["text/html"]))
            else:
                parts.append("```text\n" + "".join(shown["text/plain"]) + "\n```")
    return "\n\n".join(parts) + "\n"


def page_text(source: str, where: dict[str, str]) -> str:
    """A page as the site shows it.

    Raises: SystemExit for a link to what is not in the site.
    """
    text = FRONT_MATTER.sub("", (ROOT / source).read_text(encoding="utf-8"))
    if source == "docs/reference/api.md":
        text = from_docstrings(text)
    if source == "docs/datasets.md":
        text = with_cards(text)
    return outside_fences(text, lambda prose: for_the_site(prose, source, where))


def outside_fences(text: str, change: Callable[[str], str]) -> str:
    """`change` applied to all but blocks of code."""
    parts = FENCE.split(text)
    return "".join(part if part.startswith("```") else change(part) for part in parts)


def for_the_site(prose: str, source: str, where: dict[str, str]) -> str:
    """Links lead to pages; a list needs the empty line that CommonMark does without."""

    def linked(match: re.Match[str]) -> str:
        path = os.path.normpath(PurePosixPath(source).parent / match[1])
        if path not in where:
            raise SystemExit(f"{source}: a link to {match[1]}, which is no page of the site")
        return relative(where[path], source, where) + (match[2] or "")

    def named(match: re.Match[str]) -> str:
        page = where.get(match[1].rstrip("/"))
        return f"[{match[0]}]({relative(page, source, where)})" if page else match[0]

    return LIST_BEHIND_TEXT.sub(r"\1\n", NAMED.sub(named, LINK.sub(linked, prose)))


def relative(page: str, source: str, where: dict[str, str]) -> str:
    return os.path.relpath(page, PurePosixPath(where[source]).parent)


def from_docstrings(text: str) -> str:
    """The written page's names, each as the order to render its docstring."""

    def order(match: re.Match[str]) -> str:
        return f"::: {match[1]}\n" if "." in match[1] else match[0]

    lines, skipped = [], False
    for part in re.split(r"(?=^## )", text, flags=re.MULTILINE):
        heading = HEADING.match(part)
        skipped = heading is not None and "." in heading[1]
        lines.append(HEADING.sub(order, part.partition("\n")[0]) + "\n" if skipped else part)
    return "".join(lines)


def with_cards(text: str) -> str:
    """Under each data set's heading the page that its file wrote about itself."""

    def card(match: re.Match[str]) -> str:
        name = match[1]
        if not (ROOT / f"docs/cards/{name}.html").exists():
            return match[0]
        return (
            f'{match[0]}\n\n<iframe class="card" loading="lazy" src="cards/{name}.html" '
            f'title="Data card of {name}"></iframe>\n\n'
            f"What `mpdt-data report {name}.h5` wrote; "
            f"<a href='cards/{name}.html'>on a page of its own</a>."
        )

    return HEADING.sub(card, text)


def decision_list() -> str:
    """The page that lists every decision by its title."""
    lines = ["# Decisions\n", "Why things are as they are, where somebody might undo them.\n"]
    for file in sorted((ROOT / "docs/decisions").glob("0*.md")):
        title = file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        number, _, name = title.partition(" ")
        lines.append(f"- {number.rstrip(':')} [{name}]({file.name})")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
