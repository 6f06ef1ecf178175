"""mpdt-train: one command from a data file to a table.

    mpdt-train --data cheetah_dir.h5                     run (the default), preset base
    mpdt-train --data ml10.h5 --preset smoke --name try  seconds, to see that it works
    mpdt-train --data ml10.h5 --method Prompt-DT         a baseline or a variant
    mpdt-train --data ml10.h5 --adapt infer              our own zero-shot protocol
    mpdt-train --data ml10.h5 --inputs.return-to-go none --name no-rtg
    mpdt-train settings --preset paper                   every setting and its value
    mpdt-train report runs/ml10-base                     the tables of a finished run

Results go to stdout, talk to stderr. torch is imported in the bodies, so `--help` is quick.
"""

from __future__ import annotations

import logging
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import tyro

from mpdt.errors import MpdtError

if TYPE_CHECKING:
    from mpdt.train.config import TrainConfig

PROG = "mpdt-train"


@dataclass(frozen=True)
class Run:
    """Train on a data file, adapt to its unseen tasks, judge everything in the simulator.

    Runs by default, without a subcommand. A run with the same settings and data in the same
    folder continues where it stopped. Every setting of every part can be given as well, for
    example --seed 1, --quality medium, --inputs.return-to-go none, --prompts.length 9;
    `mpdt-train settings` lists them all. After training, other --adapt, --statistics and
    --evaluation settings judge the same weights again. Other commands: settings, report.
    """

    data: str
    """FILE or FILE:slice, as written by mpdt-data collect or split."""
    preset: str = "base"
    """Settings to start from: smoke, demo, base, paper."""
    method: str | None = None
    """MPDT, MPDT-E, MPDT-WP, Soft-Prompt, Prompt-DT, MT-BC, LaMo, ...: lays a method over the
    preset. An unknown name lists them all; default: the preset's own."""
    adapt: str | None = None
    """Start of adaptation, such as cross or infer. Short for --adapt.starts."""
    name: str | None = None
    """Folder of the run inside the runs folder; default: FILE-preset or FILE-method."""
    runs_dir: Path = Path("runs")
    """Where runs are kept."""
    restart: bool = False
    """Throw away what an earlier run left in that folder."""
    steps: int | None = None
    """Updates of P_c and P_k; the teacher keeps its share. Short for --multitask.steps."""
    time_limit_s: float = 0.0
    """End training after so many seconds and judge what there is; the same command trains on.
    0 = never."""
    json: bool = False
    """Print results.json instead of tables."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """No progress on stderr."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Settings:
    """Every setting of a preset with its value, as it can be given on the command line."""

    preset: str = "base"
    """smoke, demo, base, paper."""
    json: bool = False
    """As JSON instead of one option a line."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


@dataclass(frozen=True)
class Report:
    """Print the tables of a finished run again."""

    folder: tyro.conf.Positional[Path]
    """The run's folder, such as runs/ml10-base."""
    json: bool = False
    """Print results.json instead of tables."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Show tracebacks."""


Command = Run | Settings | Report
COMMANDS: dict[str, type[Command]] = {"run": Run, "settings": Settings, "report": Report}


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the script. Exits with the code of the error; 130 or 143 if stopped."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    verb = arguments.pop(0) if arguments and not arguments[0].startswith("-") else "run"
    # Until a run listens nothing is begun that could be lost, and libraries in the middle of
    # their import answer KeyboardInterrupt with anything from a traceback to silence.
    before = signal.signal(signal.SIGINT, _leave)
    try:
        code = _answer(verb, arguments)
    finally:
        signal.signal(signal.SIGINT, before)
    sys.exit(code)


def _leave(_number: int, _frame: FrameType | None) -> None:
    os.write(2, b"\ninterrupted\n")
    os._exit(130)


def _answer(verb: str, arguments: list[str]) -> int:
    """Parse and run; the exit code."""
    verbose = bool({"-v", "--verbose"} & set(arguments))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(message)s")
    try:
        if verb not in COMMANDS:
            from mpdt.errors import unknown_name

            raise unknown_name("command", verb, COMMANDS, where=PROG)
        command, rest = tyro.cli(
            COMMANDS[verb], prog=PROG if verb == "run" else f"{PROG} {verb}",
            args=arguments, return_unknown_args=True,
        )  # fmt: skip
        return execute(command, rest)
    except MpdtError as error:
        if verbose:
            traceback.print_exc()
        sys.stderr.write(error.render() + "\n")
        return error.exit_code


def execute(command: Command, rest: list[str]) -> int:
    """Run one parsed command; `rest` are the settings of a run."""
    if isinstance(command, Run):
        return _run(command, rest)
    if rest:
        from mpdt.errors import UsageError

        raise UsageError(f"unknown option '{rest[0]}'", where=PROG)
    if isinstance(command, Settings):
        from mpdt.train.presets import get_preset
        from mpdt.train.show import settings_text

        sys.stdout.write(settings_text(get_preset(command.preset), command.json))
    else:
        from mpdt.train.show import print_results, read_results

        print_results(read_results(command.folder), command.json)
    return 0


def _run(command: Run, rest: list[str]) -> int:
    from mpdt.train.pipeline import run_pipeline
    from mpdt.train.progress import Progress
    from mpdt.train.show import print_results
    from mpdt.train.state import Stopped, StopRequest

    config = parse_settings(command, rest)
    file = Path(command.data.partition(":")[0]).stem
    name = command.name or f"{file}-{command.method or command.preset}"
    try:
        with StopRequest().listening() as stop:
            results = run_pipeline(
                command.data, config, command.runs_dir, name, command.restart,
                Progress(command.quiet), stop, command.time_limit_s,
            )  # fmt: skip
    except Stopped as stopped:
        sys.stderr.write(f"\n{stopped}; saved. Continue with the same command:\n")
        given = [word for word in sys.argv[1:] if word != "--restart"]
        sys.stderr.write(f"  {PROG} {shlex.join(given)}\n")
        return stopped.exit_code
    print_results(results, command.json)
    return 0


def parse_settings(command: Run, rest: Sequence[str]) -> TrainConfig:
    """The preset with the overrides of the command line.

    Raises: UsageError for an unknown preset or a value out of range; exits with 2 and the
        nearest option for an unknown one.
    """
    import msgspec

    from mpdt.train.config import TrainConfig
    from mpdt.train.methods import apply_method
    from mpdt.train.presets import get_preset

    preset = get_preset(command.preset)
    if command.steps is not None:
        share = preset.teacher.steps / max(1, preset.multitask.steps)
        preset = msgspec.structs.replace(
            preset,
            multitask=msgspec.structs.replace(preset.multitask, steps=command.steps),
            teacher=msgspec.structs.replace(preset.teacher, steps=round(command.steps * share)),
        )
    if command.method is not None:
        preset = apply_method(preset, command.method)
    short = [] if command.adapt is None else ["--adapt.starts", command.adapt]
    return tyro.cli(TrainConfig, prog=PROG, default=preset, args=[*short, *rest])


if __name__ == "__main__":
    main()
