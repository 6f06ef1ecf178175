"""Change every text that is read; each change is one clear error or read as what it says.

    python benchmarks/trust/texts.py [--mutations 2000] [--seed 0] [--only KIND] [--json FILE]
                                     [--light]

entries, locks, settings, results, metrics, cells, bundles, manifests of exports, attributes of
dataset files (under a new seal, as somebody would who means it), headers of weights, sums and notes
of transfers, measured books, notes of who holds what, pickles as data. What is changed: types,
nesting, sizes, Unicode, NUL, twice, missing, huge numbers. Every text is then read by the commands
that a user would type, each in a process of its own. --light leaves out what trains or simulates
and takes a stored run; it is what `make test` does.

    error     one line `error: ...` and the exit code of its class
    read      exit code 0
    TRACEBACK, CODE, HANG (over 10 s of processor time), MEMORY (over 1 GB), SILENT     must be zero
"""

from __future__ import annotations

import argparse
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import changes
import numpy as np
from fuzz import originals

import mpdt.data.weights

HANG_S, MOST_BYTES = 10, 1 << 30  # of processor time, so that a busy machine hangs nothing
STOPPED_S = 90
RUN = "--data tiny.h5 --preset smoke --name run --threads 1 --quiet --evaluation.horizon 2"


@dataclass(frozen=True)
class Text:
    """A text in the folder of originals, how to change it, and who reads it.

    Attributes:
        path: of what is changed, a file or folder below the folder of originals.
        change: damages the copy of it.
        commands: `data ...` or `train ...`, one of which is drawn.
    """

    path: str
    change: Callable[[Path, np.random.Generator], None]
    commands: tuple[str, ...]
    heavy: tuple[str, ...] = ()
    """Commands that train, act or simulate."""


READ = ("data show {}", "data verify {} --skip replay", "data split {} --quality expert -o out.h5",
        "data export {} --to npz -o out", "data diff {} tiny.h5")  # fmt: skip
LEARN = ("data report {} -o out.html",
         "train --data {} --preset smoke --name new --threads 1 --teacher.steps 1 "
         "--multitask.steps 1 --adapt.starts none --evaluation.horizon 2")  # fmt: skip
JUDGE = "train evaluate runs/run --data tiny.h5 --evaluation.horizon 2 --evaluation.episodes 1"
TEXTS: dict[str, Text] = {
    "datasets.yaml": Text("datasets.yaml", changes.in_yaml, ("data list", "data plan tiny",
                                                     "data lock --check")),
    "datasets.lock": Text("datasets.lock", changes.in_yaml, ("data lock --check",
                                                     "data verify tiny.h5 --locked --only hash")),
    "attributes of a dataset file": Text("tiny.h5", changes.in_attributes, READ, LEARN),
    "texts in tables of a dataset file": Text("tiny.h5", changes.in_texts, READ, LEARN),
    "manifest of an npz export": Text("ex-npz/tiny.npz", changes.in_npz,
                                      ("data import {} --from npz -o out.h5",)),
    "metadata of a minari export": Text(
        "ex-minari", changes.in_metadata,
        ("data import {} --from minari -o out.h5",
         "data import {} --from minari --family cheetah_dir -o out.h5")),
    "pickle": Text("expert.pkl", changes.in_pickle,
                   ("data import {} --from promptdt --family cheetah_dir -o out.h5",)),
    "results of a run": Text("runs/run", changes.in_json("results.json"),
                             ("train report runs/run", "train report runs/run --html out.html"),
                             ("train " + RUN, JUDGE)),
    "an earlier judgement": Text("runs/run", changes.in_judged, (), (JUDGE,)),
    "what a run has cost": Text("runs/run/spent.json", changes.in_json(), (), (JUDGE,)),
    "settings of a run": Text("runs/run", changes.in_json("config.json"),
                             ("train evaluate runs/run --data tiny.h5 --threads 0",
                              "train --data tiny.h5 --preset smoke --name run --seed 1"),
                             ("train " + RUN, JUDGE)),
    "metrics of a run": Text("runs/run/metrics.jsonl", changes.in_lines,
                             ("train report runs/run --html out.html",)),
    "header of weights": Text("runs/run/weights.safetensors", changes.in_header,
                              ("train report runs/run --html out.html",), (JUDGE,)),
    "configuration of a bundle": Text(
        "runs/run/policy", changes.in_json("config.json"), (),
        ("train rollout runs/run/policy -o rolled.h5 --episodes 1 --workers 0 --tasks forward",)),
    "metadata of a parquet export": Text("ex-parquet/episodes.parquet", changes.in_parquet,
                                         ("data import ex-parquet --from parquet -o out.h5",)),
    "goals and prompts in pickles": Text(
        "ex-promptdt", changes.in_config,
        ("data import {} --from promptdt --family cheetah_dir --horizon 6 -o out.h5",)),
    "sums beside what was sent": Text("sent/tiny.h5.sha256", changes.in_bytes,
                                      ("data pull sent/tiny.h5 -o back.h5",)),
    "sums of a folder": Text("sent-folder/SHA256SUMS", changes.in_bytes,
                             ("data pull sent-folder/ -o back",)),
    "note of an interrupted transfer": Text("back.h5.part.json", changes.in_any_json,
                                            ("data pull sent/tiny.h5 -o back.h5",)),
    "who holds a file": Text(".out.h5.lock", changes.in_json(),
                             ("data split tiny.h5 --quality expert -o out.h5",)),
    "plan of an unfinished collection": Text("tiny2.h5.parts/plan.json", changes.in_json(), (),
                                             ("data collect tiny -o tiny2.h5 --workers 0",)),
    "rates of one's own": Text("metaworld.calibration.json", changes.in_json(),
                               ("data plan ml10", "data list")),
    "references of one's own": Text("references.json", changes.in_json(),
                                    ("data plan tiny", "data list")),
    "cell of a study": Text("cells/cell.json", changes.in_json(), ("train report cells",
                                                           "train report cells -o out")),
}  # fmt: skip


