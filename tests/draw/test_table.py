"""One table, two drawings: Markdown for pages, rich for the terminal."""

from mpdt.draw.table import Table, markdown_page, markdown_table, rich_tables

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
