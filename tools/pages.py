"""Look at HTML pages with a headless Chromium: at a desk and on a phone, in light and dark.

    python tools/pages.py card.html results.html --shots shots/

Of each it asserts: no console message of a fault, no request but the page itself, every picture
drawn and not empty, nothing wider than the screen (only boxes that scroll may be). Exit code 1
names what is wrong, 3 says what is missing here: `pip install 'mpdt[browser]'` and a chromium
(Debian: `apt-get install chromium`; or its path in CHROMIUM).
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

SCREENS = {"desk": (1280, 900), "phone": (390, 844)}
SCHEMES = ("light", "dark")
MISSING = 3

# Runs in the page with everything unfolded; returns what is wrong.
LOOK = """() => {
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  const wrong = [];
  const drawn = document.querySelectorAll("svg.chart, img");
  for (const figure of drawn) {
    const box = figure.getBoundingClientRect();
    const name = figure.getAttribute("aria-label") || figure.alt || figure.src.slice(0, 40);
    if (box.width < 40 || box.height < 20) wrong.push(`figure too small: ${name}`);
    if (figure.tagName === "IMG" && !(figure.complete && figure.naturalWidth > 0))
      wrong.push(`picture not loaded: ${name}`);
    if (figure.tagName === "svg") {
      const marks = "polygon, polyline, circle, rect";
      if (!figure.querySelector(marks)) wrong.push(`empty chart: ${name}`);
      for (const text of figure.querySelectorAll("text")) {
        const own = text.getBoundingClientRect();
        if (own.left < box.left - 1 || own.right > box.right + 1)
          wrong.push(`text sticks out of ${name}: ${text.textContent}`);
        if (own.height > 0 && own.height < 8) wrong.push(`tiny text in ${name}`);
      }
    }
  }
  const root = document.documentElement;
  if (root.scrollWidth > root.clientWidth) {
    wrong.push(`page is ${root.scrollWidth} wide on ${root.clientWidth}`);
    for (const one of document.querySelectorAll("body *"))
      if (!one.closest(".scroll, pre") && one.getBoundingClientRect().right > root.clientWidth + 1)
        wrong.push(`  ${one.tagName} ${one.className} ${one.textContent.slice(0, 40)}`);
  }
  return [drawn.length, [...new Set(wrong)].slice(0, 20)];
}"""


def chromium() -> str | None:
    """Path of a browser, or None."""
    named = (os.environ.get("CHROMIUM"), "chromium", "chromium-browser", "google-chrome")
    return next((found for name in named if name and (found := shutil.which(name))), None)


def look(page: Path, browser: object, shots: Path | None) -> Iterator[str]:
    """What is wrong with a page, one line each."""
    for screen, (width, height) in SCREENS.items():
        for scheme in SCHEMES:
            where = f"{page.name}, {screen}, {scheme}"
            heard: list[str] = []
            tab = browser.new_page(  # type: ignore[attr-defined]
                viewport={"width": width, "height": height}, color_scheme=scheme
            )
            tab.on("console", lambda said, heard=heard: heard.append(f"console: {said.text}"))
            tab.on("pageerror", lambda error, heard=heard: heard.append(f"error: {error}"))
            address = page.resolve().as_uri()
            tab.on(
                "request",
                lambda asked, heard=heard, address=address: (
                    heard.append(f"request: {asked.url[:80]}")
                    if asked.url != address and not asked.url.startswith("data:")
                    else None
                ),
            )
            tab.goto(address)
            if shots is not None:
                tab.screenshot(path=shots / f"{page.stem}-{screen}-{scheme}.png", full_page=True)
            figures, wrong = tab.evaluate(LOOK)
            if figures == 0:
                heard.append("no figure at all")
            yield from (f"{where}: {what}" for what in [*heard, *wrong])
            if shots is not None and scheme == "light":
                name = f"{page.stem}-{screen}-unfolded.png"
                tab.screenshot(path=shots / name, full_page=True)
            tab.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--shots", type=Path, help="keep screenshots in this folder")
    options = parser.parse_args()
    binary = chromium()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        print("playwright is not installed: pip install 'mpdt[browser]'", file=sys.stderr)
        return MISSING
    if binary is None:
        print("no chromium here; on Debian: apt-get install chromium", file=sys.stderr)
        return MISSING
    if options.shots is not None:
        options.shots.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=binary, args=["--no-sandbox"])
        wrong = [line for page in options.pages for line in look(page, browser, options.shots)]
        browser.close()
    print("\n".join(wrong) or f"{len(options.pages)} pages, nothing wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
