"""Pages in a real browser: a card and a result page, at a desk and on a phone, light and dark."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mpdt.train.report.page import run_content, write_result

ROOT = Path(__file__).parents[2]
RUN = ROOT / "results/runs/cheetah_vel-infer"
MISSING = 3


def look(*pages: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "tools" / "pages.py"), *map(str, pages)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == MISSING:
        pytest.skip(done.stderr.strip())
    return done


@pytest.mark.slow
def test_pages_are_whole_in_a_browser(tmp_path: Path) -> None:
    from mpdt.train.run.results import read_results

    subprocess.run(
        [Path(sys.executable).with_name("mpdt-data"), "collect", "cheetah_dir", "--smoke", "-q"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    subprocess.run(
        [Path(sys.executable).with_name("mpdt-data"), "report", "cheetah_dir-smoke.h5", "-q"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    write_result(tmp_path / "run.html", run_content(read_results(RUN), RUN))
    done = look(tmp_path / "cheetah_dir-smoke.html", tmp_path / "run.html")
    assert (done.returncode, done.stdout) == (0, "2 pages, nothing wrong\n"), done.stdout


@pytest.mark.slow
def test_the_look_sees_what_is_wrong(tmp_path: Path) -> None:
    """Too wide, an empty chart, a picture from elsewhere, a script that fails."""
    page = tmp_path / "bad.html"
    page.write_text(
        '<!doctype html><meta name="viewport" content="width=device-width"><body>'
        '<div style="width:2000px">wide</div><svg class="chart" aria-label="none" '
        'viewBox="0 0 100 100" width="200" height="200"></svg>'
        '<img alt="far" width="90" height="90" src="http://127.0.0.1:9/x.png">'
        "<script>undefined_name()</script>"
    )
    done = look(page)
    assert done.returncode == 1
    for text in (" wide on 390", "empty chart: none", "picture not loaded: far",
                 "request: http://127.0.0.1:9/x.png", "undefined_name", "phone, dark"):  # fmt: skip
        assert text in done.stdout


def test_without_a_browser_it_says_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("<p>hello")
    command = [sys.executable, str(ROOT / "tools" / "pages.py"), str(tmp_path / "page.html")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={"PATH": ""})
    assert done.returncode == MISSING and "install" in done.stderr
