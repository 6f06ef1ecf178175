"""Walk the built site with a headless Chromium, every page of it, as a reader might.

    python tools/walk_site.py                       build/site/html, as `make site` does
    python tools/walk_site.py FOLDER --shots shots/

Of each page, at a desk and on a phone, in light and dark: no message of a fault, no request to
another host, no file that is not there, every picture drawn, nothing wider than the screen, and
text that stands out from what is behind it (WCAG AA: 4.5 to 1, 3 to 1 where it is large). Every
link leads to a page of the site and to a heading on it, or to another site by https, which is not
asked. Searching `split` finds the verb. Exit code 1 names what is wrong, 3 says what is missing.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag

from pages import MISSING, SCHEMES, SCREENS, chromium

HTML = Path(__file__).parent.parent / "build/site/html"

FACTS = """() => ({
  links: [...document.querySelectorAll("a[href]")].map(a => a.href),
  marks: [...document.querySelectorAll("[id], a[name]")].map(one => one.id || one.name),
})"""

# Runs in the page; returns what is wrong with how it looks.
LOOK = """() => {
  const wrong = [], root = document.documentElement;
  for (const image of document.images)
    if (!(image.complete && image.naturalWidth > 0) && image.loading !== "lazy")
      wrong.push(`picture not loaded: ${image.alt || image.src}`);
  if (root.scrollWidth > root.clientWidth)
    wrong.push(`page is ${root.scrollWidth} wide on ${root.clientWidth}`);
  const brush = Object.assign(document.createElement("canvas"), {width: 1, height: 1})
    .getContext("2d", {willReadFrequently: true});
  const known = new Map();
  const rgba = text => {
    if (!known.has(text)) {
      brush.clearRect(0, 0, 1, 1); brush.fillStyle = text; brush.fillRect(0, 0, 1, 1);
      const [r, g, b, a] = brush.getImageData(0, 0, 1, 1).data;
      known.set(text, [r, g, b, a / 255]);
    }
    return known.get(text);
  };
  const over = (top, under) => [0, 1, 2].map(i => top[i] * top[3] + under[i] * (1 - top[3]));
  const light = color => {
    const [r, g, b] = color.slice(0, 3).map(c => c / 255)
      .map(c => c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = one => {
    const layers = [];
    for (let at = one; at; at = at.parentElement) {
      const color = rgba(getComputedStyle(at).backgroundColor);
      if (color[3] > 0) layers.push(color);
      if (color[3] === 1) break;
    }
    return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
  };
  const opacity = one => one ? opacity(one.parentElement) * getComputedStyle(one).opacity : 1;
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const one = walk.currentNode.parentElement, text = walk.currentNode.data.trim();
    if (!text || one.closest("svg, script, style, noscript, .headerlink")) continue;
    if (!one.checkVisibility({opacityProperty: true, visibilityProperty: true})) continue;
    const style = getComputedStyle(one), under = behind(one);
    const [r, g, blue, alpha] = rgba(style.color);
    const shown = over([r, g, blue, alpha * opacity(one)], under);
    const [a, b] = [light(shown), light(under)];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const size = parseFloat(style.fontSize), bold = parseInt(style.fontWeight) >= 700;
    const least = size >= 24 || (bold && size >= 18.6) ? 3 : 4.5;
    if (contrast < least)
      wrong.push(`contrast ${contrast.toFixed(1)}: ${one.tagName} ${one.className}`
        + ` "${text.slice(0, 30)}" ${style.color}`);
  }
  return [...new Set(wrong)].slice(0, 12);
}"""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=HTML)
    parser.add_argument("--shots", type=Path, help="keep screenshots in this folder")
    options = parser.parse_args()
    if options.shots is not None:
        options.shots.mkdir(parents=True, exist_ok=True)
    binary = chromium()
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        print("playwright is not installed; `make site` does it", file=sys.stderr)
        return MISSING
    if binary is None:
        print("not walked: no chromium here; on Debian: apt-get install chromium", file=sys.stderr)
        return MISSING
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=binary, args=["--no-sandbox"])
        walk = Walk(browser, options.folder, options.shots)
        wrong = [*walk.pages(), *walk.links(), *walk.search("split")]
        browser.close()
    print("\n".join(wrong) or f"{len(walk.marks)} pages, {walk.num_links} links, nothing wrong")
    return 1 if wrong else 0


class Walk:
    """One visit of all pages, served on the loopback interface."""

    def __init__(self, browser: Any, folder: Path, shots: Path | None) -> None:
        self.browser, self.folder, self.shots = browser, folder.resolve(), shots
        self.marks: dict[str, set[str]] = {}  # page -> ids on it
        self.found: dict[str, set[str]] = {}  # page -> addresses it links to
        self.num_links = 0
        handler = functools.partial(Quiet, directory=str(self.folder))
        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        self.home = f"http://127.0.0.1:{self.server.server_port}/"

    def pages(self) -> Iterator[str]:
        """What is wrong on a page, page by page."""
        for file in sorted(self.folder.rglob("*.html")):
            name = file.relative_to(self.folder).as_posix()
            if name != "404.html":
                yield from (f"{name}: {what}" for what in dict.fromkeys(self._page(name)))

    def _page(self, name: str) -> Iterator[str]:
        heard: list[str] = []
        tab = self.browser.new_page()
        tab.on("console", lambda said: heard.append(f"console: {said.text}"))
        tab.on("pageerror", lambda error: heard.append(f"error: {error}"))
        tab.on("request", lambda asked: heard.extend(self._elsewhere(asked.url)))
        tab.on("response", lambda got: heard.extend(_refused(got.status, got.url)))
        tab.goto(self.home + name)
        tab.add_style_tag(content="* { transition: none !important; animation: none !important }")
        facts = tab.evaluate(FACTS)
        self.marks[name], self.found[name] = set(facts["marks"]), set(facts["links"])
        for screen, (width, height) in SCREENS.items():
            tab.set_viewport_size({"width": width, "height": height})
            for scheme in SCHEMES:
                tab.emulate_media(color_scheme=scheme)
                tab.wait_for_timeout(50)  # the theme's script answers to the change
                yield from (f"{screen}, {scheme}: {what}" for what in tab.evaluate(LOOK))
                if self.shots is not None:
                    path = self.shots / f"{name[:-5].replace('/', '-')}-{screen}-{scheme}.png"
                    tab.screenshot(path=path)
        tab.close()
        yield from heard

    def _elsewhere(self, url: str) -> list[str]:
        own = url.startswith((self.home, "data:", "blob:"))
        return [] if own else [f"request: {url[:80]}"]

    def links(self) -> Iterator[str]:
        """Links that lead nowhere."""
        for page, addresses in self.found.items():
            for address in sorted(addresses):
                self.num_links += 1
                url, mark = urldefrag(address)
                if not url.startswith(self.home):
                    if not url.startswith(("https://", "mailto:")):
                        yield f"{page}: link to {address}"
                    continue
                path = unquote(url.removeprefix(self.home)) or "index.html"
                if not (self.folder / path).is_file():
                    yield f"{page}: no page {path}"
                elif mark and unquote(mark) not in self.marks.get(path, ()):
                    yield f"{page}: nothing called {mark} on {path}"

    def search(self, word: str) -> Iterator[str]:
        """Type a word into the search; a result must name it and lead to a page."""
        tab = self.browser.new_page()
        tab.goto(self.home + "index.html")
        results = []
        for _ in range(15):  # the script may not listen yet, where the machine is busy
            tab.keyboard.press("Control+k")
            tab.wait_for_timeout(500)
            tab.keyboard.type(word)
            tab.wait_for_timeout(1500)
            if results := tab.evaluate(RESULTS):
                break
            tab.keyboard.press("Escape")
            tab.reload()
        if self.shots is not None:
            tab.screenshot(path=self.shots / "search.png")
        if not any(word in text.lower() and "reference/cli.html" in href for text, href in results):
            yield f"search: '{word}' does not find its command: {results[:5]}"
        for _, href in results:
            url, _, _ = href.partition("?")
            path = unquote(urldefrag(url)[0].removeprefix(self.home))
            if path and not (self.folder / path).is_file():
                yield f"search: no page {path}"
        tab.close()


def _refused(status: int, url: str) -> list[str]:
    return [f"{status}: {url}"] if status >= 400 else []


# The search lives in a shadow tree or not, by version.
RESULTS = """() => {
  const found = [];
  const look = root => {
    for (const one of root.querySelectorAll("*")) {
      if (one.shadowRoot) look(one.shadowRoot);
      if (one.tagName === "A" && one.href && /[?&]h=/.test(one.href))
        found.push([one.textContent, one.href]);
    }
  };
  look(document);
  return found;
}"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


if __name__ == "__main__":
    sys.exit(main())
