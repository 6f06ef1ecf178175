"""The verbs of mpdt-train that take a policy: it acts, is written, is sent; how any ends early.

torch is imported in the bodies, so `--help` is quick.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import tyro

from mpdt.data.remote.address import hide, revealed
from mpdt.errors import UsageError, visible
from mpdt.train.options import PROG
from mpdt.train.policy_options import (
    Adapt,
    Bundle,
    Evaluate,
    EvaluatePolicy,
    Pull,
    Push,
    Rollout,
)

if TYPE_CHECKING:
    from mpdt.train.evaluate.score import Block
    from mpdt.train.run.stop import StopRequest


def until_stopped(
    body: Callable[[StopRequest], int], judges: bool = False, done_again: bool = False
) -> int:
    """The body's exit code, or that of the signal that stopped it, with how to go on.

    Args:
        judges: nothing of it is saved but trials and rows that were kept.
        done_again: of several runs those that were done as well, which --restart alone does again.
    """
    from mpdt.train.run.stop import Stopped, StopRequest

    try:
        with StopRequest().listening() as stop:
            return body(stop)
    except Stopped as stopped:
        saved = "what was saved before stays" if stopped.at_once else "saved"
        what = "not judged. Begin again" if judges else f"{saved}. Continue"
        if done_again:
            what = "cells that were not reached keep their results. Begin again"
        sys.stderr.write(f"\n{stopped}; {what} with the same command:\n")
        given = [word for word in hide(sys.argv[1:]) if done_again or word != "--restart"]
        sys.stderr.write(visible(f"  {PROG} {shlex.join(given)}") + "\n")
        return stopped.exit_code


def judge(command: Evaluate, rest: list[str]) -> int:
    import msgspec

    from mpdt.train.run.folder import RunFolder, stored_settings
    from mpdt.train.run.pipeline import run_pipeline
    from mpdt.train.run.prepare import prepare
    from mpdt.train.run.progress import Progress
    from mpdt.train.run.show import print_results

    stored = stored_settings(command.folder)
    blocks: tuple[Block, ...] = ("test",) if isinstance(command, Adapt) else ("train", "test")
    evaluation = msgspec.structs.replace(stored.evaluation, blocks=blocks)
    config = tyro.cli(
        type(stored), prog=PROG, args=rest,
        default=msgspec.structs.replace(stored, evaluation=evaluation),
    )  # fmt: skip

    if config.method != stored.method:
        raise UsageError("the method of a stored run is no setting of judging", where="--method",
                         expected=stored.method, found=config.method,
                         hint="mpdt-train --data FILE --method NAME trains another")  # fmt: skip

    def body(stop: StopRequest) -> int:
        results = run_pipeline(
            prepare(config, command.data), RunFolder(command.folder),
            Progress(command.quiet, stop), "judge", keep=command.keep,
        )  # fmt: skip
        print_results(results, command.json)
        return 0

    return until_stopped(body, judges=True)


def judge_others(command: EvaluatePolicy, rest: list[str]) -> int:
    from mpdt.train.run.config import JudgingSettings
    from mpdt.train.run.judge_outside import judge_outside
    from mpdt.train.run.progress import Progress
    from mpdt.train.run.show import print_results

    settings = tyro.cli(JudgingSettings, prog=f"{PROG} evaluate", args=rest)
    policy = revealed(command.policy)

    def body(stop: StopRequest) -> int:
        progress = Progress(command.quiet, stop)
        results = judge_outside(policy, command.data, settings.evaluation, progress, command.keep,
                                command.reads)  # fmt: skip
        print_results(results, command.json)
        return 0

    return until_stopped(body, judges=True)


def roll_out(command: Rollout) -> int:
    from mpdt.train.rollout import roll_out as making
    from mpdt.train.rollout.show import print_rolled_out
    from mpdt.train.run.load import bundle_folder
    from mpdt.train.run.progress import Progress

    asked = making.plan_roll_outs(
        bundle_folder(revealed(command.policy)), command.tasks, command.start,
        command.episodes, command.noise, command.seed,
    )  # fmt: skip

    def body(stop: StopRequest) -> int:
        progress = Progress(command.quiet, stop)
        done = making.roll_out(asked, command.output, command.workers, command.restart, progress)
        if not done.is_new:
            progress.say(f"this is done: {command.output} (again: --restart)")
        print_rolled_out(done, command.json)
        return 0

    return until_stopped(body)


def bundle(command: Bundle) -> int:
    from mpdt.data.verbs.options import print_result
    from mpdt.train.bundle.card import card_of
    from mpdt.train.bundle.write import check_free, write_bundle
    from mpdt.train.run.folder import RunFolder
    from mpdt.train.run.results import read_results, scores_in
    from mpdt.train.run.stored import bundle_of_run, check_same_run

    check_free(command.output)
    results, run = read_results(command.folder), RunFolder(command.folder)
    contents = bundle_of_run(run, command.data, not command.without_backbone)
    check_same_run(contents.config, results, run.policy)
    config = write_bundle(command.output, contents, card_of(contents.config, scores_in(results)))
    size = sum(file.size for file in config.files.values())
    facts = {"path": str(command.output), "bytes": size}
    print_result(facts, f"{command.output}   {size / 1e6:.1f} MB", command.json)
    return 0


def travel(command: Push | Pull) -> int:
    from mpdt.data.verbs.options import print_result
    from mpdt.train.bundle.travel import pull_bundle, push_bundle
    from mpdt.train.run.load import bundle_folder

    def say(line: str) -> None:
        if not command.quiet:
            sys.stderr.write(f"{line}\n")

    url = revealed(command.url)
    if isinstance(command, Push):
        folder = bundle_folder(str(command.folder))
        facts, text = push_bundle(folder, url, command.replace, command.check, say)
    else:
        facts, text = pull_bundle(url, command.output, say)
    print_result(facts, text, command.json)
    return 0
