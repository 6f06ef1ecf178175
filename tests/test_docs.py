"""Code in documents runs: a page's blocks, in order, as one script in a folder with our policies.

A command of ours is a process of its own, forked off the script: what it would import again, torch
and transformers among it, is there already, which halves the time.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
COMMANDS = r"""
import os, re, shlex, subprocess, sys

def _type(text):
    for line in re.sub(r"\\\n\s*", "", text).splitlines():
        program, *words = shlex.split(line)
        if program not in ("mpdt-data", "mpdt-train") or set("|&;<>$#") & set(line):
            subprocess.run(line, shell=True, check=True)
            continue
        sys.stdout.flush()
        child = os.fork()
        if not child:
            from mpdt.data.cli import main as data
            from mpdt.train.cli import main as train
            try:
                code = data(words) if program == "mpdt-data" else train(words)
            except SystemExit as stopped:
                code = stopped.code
            sys.stdout.flush()
            os._exit(code or 0)
        assert os.waitpid(child, 0)[1] == 0, line
"""
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def script(page: str) -> str:
    """Its python blocks as they are, its sh blocks as commands that must succeed."""
    lines = [COMMANDS]
    for match in BLOCK.finditer(page):
        language, code = match.groups()
        number = page[: match.start()].count("\n") + 1
        lines.append(f"print('--- line {number}', flush=True)")
        if language == "sh":
            code = f"_type({code!r})"
        lines.append(code)
    return "\n".join(lines)


def test_blocks_become_a_script() -> None:
    page = "a\n```python\nx = 1\n```\n```yaml\ny: 2\n```\nb\n```sh\nfalse\ntrue\n```\n"
    found = script(page)
    assert "x = 1" in found and "y: 2" not in found and "'--- line 9'" in found
    with pytest.raises(subprocess.CalledProcessError):
        exec(compile(found, "page", "exec"), {})


def test_a_command_of_ours_that_fails_fails_the_page(tmp_path: Path) -> None:
    page = "```sh\nmpdt-data list\nmpdt-data show \\\n  nothing.h5\necho passed\n```\n"
    done = subprocess.run([sys.executable, "-c", script(page)], cwd=tmp_path, check=False,
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 1 and "ant_dir" in done.stdout and "passed" not in done.stdout
    assert "AssertionError: mpdt-data show nothing.h5" in done.stderr


def commands_in(page: str) -> list[list[str]]:
    """The words of every command of ours in its blocks, without a remark behind it."""
    blocks = "".join(re.findall(r"^```\w*\n(.*?)^```$", page, re.M | re.S)).replace("\\\n", "")
    lines = blocks.replace(" && ", "\n").splitlines()
    typed = [re.split(r" {2,}| # ", line.removeprefix("$ "))[0] for line in lines]
    return [shlex.split(line) for line in typed if re.match("mpdt-(data|train) ", line)]


def check_command(words: list[str]) -> None:
    """It is parsed, settings of a run included; nothing is run."""
    from mpdt.data.cli import _parse
    from mpdt.train.cli import parse, parse_settings
    from mpdt.train.options import Run

    program, *rest = words
    if program == "mpdt-data":
        _parse(rest)
        return
    verb = rest.pop(0) if not rest[0].startswith("-") else "run"
    command, settings = parse(verb, rest)
    if isinstance(command, Run):
        parse_settings(command, settings)


PAGES = ("README.md", "docs/how_to.md", "docs/remote.md", "docs/results.md", "docs/scale.md")


@pytest.mark.parametrize("name", PAGES)
def test_the_commands_of_a_page_can_be_typed(name: str) -> None:
    found = commands_in((ROOT / name).read_text())
    assert found
    for words in found:
        try:
            check_command(words)
        except SystemExit:
            pytest.fail(shlex.join(words))


@pytest.mark.parametrize("line", ["mpdt-data split --qality medium", "mpdt-train --preset smoke",
                                  "mpdt-train --data x.h5 --adapt.start infer"])  # fmt: skip
def test_a_command_that_cannot_be_typed_is_noticed(line: str) -> None:
    (words,) = commands_in(f"```\n{line}   a remark\n```\n")
    with pytest.raises(SystemExit):
        check_command(words)


@pytest.mark.long
@pytest.mark.parametrize("name", ["tutorial.md"])
def test_the_page_runs(name: str, tmp_path: Path) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "OMP_NUM_THREADS": "1"}
    code = script((ROOT / "docs" / name).read_text())
    shutil.copytree(ROOT / "policies", tmp_path / "policies")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
