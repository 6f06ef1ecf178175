"""What holds for every verb: results on stdout alone, JSON on demand, suggestions, imports."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from mpdt.data.cli import VERBS, main
from mpdt.data.verbs.options import Options

Capture = pytest.CaptureFixture[str]
# Every verb once, in a folder with tiny.h5. The others train, measure or draw for a while; they
# have tests of their own.
CHEAP: dict[str, Sequence[str]] = {
    "list": (),
    "show": ("tiny.h5",),
    "plan": ("tiny",),
    "collect": ("tiny", "--workers", "0"),
    "split": ("tiny.h5", "--quality", "medium"),
    "merge": ("tiny-medium.h5", "tiny-expert.h5", "-o", "merged.h5"),
    "drop": ("tiny.h5", "--episodes", "3", "-o", "dropped.h5"),
    "diff": ("tiny.h5", "tiny.h5"),
    "tta": ("tiny.h5", "--name", "more", "--workers", "0"),
    "import": ("npz", "--from", "npz", "-o", "again.h5"),
    "export": ("tiny.h5", "--to", "npz", "-o", "npz2"),
    "push": ("tiny.h5", "elsewhere/"),
    "pull": ("elsewhere/tiny.h5", "-o", "back.h5"),
    "verify": ("tiny.h5", "--skip", "replay"),
    "view": ("tiny.h5", "-e", "0"),
    "lock": (),
    "info": (),
    "completion": ("bash",),
}
ELSEWHERE = {"pretrain", "calibrate", "check-family", "reference", "report"}


def test_no_verb_is_forgotten() -> None:
    assert set(CHEAP) | ELSEWHERE == set(VERBS)
    for verb in VERBS.values():
        assert issubclass(verb, Options)
        assert {"json", "quiet", "verbose", "color"} <= {f.name for f in dataclasses.fields(verb)}


@pytest.mark.parametrize("verb", CHEAP)
def test_json_is_one_document_and_stdout_is_the_result(
    verb: str, tiny_file: Path, capsys: Capture
) -> None:
    """With -q nothing is on stderr; without --json the result is text."""
    for prepared in (("export", "tiny.h5", "--to", "npz", "-o", "npz"),
                     ("split", "tiny.h5", "--quality", "expert"),
                     ("push", "tiny.h5", "elsewhere/")):  # fmt: skip
        if verb in ("import", "merge", "pull"):
            assert main([*prepared, "-q"]) == 0
    if verb == "merge":
        assert main(["split", "tiny.h5", "--quality", "medium", "-q"]) == 0
    capsys.readouterr()
    assert main([verb, *CHEAP[verb], "--json", "-q"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) is not None and captured.err == ""


@pytest.mark.parametrize("verb", VERBS)
def test_a_mistyped_option_gets_a_suggestion(verb: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as stop:
        main([verb, *CHEAP.get(verb, ["tiny"]), "--jsn"])
    captured = capsys.readouterr()
    assert stop.value.code == 2 and captured.out == ""
    assert "Perhaps you meant" in captured.err and "--json" in captured.err


@pytest.mark.parametrize("verb", VERBS)
def test_the_first_line_says_what_it_does(verb: str) -> None:
    """It is the verb's line in the overview: one sentence that fits."""
    line = inspect.cleandoc(VERBS[verb].__doc__ or "").partition("\n")[0]
    assert re.fullmatch(r"[A-Z].*\.", line) and len(line) <= 90


def loaded(*words: str) -> set[str]:
    """Modules in a fresh process after `mpdt-data` with these words."""
    code = (
        "import sys\nfrom mpdt.data.cli import main\n"
        f"try:\n    main({list(words)!r})\nexcept SystemExit:\n    pass\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_what_is_not_imported(workplace: Path) -> None:
    """The overview parses nothing; a list without files draws no numbers and opens none."""
    numbers = {"numpy", "h5py", "mujoco", "pyarrow", "fsspec", "rich", "gymnasium", "torch"}
    assert not loaded("-h") & (numbers | {"msgspec", "yaml", "typeguard", "asyncio"})
    assert not loaded("list") & numbers
    assert not loaded("push", "-h") & numbers
