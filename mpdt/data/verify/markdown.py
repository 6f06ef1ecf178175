"""The findings as a Markdown page, for a data card or a review."""

from __future__ import annotations

from mpdt.data.verify.verify import Report, summary


def markdown(report: Report) -> str:
    """One table; the file by its name only, so that the page tells no path."""
    lines = [
        f"# mpdt-data verify {report.path.name}",
        "",
        f"Content `{report.content_hash or 'unknown'}`: {summary(report.findings)}.",
        "",
        "| check | outcome | finding | next |",
        "|---|---|---|---|",
    ]
    for one in report.findings:
        cells = (one.id, one.outcome.value, one.text, f"`{one.hint}`" if one.hint else "")
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