def prepare(folder: Path, results: Path, light: bool) -> None:
    """The originals: a dataset, exports, a run, a cell of a study, and what lies beside them.

    Args:
        results: the stored ones.
        light: the run is a stored one.
    """
    import torch

    from mpdt.model.weights import WeightsHeader, save_weights
    from mpdt.train.run.folder import FORMAT
    from mpdt.train.run.identity import JUDGING, plain_settings
    from mpdt.train.run.presets import smoke

    originals(folder)
    os.chdir(folder)
    for kind in ("npz", "minari", "parquet", "promptdt"):
        assert call(f"data export tiny.h5 --to {kind} -o ex-{kind}")[0] == 0
    if light:
        shutil.copytree(results / "runs/cheetah_vel-infer", folder / "runs/run")
        prompts = {"prompts.cross": torch.ones(3, 4), "prompts.task_v": torch.ones(2, 3, 1),
                   "prompts.task_u": torch.ones(2, 1, 4)}  # fmt: skip
        save_weights(folder / "runs/run/weights.safetensors", prompts, WeightsHeader(kind="mpdt"))
        plain = plain_settings(smoke())
        judging = {name: plain.pop(name) for name in JUDGING}
        facts = {"format": FORMAT, "training": plain | {"data": {"slice": None}},
                 "judging": judging | {"data": {}}}  # fmt: skip
        (folder / "runs/run/config.json").write_text(json.dumps(facts))
    else:
        assert call("train " + RUN)[0] == 0
        judged = folder / "runs/run/judged"
        judged.mkdir(exist_ok=True)
        shutil.copy(folder / "runs/run/results.json", judged / f"{'0' * 16}.json")
    (folder / "cells").mkdir()
    shutil.copy(results / "studies/one-block/cheetah_dir.MPDT-E.s0.json", "cells/cell.json")
    assert call("data push tiny.h5 sent/")[0] == 0
    assert call("data push ex-npz sent-folder")[0] == 0
    (folder / "back.h5.part").write_bytes((folder / "tiny.h5").read_bytes()[:5000])
    (folder / "back.h5.part.json").write_text('["a source", 5000, null]')
    holder = {"format": "mpdt-lock/1", "pid": 2**22 - 1, "host": "elsewhere", "start": "x",
              "since": "2026-01-01", "command": "mpdt-data split", "token": "0" * 16}  # fmt: skip
    (folder / ".out.h5.lock").write_text(json.dumps(holder) + "\n")
    (folder / "tiny2.h5.parts/blocks").mkdir(parents=True)
    (folder / "tiny2.h5.parts/plan.json").write_text(
        json.dumps({"spec": {"name": "tiny"}, "n": [1]})
    )
    weights = Path(mpdt.data.weights.__path__[0])
    for shipped, own in (("metaworld.json", "metaworld.calibration.json"),
                         ("references.json", "references.json")):  # fmt: skip
        book = json.loads((weights / shipped).read_text())
        (folder / own).write_text(json.dumps(book | {"entries": book["entries"][:2]}))


