"""Change every text that is read; each change is one clear error or read as what it says.

    python benchmarks/trust/texts.py [--mutations 2000] [--seed 0] [--only KIND] [--json FILE]

entries, locks, settings, results, metrics, cells, manifests of exports, attributes of dataset files
(under a new seal, as somebody would who means it), headers of weights, pickles as data. What is
changed: types, nesting, sizes, Unicode, NUL, twice, missing, huge numbers. Every text is then read
by the commands that a user would type, each in a process of its own:

    error     one line `error: ...` and the exit code of its class
    read      exit code 0
    TRACEBACK, CODE, HANG (over 10 s of processor time), MEMORY (over 1 GB), SILENT     must be zero
"""

from __future__ import annotations

import argparse
import io
import json
import os
import pickle
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from changes import change_bytes, change_value
from fuzz import originals

HANG_S, MOST_BYTES = 10, 1 << 30  # of processor time, so that a busy machine hangs nothing
STOPPED_S = 90
RUN = "--data tiny.h5 --preset smoke --name run --threads 1 --quiet --evaluation.horizon 2"
Write = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True)
class Text:
    """A text in the folder of originals, how to change it, and who reads it.

    Attributes:
        path: of what is changed, a file or folder below the folder of originals.
        change: damages the copy of it.
        commands: `data ...` or `train ...`, one of which is drawn.
    """

    path: str
    change: Write
    commands: tuple[str, ...]


def in_json(name: str = "") -> Write:
    """A value or a byte of a JSON file; `name` below a folder."""

    def change(path: Path, random: np.random.Generator) -> None:
        path = path / name if name else path
        content = path.read_bytes()
        if random.random() < 0.25:
            path.write_bytes(change_bytes(content, random))
        else:
            path.write_text(change_value(json.loads(content), random), errors="surrogatepass")

    return change


def in_lines(path: Path, random: np.random.Generator) -> None:
    """A line of a file of JSON lines."""
    lines = path.read_text().splitlines()
    at = int(random.integers(len(lines)))
    lines[at] = change_value(json.loads(lines[at]), random)
    path.write_bytes("\n".join(lines).encode(errors="surrogatepass") + b"\n")


def in_yaml(path: Path, random: np.random.Generator) -> None:
    import yaml

    content = path.read_bytes()
    if random.random() < 0.4:
        path.write_bytes(change_bytes(content, random))
    else:  # JSON is YAML
        text = change_value(yaml.safe_load(content), random)
        path.write_bytes(text.encode(errors="surrogatepass"))


def in_attributes(path: Path, random: np.random.Generator) -> None:
    """A text of a dataset file, under a new seal."""
    from mpdt.data.store.seal import seal

    with h5py.File(path, "r+") as file:
        places = ["/"]
        file.visit(places.append)
        texts = [(place, key) for place in places for key, value in file[place].attrs.items()
                 if isinstance(value, str)]  # fmt: skip
        place, key = texts[int(random.integers(len(texts)))]
        text = str(file[place].attrs[key])
        try:
            changed = change_value(json.loads(text), random)
        except ValueError:
            changed = change_value(text, random)
            changed = changed[1:-1] if random.random() < 0.5 else changed
        try:
            del file[place].attrs[key]
            file[place].attrs[key] = changed.replace("\0", "\\0")[:60_000]
            seal(file)
        except Exception:  # noqa: BLE001  what cannot be written needs no reading
            pass


def in_texts(path: Path, random: np.random.Generator) -> None:
    """One text of a table in a dataset file, under a new seal."""
    from mpdt.data.store.seal import seal

    with h5py.File(path, "r+") as file:
        found: list[str] = []
        file.visititems(
            lambda name, item: (
                found.append(name)
                if isinstance(item, h5py.Dataset) and item.dtype.kind == "O" and item.size
                else None
            )
        )
        array = file[found[int(random.integers(len(found)))]]
        values = array.asstr()[()].reshape(-1)
        at = int(random.integers(len(values)))
        try:
            changed = change_value(json.loads(values[at]), random)
        except ValueError:
            changed = change_value(values[at], random)[1:-1]
        try:
            values[at] = changed.replace("\0", "\\0")
            array[...] = values.reshape(array.shape)
            seal(file)
        except Exception:  # noqa: BLE001
            pass


def in_header(path: Path, random: np.random.Generator) -> None:
    """The JSON header of a safetensors file, or the one of ours inside it."""
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header, rest = json.loads(content[8 : 8 + size]), content[8 + size :]
    choice = random.random()
    if choice < 0.2:
        path.write_bytes(change_bytes(content[: 8 + size], random) + rest)
        return
    if choice < 0.6:
        digest, _, said = header["__metadata__"]["mpdt"].partition("\n")
        said = change_value(json.loads(said), random)
        header["__metadata__"]["mpdt"] = f"{digest}\n{said}"
        text = json.dumps(header)
    else:
        text = change_value(header, random)
    new = text.encode(errors="surrogatepass")
    path.write_bytes(len(new).to_bytes(8, "little") + new + rest)


def in_npz(path: Path, random: np.random.Generator) -> None:
    """The manifest of a lossless npz export."""
    import zipfile

    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = next(name for name in members if name.startswith("mpdt"))
    array = np.load(io.BytesIO(members[name]), allow_pickle=False)
    raw = array.tobytes() if array.dtype.kind in "uS" else str(array).encode()
    try:
        new = change_value(json.loads(raw), random).encode(errors="surrogatepass")
    except ValueError:
        new = change_bytes(raw, random)
    buffer = io.BytesIO()
    value = np.frombuffer(new, np.uint8) if array.dtype.kind == "u" else np.array(new)
    np.save(buffer, value.astype(array.dtype) if array.dtype.kind == "u" else value)
    members[name] = buffer.getvalue()
    with zipfile.ZipFile(path, "w") as archive:
        for key, content in members.items():
            archive.writestr(key, content)


