"""Code in documents runs: a page's blocks, in order, as one script in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def script(page: str) -> str:
    """Its python blocks as they are, its sh blocks as calls that must succeed."""
    lines = ["import subprocess as _subprocess"]
    for match in BLOCK.finditer(page):
        language, code = match.groups()
        number = page[: match.start()].count("\n") + 1
        lines.append(f"print('--- line {number}', flush=True)")
        if language == "sh":
            command = "set -e\n" + code
            code = f"_subprocess.run({command!r}, shell=True, check=True)"
        lines.append(code)
    return "\n".join(lines)


def test_blocks_become_a_script() -> None:
    page = "a\n```python\nx = 1\n```\n```yaml\ny: 2\n```\nb\n```sh\nfalse\ntrue\n```\n"
    found = script(page)
    assert "x = 1" in found and "y: 2" not in found and "'--- line 9'" in found
    with pytest.raises(subprocess.CalledProcessError):
        exec(compile(found, "page", "exec"), {})


@pytest.mark.parametrize("name", ["tutorial.md"])
def test_the_page_runs(name: str, tmp_path: Path) -> None:
    code = script((ROOT / "docs" / name).read_text())
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=os.environ | {"PATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