def call(command: str) -> tuple[int, str]:
    """Exit code and stderr of a command, in this process."""
    from mpdt.data.cli import main as data
    from mpdt.train.cli import main as train

    program, *words = command.split()
    said = io.StringIO()
    with redirect_stderr(said), redirect_stdout(io.StringIO()):
        try:
            code = (data if program == "data" else train)(words)
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    return code or 0, said.getvalue()


def read_apart(command: str) -> str:
    """What became of a command, in a child."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(STOPPED_S)
        outcome = "TRACEBACK in the child"
        try:
            began = time.process_time()
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            code, text = call(command)
            grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
            outcome = judge(code, text)
            outcome = f"MEMORY {grown / 1e6:.0f} MB" if grown > MOST_BYTES else outcome
            outcome = "HANG" if time.process_time() - began > HANG_S else outcome
        except BaseException as error:  # noqa: BLE001  exactly what must not happen
            place = traceback.extract_tb(error.__traceback__)[-1]
            at = f"{Path(place.filename).name}:{place.lineno}"
            outcome = f"TRACEBACK {type(error).__name__}: {str(error)[:100]} ({at})"
        os.write(writing, outcome.encode(errors="replace"))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        said = stream.read().decode(errors="replace")
    _, status = os.waitpid(child, 0)
    if said:
        return said
    return "HANG" if os.WTERMSIG(status) == signal.SIGALRM else f"TRACEBACK signal {status}"


def judge(code: int, text: str) -> str:
    if "Traceback" in text:
        return "TRACEBACK " + text.strip().splitlines()[-1][:100]
    if code == 0:
        return "read"
    if code not in (1, 2, 3, 4):
        return f"CODE {code}"
    lines = re.findall(r"^error: ", text, re.MULTILINE)
    return "error" if len(lines) == 1 else f"{len(lines)} ERRORS" if lines else f"SILENT {code}"


def copy_needed(whole: Path, copy: Path, said: str) -> None:
    """What a command is about: what it or the text's path names, and what is always looked at."""
    words = [word.partition("/")[0] for word in said.split()]
    copy.mkdir()
    for path in whole.iterdir():
        always = path.name in ("tiny.h5", "datasets.yaml", "datasets.lock")
        if not always and not any(word.startswith(path.name) for word in words):
            continue
        (shutil.copytree if path.is_dir() else shutil.copy)(path, copy / path.name)


def warm(whole: Path, copy: Path, kinds: Sequence[str]) -> None:
    """Import what the commands need here, where every child has it from."""
    shutil.copytree(whole, copy)
    os.chdir(copy)
    for command in dict.fromkeys(c.format(TEXTS[k].path) for k in kinds for c in TEXTS[k].commands):
        call(command)


def run(
    mutations: int, seed: int, only: str, results: Path, light: bool
) -> dict[str, dict[str, int]]:
    table: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        whole, copy = Path(name).resolve() / "whole", Path(name).resolve() / "copy"
        whole.mkdir()
        prepare(whole, results, light)
        kinds = [kind for kind in TEXTS if only in kind and (TEXTS[kind].commands or not light)]
        if light:
            os.fsync = lambda handle: None  # nobody pulls the plug
        warm(whole, copy, kinds)
        for number in range(mutations):
            random = np.random.Generator(np.random.PCG64([seed, number]))
            kind = kinds[number % len(kinds)]
            text = TEXTS[kind]
            commands = text.commands if light else text.commands + text.heavy
            command = commands[int(random.integers(len(commands)))].format(text.path)
            os.chdir(name)
            shutil.rmtree(copy, ignore_errors=True)
            copy_needed(whole, copy, f"{text.path} {command}")
            os.chdir(copy)
            text.change(copy / text.path, random)
            outcome = read_apart(command)
            table.setdefault(kind, Counter())[outcome] += 1
            if outcome not in ("error", "read"):
                print(f"{number} {kind}: {command.split()[:2]}: {outcome}", flush=True)
        os.chdir("/")
    return {kind: dict(counts.most_common()) for kind, counts in table.items()}


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mutations", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--light", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(words)
    target = arguments.json.resolve() if arguments.json else None
    results = Path(__file__).resolve().parents[2] / "results"
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    began = time.monotonic()
    table = run(arguments.mutations, arguments.seed, arguments.only, results, arguments.light)
    print(json.dumps(table, indent=1))
    if target:
        result = {"mutations": arguments.mutations, "seed": arguments.seed,
                  "seconds": round(time.monotonic() - began), "texts": table}  # fmt: skip
        target.write_text(json.dumps(result, indent=1) + "\n")
    bad = [outcome for counts in table.values() for outcome in counts
           if outcome not in ("error", "read")]  # fmt: skip
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
