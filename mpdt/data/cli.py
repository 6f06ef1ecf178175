"""mpdt-data: make, cut and look at datasets.

Each verb is a frozen dataclass under `verbs`, its fields are the options. Nothing heavy is
imported before a verb runs, so that help is quick.

Exit codes: 0 done or nothing to do, 1 data wrong or disk refused, 2 usage or spec, 3 simulator,
4 another process writes the target, 130 / 143 interrupted by Ctrl-C / SIGTERM.
"""

from __future__ import annotations

import inspect
import os
import shlex
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes

from mpdt.argument import refuse_folder_names
from mpdt.data.remote.address import hide
from mpdt.data.verbs.adding import Tta
from mpdt.data.verbs.completion import Shell, completion_script, verb_lines
from mpdt.data.verbs.cutting import Split
from mpdt.data.verbs.editing import Diff, Drop, Merge
from mpdt.data.verbs.exchange import Export, Import
from mpdt.data.verbs.family import CheckFamily
from mpdt.data.verbs.look import Info, List, Show
from mpdt.data.verbs.make import Calibrate, Collect, Plans, Pretrain
from mpdt.data.verbs.options import Options, how_to_go_on
from mpdt.data.verbs.pages import Report, View
from mpdt.data.verbs.reference import Reference
from mpdt.data.verbs.remote import Pull, Push
from mpdt.data.verbs.trust import Lock, Verify
from mpdt.data.workers.processes import pin_kernel
from mpdt.errors import MpdtError, UsageError, told, unknown_name
from mpdt.interruption import Interrupted, interruptible
from mpdt.pipe import reader_may_leave

VERBS: dict[str, type[Options]] = {
    "list": List,
    "show": Show,
    "plan": Plans,
    "collect": Collect,
    "split": Split,
    "merge": Merge,
    "drop": Drop,
    "diff": Diff,
    "tta": Tta,
    "import": Import,
    "export": Export,
    "push": Push,
    "pull": Pull,
    "pretrain": Pretrain,
    "calibrate": Calibrate,
    "reference": Reference,
    "check-family": CheckFamily,
    "verify": Verify,
    "report": Report,
    "view": View,
    "lock": Lock,
    "info": Info,
}
PROG = "mpdt-data"
CONFIG = (FlagCreatePairsOff, OmitArgPrefixes)
DESCRIPTION = """Make, cut and look at datasets.

Examples:
  mpdt-data collect cheetah_dir
  mpdt-data split --quality medium
  mpdt-data show cheetah_dir.h5
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `mpdt-data` with `argv` (default: the process's) and return its exit code."""
    with reader_may_leave():
        return _answer(argv)
    return 0  # `mpdt-data list | head`


def _answer(argv: Sequence[str] | None) -> int:
    words = hide(sys.argv[1:] if argv is None else argv)  # no password reaches a message
    pin_kernel()
    try:
        with interruptible():
            _parse(words).run()
    except (MpdtError, OSError) as error:
        shown = told(error)
        if "-v" in words or "--verbose" in words:
            traceback.print_exc()
        sys.stderr.write(shown.render() + "\n")
        return shown.exit_code
    except Interrupted as stop:
        again = [word for word in words if word not in ("--restart", "--no-resume")]
        once = words[:1] in (["import"], ["export"])
        sys.stderr.write(how_to_go_on(f"{PROG} {shlex.join(again)}", once) + "\n")
        return stop.exit_code
    return 0


def _parse(words: Sequence[str]) -> Options:
    if list(words) == ["--version"]:
        from mpdt.version import __version__

        sys.stdout.write(f"mpdt {__version__}\n")
        raise SystemExit(0)
    if words and words[0] in ("-h", "--help"):
        sys.stdout.write(overview())
        raise SystemExit(0)
    if not words or words[0].startswith("-"):
        what = f"'{words[0]}' comes before the verb" if words else "no verb"
        raise UsageError(what, where=PROG, expected="mpdt-data VERB [OPTIONS]",
                         hint="mpdt-data -h lists the verbs")  # fmt: skip
    if words[0] not in VERBS:
        raise unknown_name("verb", words[0], VERBS, where=PROG)
    if "never" in _values_of("--color", words):
        os.environ["NO_COLOR"] = "1"
    # Only the verb that was typed: building the parsers of all of them takes a while.
    verb = VERBS[words[0]]
    refuse_folder_names(words[1:], verb)
    parsed: Options = tyro.cli(
        verb,
        args=list(words[1:]),
        prog=f"{PROG} {words[0]}",
        description=inspect.cleandoc(verb.__doc__ or ""),
        config=CONFIG,
    )
    return parsed


def overview() -> str:
    """The help of `mpdt-data` itself: every verb with the first line of its docstring."""
    usage = f"usage: {PROG} VERB [OPTIONS]      {PROG} VERB -h for its options"
    return "\n".join([usage, "", DESCRIPTION, "Verbs:", *verb_lines(VERBS), ""])


def _values_of(option: str, words: Sequence[str]) -> list[str]:
    values = [word.partition("=")[2] for word in words if word.startswith(option + "=")]
    return values + [b for a, b in pairwise(words) if a == option]


@dataclass(frozen=True, kw_only=True)
class Completion(Options):
    """Print a script that makes a shell complete verbs and options.

    It knows the options of the day: print it again after an update.

    Examples:
      mpdt-data completion bash > ~/.local/share/bash-completion/completions/mpdt-data
      mpdt-data completion zsh > ~/.zfunc/_mpdt-data
      mpdt-data completion fish > ~/.config/fish/completions/mpdt-data.fish
    """

    shell: Shell
    """The shell that shall read it."""

    def run(self) -> None:
        script = completion_script(PROG, VERBS, self.shell, CONFIG)
        self.print({"shell": self.shell, "script": script}, script)


VERBS["completion"] = Completion


if __name__ == "__main__":
    sys.exit(main())
