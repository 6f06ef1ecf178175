"""mpdt-train: one command from a data file to a table.

    mpdt-train --data cheetah_dir.h5                     run (the default), preset base
    mpdt-train --data ml10.h5 --preset smoke --name try  seconds, to see that it works
    mpdt-train --data ml10.h5 --method Prompt-DT         a baseline or a variant
    mpdt-train --data a.h5 b.h5                          several files as one
    mpdt-train --data ml10.h5 --adapt infer              our own zero-shot protocol
    mpdt-train --data ml10.h5 --inputs.return-to-go none --name no-rtg
    mpdt-train --data ml10.h5 --log tensorboard,wandb    told to trackers while it goes
    mpdt-train methods                                   all of them, and what each reads
    mpdt-train settings --preset paper                   every setting and its value
    mpdt-train watch runs/ml10-base                      what a run is doing
    mpdt-train report runs/ml10-base                     the tables of a finished run
    mpdt-train submit runs/ml10-base                     its rows go to a leaderboard
    mpdt-train adapt runs/ml10-base --data ml10.h5 --adapt.starts infer     no training
    mpdt-train bundle runs/ml10-base -o ml10-policy      a folder that acts anywhere
    mpdt-train rollout runs/ml10-base -o ml10-policy.h5  its episodes as data
    mpdt-train study one-block --data-dir data           every method that is not done yet

Results go to stdout, talk to stderr. torch is imported in the bodies, so `--help` is quick.
"""

from __future__ import annotations

import inspect
import logging
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Sequence
from dataclasses import fields
from itertools import takewhile
from types import FrameType
from typing import TYPE_CHECKING

import tyro

from mpdt.argument import refuse_folder_names
from mpdt.data.remote.address import hide
from mpdt.data.verbs.options import how_to_go_on
from mpdt.errors import BusyError, MpdtError, told
from mpdt.interruption import Interrupted, interruptible
from mpdt.pipe import reader_may_leave
from mpdt.train.acting import bundle, judge, judge_others, roll_out, travel, until_stopped
from mpdt.train.options import (
    COMMANDS,
    EVALUATE_POLICY,
    PROG,
    Command,
    Completion,
    Methods,
    Report,
    Run,
    Settings,
    Study,
    Submit,
    Watch,
    overview,
)
from mpdt.train.policy_options import Bundle, Evaluate, EvaluatePolicy, Pull, Push, Rollout

