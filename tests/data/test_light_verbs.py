"""Verbs that simulate nothing do not wait for a simulator to be imported."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SIMULATORS = {"mujoco", "metaworld", "torch"}
CODE = """
import contextlib, io, sys
from mpdt.data.cli import main
for words in {lines!r}:
    sys.argv = ["mpdt-data", *words.split()]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        try:
            main()
        except SystemExit as stop:
            assert not stop.code, (words, stop.code)
    print(words, sorted({names!r} & set(sys.modules)))
"""


def test_list_plan_show_split_and_verify_import_no_simulator(
    collected: Path, tmp_path: Path
) -> None:
    """`plan` and `verify` name the policies of Meta-World's scripts, whose hashes need none."""
    (tmp_path / "tiny.h5").write_bytes(collected.read_bytes())
    lines = ["list", "plan ml10", "show tiny.h5", "split tiny.h5 --quality medium",
             "verify tiny.h5 --skip replay,claims,quality"]  # fmt: skip
    code = CODE.format(lines=lines, names=SIMULATORS)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert done.stdout.splitlines() == [f"{line} []" for line in lines], done.stderr