def in_pickle(path: Path, random: np.random.Generator) -> None:
    """An episode with another type, shape or key somewhere; still a well-formed pickle."""
    episodes = pickle.loads(path.read_bytes())  # ours, made above
    odd = [None, 1, 1e400, "x", b"x", [], {}, (), True, np.float32(1), np.zeros(()), 10**400,
           np.zeros((0, 3)), np.full((5, 20), np.nan), np.zeros((5, 20), "U3"), [[1], [2, 3]],
           np.zeros((5, 20), np.complex64), np.zeros(5, "M8[s]"), float("nan"), {"a": 1}]  # fmt: skip
    value = odd[int(random.integers(len(odd)))]
    keys = list(episodes[0])
    key = keys[int(random.integers(len(keys)))]
    choice = int(random.integers(6))
    if choice == 0:
        episodes = value
    elif choice == 1:
        episodes[1] = value
    elif choice == 2:
        del episodes[0][key]
    elif choice == 3:
        episodes[0][value if isinstance(value, str | int | None) else "more"] = value
    else:
        episodes[int(random.integers(2))][key] = value
    path.write_bytes(pickle.dumps(episodes, protocol=int(random.integers(2, 6))))


READ = ("data show {}", "data verify {} --skip replay", "data split {} --quality expert -o out.h5",
        "data export {} --to npz -o out", "data report {} -o out.html", "data diff {} tiny.h5",
        "train --data {} --preset smoke --name new --threads 1 --teacher.steps 1 "
        "--multitask.steps 1 --adapt.starts none --evaluation.horizon 2")  # fmt: skip
TEXTS: dict[str, Text] = {
    "datasets.yaml": Text("datasets.yaml", in_yaml, ("data list", "data plan tiny",
                                                     "data lock --check")),
    "datasets.lock": Text("datasets.lock", in_yaml, ("data lock --check",
                                                     "data verify tiny.h5 --locked --only hash")),
    "attributes of a dataset file": Text("tiny.h5", in_attributes, READ),
    "texts in tables of a dataset file": Text("tiny.h5", in_texts, READ),
    "manifest of an npz export": Text("ex-npz/tiny.npz", in_npz,
                                      ("data import {} --from npz -o out.h5",)),
    "metadata of a minari export": Text(
        "ex-minari", lambda path, random: in_json(_one(path, "metadata.json", random))(path, random),
        ("data import {} --from minari -o out.h5",
         "data import {} --from minari --family cheetah_dir -o out.h5")),
    "pickle": Text("expert.pkl", in_pickle,
                   ("data import {} --from promptdt --family cheetah_dir -o out.h5",)),
    "results of a run": Text("runs/run", in_json("results.json"),
                             ("train report runs/run", "train " + RUN,
                              "train report runs/run --html out.html")),
    "settings of a run": Text("runs/run", in_json("config.json"),
                              ("train " + RUN, "train evaluate runs/run --evaluation.horizon 2",
                               "train report runs/run --html out.html")),
    "metrics of a run": Text("runs/run/metrics.jsonl", in_lines,
                             ("train report runs/run --html out.html",)),
    "header of weights": Text("runs/run/weights.safetensors", in_header,
                              ("train evaluate runs/run --restart --evaluation.horizon 2",
                               "train report runs/run --html out.html")),
    "cell of a study": Text("cells/cell.json", in_json(), ("train report cells",
                                                           "train report cells -o out")),
}  # fmt: skip


def _one(folder: Path, name: str, random: np.random.Generator) -> str:
    found = sorted(path.relative_to(folder).as_posix() for path in folder.rglob(name))
    return found[int(random.integers(len(found)))]


def prepare(folder: Path, cell: Path) -> None:
    """The originals: a dataset, exports, a run, a cell of a study."""
    originals(folder)
    os.chdir(folder)
    for kind in ("npz", "minari"):
        assert call(f"data export tiny.h5 --to {kind} -o ex-{kind}")[0] == 0
    assert call("train " + RUN)[0] == 0
    (folder / "cells").mkdir()
    shutil.copy(cell, folder / "cells/cell.json")


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
            outcome = f"TRACEBACK {type(error).__name__}: {str(error)[:100]}"
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
    if len(re.findall(r"^(?:error|.*\berror\b)[:]", text, re.MULTILINE)) == 0 and not text.strip():
        return f"SILENT {code}"
    return "error"


def run(mutations: int, seed: int, only: str, cell: Path) -> dict[str, dict[str, int]]:
    table: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        whole, copy = Path(name).resolve() / "whole", Path(name).resolve() / "copy"
        whole.mkdir()
        prepare(whole, cell)
        kinds = [kind for kind in TEXTS if only in kind]
        for number in range(mutations):
            random = np.random.Generator(np.random.PCG64([seed, number]))
            kind = kinds[number % len(kinds)]
            text = TEXTS[kind]
            os.chdir(name)
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(whole, copy)
            os.chdir(copy)
            text.change(copy / text.path, random)
            command = text.commands[int(random.integers(len(text.commands)))].format(text.path)
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
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(words)
    target = arguments.json.resolve() if arguments.json else None
    cells = Path(__file__).resolve().parents[2] / "results/studies/one-block"
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    began = time.monotonic()
    table = run(arguments.mutations, arguments.seed, arguments.only,
                cells / "cheetah_dir.MPDT-E.s0.json")  # fmt: skip
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
