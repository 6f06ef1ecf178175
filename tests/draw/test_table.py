"""One table, two drawings: Markdown for pages, rich for the terminal."""

import io

from rich.console import Console

from mpdt.draw.table import Table, html_table, markdown_page, markdown_table, rich_tables

ROWS = (("a|b", "1"), ("c", "2"), ("all", "1.5"))
TABLE = Table("returns", ("task", "zero"), ROWS, ("n = 2",), closing=1)


def test_markdown_by_hand():
    """A bar within a cell would begin another one."""
    assert markdown_table(TABLE.columns, TABLE.rows[:1]) == "\n".join(
        ["| task | zero |", "| --- | ---: |", "| a\\|b | 1 |"]
    )
    assert markdown_table(("x", "y"), [(1, 2)], numbers=False).splitlines()[1] == "| --- | --- |"


def test_a_page_holds_facts_tables_notes_and_a_last_line():
    text = markdown_page({"name": "run", "seed": "0"}, [TABLE], "normalised = ...")
    assert text.startswith("# run\n\n- seed: 0\n\n## returns\n\n| task | zero |\n")
    assert text.endswith("| all | 1.5 |\n\nn = 2\n\nnormalised = ...\n")


def test_what_sums_up_stands_apart_on_the_terminal():
    (drawn,) = rich_tables([TABLE])
    assert [row.end_section for row in drawn.rows] == [False, True, False]
    plain = Table(TABLE.title, TABLE.columns, TABLE.rows)
    assert not any(row.end_section for row in rich_tables([plain])[0].rows[:-1])


def test_cells_are_text_on_a_terminal():
    """Neither markup of rich nor an escape sequence: names of tasks may hold both."""
    rows = (("[/x]", "\x1b[31m1"), ("[red]", "\u202e"))
    out = io.StringIO()
    table = Table("[/t]", ("task", "[b]a"), rows, ("[/n]",))
    Console(file=out, width=100).print(rich_tables([table])[0])
    shown = out.getvalue()
    for text in ("[/x]", "[b]a", "\\x1b[31m1", "[red]", "\\u202e", "[/n]", "[/t]"):
        assert text in shown
    assert not set("\x1b\u202e") & set(shown)


def test_html_by_hand():
    """What a cell holds is text, also where it looks like a tag."""
    table = Table("a < b", ("x", "y"), (("<script>", "1"),), ("n & m",))
    left, right = 'style="text-align:left"', 'style="text-align:right"'
    assert html_table(table) == (
        "<div><p><b>a &lt; b</b></p><table><thead>"
        f"<tr><th {left}>x</th><th {right}>y</th></tr></thead><tbody>"
        f"<tr><td {left}>&lt;script&gt;</td><td {right}>1</td></tr></tbody></table>"
        "<p>n &amp; m</p></div>"
    )


def test_columns_of_words_wrap_and_columns_of_numbers_do_not() -> None:
    rows = (("a", "1.0 [0.5, 1.5]", "best of two"), ("b", "2", "-"))
    assert Table("t", ("name", "mean", "by"), rows).columns_of_words == {2}
