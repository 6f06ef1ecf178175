"""The documentation site: every page and link is there; slow: a browser sees what is wrong."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
MISSING = 3


@pytest.fixture(scope="module")
def build_site() -> ModuleType:
    path = ROOT / "tools/build_site.py"
    spec = importlib.util.spec_from_file_location("build_site", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pages_in(nav: Any) -> Iterator[str]:
    for one in nav if isinstance(nav, list) else nav.values():
        if isinstance(one, str):
            yield one
        else:
            yield from pages_in(one)


def test_every_link_of_every_page_leads_to_a_page(build_site: ModuleType) -> None:
    where = build_site.site_paths()
    sources = [source for source in where if source.endswith(".md")]
    assert {"README.md", "docs/tutorial.md", "policies/ml10/README.md"} < set(sources)
    for source in sources:
        build_site.page_text(source, where)  # SystemExit for a link that leads nowhere


def test_every_page_stands_in_the_menu_once(build_site: ModuleType) -> None:
    settings = tomllib.loads((ROOT / "tools/site/zensical.toml").read_text())
    listed = list(pages_in(settings["project"]["nav"]))
    pages = {page for page in build_site.site_paths().values() if page.endswith(".md")}
    decisions = {page for page in pages if page.startswith("decisions/0")}  # listed on their own
    assert sorted(listed) == sorted(pages - decisions)


def test_links_and_names_of_pages_become_links_of_the_site(build_site: ModuleType) -> None:
    where = {"docs/a.md": "a.md", "docs/sub/b.md": "sub/b.md", "README.md": "index.md"}
    text = "[b](sub/b.md#x) `docs/sub/b.md` `docs/none.md` [c](https://c.d)\n"
    assert build_site.for_the_site(text, "docs/a.md", where) == (
        "[b](sub/b.md#x) [`docs/sub/b.md`](sub/b.md) `docs/none.md` [c](https://c.d)\n"
    )
    assert build_site.for_the_site("[a](../../README.md)", "docs/sub/b.md", where) == (
        "[a](../index.md)"
    )
    with pytest.raises(SystemExit, match=r"docs/a\.md: a link to lost\.md"):
        build_site.for_the_site("[x](lost.md)", "docs/a.md", where)


def test_a_list_behind_text_is_a_list_there_too(build_site: ModuleType) -> None:
    """CommonMark needs no empty line before it, the generator does; code stays as it is."""
    made = build_site.outside_fences(
        "text\n- one\n- two\n\n```\ntext\n- code\n```\n",
        lambda prose: build_site.for_the_site(prose, "README.md", {"README.md": "index.md"}),
    )
    assert made == "text\n\n- one\n- two\n\n```\ntext\n- code\n```\n"


def test_the_reference_is_rendered_from_the_names_of_the_page(build_site: ModuleType) -> None:
    made = build_site.from_docstrings(
        "# P\n\nabout\n\n## mpdt.open\n\n```\nx\n```\n\n## Errors\n\ny\n"
    )
    assert made == "# P\n\nabout\n\n::: mpdt.open\n\n## Errors\n\ny\n"


def test_a_notebook_becomes_a_page(build_site: ModuleType, tmp_path: Path) -> None:
    cells = [
        {"cell_type": "markdown", "source": ["# T\n", "text"]},
        {"cell_type": "code", "source": "1", "outputs": [{"data": {"text/plain": ["1"]}}]},
        {"cell_type": "code", "source": "d", "outputs": [
            {"data": {"text/html": "<div>x</div>", "text/plain": "x"}}]},
        {"cell_type": "code", "source": "p", "outputs": [{"data": {"image/png": "aGk="}}]},
    ]  # fmt: skip
    made = build_site.notebook_text(cells, tmp_path)
    assert made == (
        "# T\ntext\n\n```python\n1\n```\n\n```text\n1\n```\n\n```python\nd\n```\n\n<div>x</div>\n\n"
        '```python\np\n```\n\n<img alt="What the cell above drew" src="first_steps-3.png">\n'
    )
    assert (tmp_path / "first_steps-3.png").read_bytes() == b"hi"


def test_docstrings_of_the_reference_name_one_parameter_a_line() -> None:
    """What griffe cannot read ends the build of the site, minutes later."""
    page = (ROOT / "docs/reference/api.md").read_text("utf-8")
    for name in re.findall(r"^## (mpdt\.[\w.]+)$", page, re.MULTILINE):
        found: Any = pkgutil.resolve_name(re.sub(r"\.(\w+)$", r":\1", name))
        texts = [found.__doc__, *(getattr(one, "__doc__", "") for one in vars(found).values())]
        for text in texts:
            part = (text or "").partition("Args:")[2].partition("Raises:")[0]
            assert not re.findall(r"^ +\w+, \w+: .*", part, re.MULTILINE), name


def test_a_data_sets_card_stands_under_its_heading(build_site: ModuleType) -> None:
    made = build_site.with_cards("## cheetah_dir\n\n| table |\n\n## unknown\n")
    assert 'src="cards/cheetah_dir.html" title="Data card of cheetah_dir"' in made
    assert made.index("iframe") < made.index("| table |") and "cards/unknown" not in made


@pytest.mark.slow
def test_the_walk_sees_what_is_wrong(tmp_path: Path) -> None:
    """Pale text, a lost page, a lost heading, another host, a file not there, no search."""
    (tmp_path / "index.html").write_text(
        '<!doctype html><html lang="en"><body style="color-scheme:light"><p style="color:#bbb">pale'
        '<p><a href="lost.html">a</a> <a href="other.html#nothing">b</a> '
        '<a href="http://plain.example/">c</a><img alt="far" src="http://127.0.0.1:9/x.png">'
        '<img alt="near" src="gone.png"><div style="width:2000px">wide</div>'
        "<script>undefined_name()</script>"
    )
    (tmp_path / "other.html").write_text('<!doctype html><html lang="en"><p id="here">well')
    command = [sys.executable, str(ROOT / "tools/walk_site.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == MISSING:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 1
    for text in ('contrast 1.9: P  "pale"', "index.html: no page lost.html",
                 "nothing called nothing on other.html", "link to http://plain.example/",
                 "request: http://127.0.0.1:9/x.png", "picture not loaded: near", "404: ",
                 "phone, dark: page is", "undefined_name", "'split' does not find"):  # fmt: skip
        assert text in done.stdout, (text, done.stdout)
    assert "other.html:" not in done.stdout.replace("on other.html", "")
