"""mpdt-data: make, cut and look at datasets.

Each verb is a frozen dataclass under `verbs`, its fields are the options. Nothing heavy is
imported before a verb runs, so that help is quick.

Exit codes: 0 done or nothing to do, 1 data wrong or disk refused, 2 usage or spec, 3 simulator,
4 another collector holds the target, 130 / 143 interrupted by Ctrl-C / SIGTERM.
"""

from __future__ import annotations

import inspect
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Sequence
from itertools import pairwise
from types import FrameType
from typing import Annotated, Any, NoReturn, Union

import tyro

from mpdt.data.remote.address import hide
from mpdt.data.verbs.adding import Tta
from mpdt.data.verbs.cutting import Split
from mpdt.data.verbs.editing import Diff, Drop, Merge
from mpdt.data.verbs.exchange import Export, Import
from mpdt.data.verbs.look import Info, List, Show
from mpdt.data.verbs.make import Calibrate, Collect, Plans, Pretrain
from mpdt.data.verbs.measure import Measure
from mpdt.data.verbs.options import Options
from mpdt.data.verbs.pages import Report, View
from mpdt.data.verbs.remote import Pull, Push
from mpdt.data.verbs.trust import Lock, Verify
from mpdt.errors import MpdtError, unknown_name
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
    "reference": Measure,
    "verify": Verify,
    "report": Report,
    "view": View,
    "lock": Lock,
    "info": Info,
}
DESCRIPTION = """Make, cut and look at datasets.

Examples:
  mpdt-data collect cheetah_dir
  mpdt-data split --quality medium
  mpdt-data show cheetah_dir.h5
"""


class Terminated(BaseException):
    """SIGTERM. Not an Exception, so that nothing but `main` catches it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `mpdt-data` with `argv` (default: the process's) and return its exit code."""
    with reader_may_leave():
        return _answer(argv)
    return 0  # `mpdt-data list | head`


def _answer(argv: Sequence[str] | None) -> int:
    words = hide(sys.argv[1:] if argv is None else argv)  # no password reaches a message
    before = signal.signal(signal.SIGTERM, _terminate)
    try:
        _parse(words).run()
    except MpdtError as error:
        if "-v" in words or "--verbose" in words:
            traceback.print_exc()
        sys.stderr.write(error.render() + "\n")
        return error.exit_code
    except KeyboardInterrupt:
        return _interrupted(words, 130)
    except Terminated:
        return _interrupted(words, 143)
    finally:
        signal.signal(signal.SIGTERM, before)
    return 0


def _parse(words: Sequence[str]) -> Options:
    if words and not words[0].startswith("-") and words[0] not in VERBS:
        raise unknown_name("verb", words[0], VERBS, where="mpdt-data")
    if list(words) == ["--version"]:
        from mpdt import __version__

        sys.stdout.write(f"mpdt {__version__}\n")
        raise SystemExit(0)
    if "never" in _values_of("--color", words):
        os.environ["NO_COLOR"] = "1"
    config = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes)
    parsed: Options
    if words and words[0] in VERBS:
        # Only the verb that was typed: building the parsers of all of them takes a while.
        verb = VERBS[words[0]]
        parsed = tyro.cli(
            verb,
            args=list(words[1:]),
            prog=f"mpdt-data {words[0]}",
            description=inspect.cleandoc(verb.__doc__ or ""),
            config=config,
        )
    else:
        parsed = tyro.cli(
            _union(), args=list(words), prog="mpdt-data", description=DESCRIPTION, config=config
        )
    return parsed


def _values_of(option: str, words: Sequence[str]) -> list[str]:
    values = [word.partition("=")[2] for word in words if word.startswith(option + "=")]
    return values + [b for a, b in pairwise(words) if a == option]


def _union() -> Any:
    """Every verb with the first sentence of its docstring."""
    choices = [
        Annotated[
            verb, tyro.conf.subcommand(name, description=(verb.__doc__ or "").partition("\n")[0])
        ]
        for name, verb in VERBS.items()
    ]
    return Union[tuple(choices)]  # noqa: UP007  built at run time


def _terminate(signum: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


def _interrupted(words: Sequence[str], code: int) -> int:
    again = [word for word in words if word != "--restart"]
    sys.stderr.write(f"interrupted; go on with: mpdt-data {shlex.join(again)}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
