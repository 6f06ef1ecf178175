"""Page: what stands on a self-contained HTML page, through jinja2 templates.

No script, no network: styles and pictures are inside, and the page's own content policy forbids
everything else. Autoescape is on, because names and paths may come out of foreign files.
"""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from PIL import Image

from mpdt.disk import disk, replacing
from mpdt.draw import chart
from mpdt.draw.chart import Chart, Mark

TEMPLATES = "mpdt.draw"


def render(template: str, package: str, **values: Any) -> str:
    """The page of a template; `package` is the one whose folder `templates` holds it."""
    return environment(package).get_template(template).render(values)


def environment(package: str = TEMPLATES) -> Environment:
    """Templates of `package` and of this one, with what they call."""
    loaders = [PackageLoader(name) for name in dict.fromkeys((package, TEMPLATES))]
    made = Environment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    made.globals |= {"top": chart.TOP, "right": chart.RIGHT, "corners": _corners}  # fmt: skip
    made.filters |= {"number": number, "shorten": shorten, "picture": picture}
    return made


def write_page(target: Path, text: str) -> None:
    """Raises: StorageError where the disk refuses, or what is there is no such page; it stays."""
    with replacing(target, like=text.lstrip()[:5].encode()) as temporary, disk(target):
        # A name may hold half of a surrogate pair; a page with a mark in its place can be read.
        temporary.write_text(text, encoding="utf-8", errors="replace")


def number(value: float | None, digits: int = 1) -> str:
    """`-36.1`, `4,835`, `1.2e+09`, or a dash for what is not known."""
    if value is None or value != value:
        return "–"  # noqa: RUF001
    if abs(value) >= 1e7:
        return f"{value:.3g}"
    return f"{value:,.{0 if abs(value) >= 1000 else digits}f}"


def shorten(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def picture(pixels: npt.NDArray[np.uint8], lossless: bool = False) -> str:
    """(H, W, 3) as a `data:` address."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "WEBP", quality=82, method=4, lossless=lossless)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _corners(drawn: Chart, mark: Mark) -> tuple[tuple[float, float], tuple[float, float]]:
    """Upper left and lower right corner of a bar, in units of the picture."""
    (x, y), (to_x, to_y) = mark.points.tolist()
    left, right = sorted((drawn.at_x(x), drawn.at_x(to_x)))
    return (left, drawn.at_y(y)), (max(right, left + 0.5), drawn.at_y(to_y))