if TYPE_CHECKING:
    from mpdt.train.run.begin import Beginning
    from mpdt.train.run.config import TrainConfig
    from mpdt.train.run.stop import StopRequest


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the script. Exits with the code of the error; 130 or 143 if stopped."""
    arguments = hide(sys.argv[1:] if argv is None else argv)  # no password reaches a message
    verb = arguments.pop(0) if arguments and not arguments[0].startswith("-") else "run"
    # Until a run listens nothing is begun that could be lost, and libraries in the middle of
    # their import answer KeyboardInterrupt with anything from a traceback to silence.
    before, code = signal.signal(signal.SIGINT, _leave), 0
    try:
        with reader_may_leave():
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
        command, rest = parse(verb, arguments)
        if isinstance(command, Report | Submit | Bundle | Push | Pull):  # they write, and are short
            with interruptible():
                return execute(command, rest)
        return execute(command, rest)
    except Interrupted as stop:
        again = shlex.join([PROG, verb, *arguments])
        sys.stderr.write(how_to_go_on(again, once=verb == "bundle") + "\n")
        return stop.exit_code
    except (MpdtError, OSError) as error:
        shown = told(error)
        if verbose:
            traceback.print_exc()
        sys.stderr.write(shown.render() + "\n")
        return shown.exit_code


def parse(verb: str, arguments: list[str]) -> tuple[Command, list[str]]:
    """The command as typed, and what are settings of a run.

    Raises: UsageError for an unknown verb; exits with 2 for a mistyped option.
    """
    if verb == "evaluate" and any(word.partition("=")[0] == "--policy" for word in arguments):
        verb = EVALUATE_POLICY
    if verb not in COMMANDS:
        from mpdt.errors import unknown_name

        raise unknown_name("command", verb, COMMANDS, where=PROG)
    refuse_folder_names(arguments, COMMANDS[verb])
    is_run = verb == "run"
    command, rest = tyro.cli(
        COMMANDS[verb], prog=PROG if is_run else f"{PROG} {verb.split()[0]}",
        description=overview() if is_run else inspect.cleandoc(COMMANDS[verb].__doc__ or ""),
        args=_one_data(verb, arguments), return_unknown_args=True,
    )  # fmt: skip
    return command, rest


def _one_data(verb: str, arguments: list[str]) -> list[str]:
    """The words behind `--data` as one that names all the files.

    A command with a folder takes one word there unless its folder came first: it always did.
    """
    takes_folder = any(one.name == "folder" for one in fields(COMMANDS[verb]))
    if "--data" not in arguments or (takes_folder and arguments[0].startswith("-")):
        return arguments
    at = arguments.index("--data") + 1
    behind = takewhile(lambda word: not word.startswith("-"), arguments[at:])
    words = list(behind)
    if len(words) < 2:
        return arguments
    from mpdt.data.slices.several import one_ref

    return [*arguments[:at], one_ref(words), *arguments[at + len(words) :]]


def execute(command: Command, rest: list[str]) -> int:
    """Run one parsed command; `rest` are settings, which not every command takes."""
    if isinstance(command, Run):
        return _run(command, rest)
    if isinstance(command, EvaluatePolicy):
        return judge_others(command, rest)
    if isinstance(command, Evaluate):
        return judge(command, rest)
    if rest:
        from mpdt.errors import UsageError

        raise UsageError(f"unknown option '{rest[0]}'", where=PROG)
    if isinstance(command, Settings):
        from mpdt.train.run.presets import get_preset
        from mpdt.train.run.show import settings_text

        sys.stdout.write(settings_text(get_preset(command.preset), command.json))
        return 0
    if isinstance(command, Bundle):
        return bundle(command)
    if isinstance(command, Rollout):
        return roll_out(command)
    if isinstance(command, Push | Pull):
        return travel(command)
    if isinstance(command, Methods):
        from mpdt.train.run.catalogue import print_catalogue

        return print_catalogue(command.preset, command.json)
    if isinstance(command, Watch):
        from mpdt.train.run.watch import watch

        return watch(command.folder, command.once, command.json)
    if isinstance(command, Submit):
        from mpdt.train.board.show import submit_and_show

        return submit_and_show(command)
    if isinstance(command, Completion):
        return _completion(command)
    if isinstance(command, Study):
        return _study(command)
    from mpdt.train.report.show import show_report

    return show_report(command)


def _completion(command: Completion) -> int:
    from mpdt.data.verbs.completion import completion_script
    from mpdt.data.verbs.options import print_result

    verbs = {name: one for name, one in COMMANDS.items() if name != EVALUATE_POLICY}
    script = completion_script(PROG, verbs, command.shell)
    print_result({"shell": command.shell, "script": script}, script, command.json)
    return 0


def _run(command: Run, rest: list[str]) -> int:
    from mpdt.train.run.folder import locate
    from mpdt.train.run.names import name_of_data
    from mpdt.train.run.pipeline import run_pipeline
    from mpdt.train.run.prepare import prepare
    from mpdt.train.run.progress import Progress
    from mpdt.train.run.show import print_results, what_next
    from mpdt.train.track.follow import Following
    from mpdt.train.track.tracker import chosen_trackers

    beginning = None
    if command.begin is not None:
        from mpdt.data.remote.address import revealed
        from mpdt.train.run.begin import Beginning
        from mpdt.train.run.load import bundle_folder

        beginning = Beginning.at(bundle_folder(revealed(command.begin)))
    names = () if command.log is None else chosen_trackers(command.log)
    config = parse_settings(command, rest, beginning)
    usual = f"{name_of_data(command.data)}-{command.method or command.preset}"
    folder = locate(command.runs_dir, usual if command.name is None else command.name)

    def body(stop: StopRequest) -> int:
        progress = Progress(command.quiet, stop)
        results = run_pipeline(
            prepare(config, command.data), folder, progress,
            "restart" if command.restart else "continue", command.time_limit_s,
            beginning=beginning, follower=Following(names, progress) if names else None,
        )  # fmt: skip
        if results:  # of several processes the first one tells
            print_results(results, command.json)
            progress.say(what_next(folder.path))
        return 0

    return until_stopped(body)


def _study(command: Study) -> int:
    from mpdt.data.verbs.options import print_result
    from mpdt.train.study.apart import Engine, run_cells
    from mpdt.train.study.plans import get_study
    from mpdt.train.study.study import Places, inspect_cell

    engine = Engine(command.engine, command.workers, command.address)
    cells = [cell for cell in get_study(command.name) if command.only in cell.name]
    places = Places(
        command.data_dir, command.runs_dir / command.name, command.results_dir / command.name
    )

    def body(stop: StopRequest) -> int:
        looked = (inspect_cell(cell, places) for cell in cells)
        done = run_cells(cells, places, engine, stop, command.quiet, command.restart)
        outcomes = []
        for outcome in looked if command.dry_run else done:
            line = f"{outcome.state:<8} {outcome.cell.name}  {outcome.note}"
            if not command.json:
                print_result(None, line.rstrip(), as_json=False)
            outcomes.append(
                {"cell": outcome.cell.name, "state": outcome.state, "note": outcome.note}
            )
        if command.json:
            print_result(outcomes, "", as_json=True)
        states = {one["state"] for one in outcomes}
        return 1 if "failed" in states else BusyError.exit_code if "busy" in states else 0

    return until_stopped(body, done_again=command.restart)


def parse_settings(
    command: Run, rest: Sequence[str], beginning: Beginning | None = None
) -> TrainConfig:
    """The preset with the overrides of the command line.

    Args:
        beginning: brings what its policy is made of.

    Raises: UsageError for an unknown preset or a value out of range; exits with 2 and the
        nearest option for an unknown one.
    """
    import msgspec

    from mpdt.train.run.config import TrainConfig
    from mpdt.train.run.methods import apply_method
    from mpdt.train.run.presets import get_preset

    preset = get_preset(command.preset)
    if command.steps is not None:
        share = preset.teacher.steps / max(1, preset.multitask.steps)
        preset = msgspec.structs.replace(
            preset,
            multitask=msgspec.structs.replace(preset.multitask, steps=command.steps),
            teacher=msgspec.structs.replace(preset.teacher, steps=round(command.steps * share)),
        )
    if beginning is not None:
        preset = beginning.settings(preset)
    if command.method is not None:
        preset = apply_method(preset, command.method)
    short = [] if command.adapt is None else ["--adapt.starts", command.adapt]
    return tyro.cli(TrainConfig, prog=PROG, default=preset, args=[*short, *rest])


if __name__ == "__main__":
    main()
