"""Damage files at random; every damage must be found, or be harmless by definition.

    python benchmarks/trust/fuzz.py [--flips 10000] [--mutations 1000] [--seed 0] [--json FILE]

flips       one random bit of a dataset file: `verify` fails, or nothing that the file says has
            changed (padding, unused space)
mutations   structure: arrays and attributes of a dataset file, datasets.yaml, datasets.lock,
            weights of a trained policy, Prompt-DT pickles

    found      a FAIL of verify, or one MpdtError        unchanged   what can be read is the same
    accepted   a text that says something else, and may  crash, hang  libhdf5 ended the process
    MISSED, TRACEBACK                                    must be zero: exit code 1 if not
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from damage import flip, mutate_bytes, mutate_hdf5, mutate_text

HANG_S = 60.0


# ---- the worker: looks at one damaged file after another -------------------------------------


@cache
def whole(original: Path) -> dict[str, str]:
    return logical(original)


def logical(path: Path) -> dict[str, str]:
    """Everything a file says: a hash per array and attribute."""
    found: dict[str, str] = {}
    with h5py.File(path) as file:
        names = ["/"]
        file.visit(names.append)
        for name in names:
            item = file[name]
            for key, value in item.attrs.items():
                found[f"{name}@{key}"] = hashlib.sha256(repr(value).encode()).hexdigest()
            if isinstance(item, h5py.Dataset):
                value = item[()]
                content = value.tobytes() if value.dtype.kind != "O" else repr(value).encode()
                text = f"{item.dtype} {item.shape} ".encode() + content
                found[name] = hashlib.sha256(text).hexdigest()
    return found


def look_at_dataset(path: Path, original: Path) -> str:
    from mpdt.data.verify.finding import Outcome
    from mpdt.data.verify.verify import verify

    report = verify(path, skip=["replay"])
    if report.count(Outcome.FAIL):
        return "found by " + next(f.id for f in report.findings if f.outcome is Outcome.FAIL)
    before, after = whole(original), logical(path)
    changed = [name for name in before if before[name] != after.get(name)]
    changed += [name for name in after if name not in before]
    return "unchanged" if not changed else f"MISSED {changed[0]}"


def look_at_catalog(path: Path, original: Path) -> str:
    from mpdt.data.spec.catalog import load_catalog

    load_catalog(path)
    return "accepted"


def look_at_lock(path: Path, original: Path) -> str:
    from mpdt.data.lock.file import read_lock

    return "unchanged" if read_lock(path) == read_lock(original) else "accepted"


def look_at_weights(path: Path, original: Path) -> str:
    from mpdt.model.weights import load_weights

    (header, tensors), (same_header, same) = load_weights(path), load_weights(original)
    equal = (
        header == same_header
        and tensors.keys() == same.keys()
        and all(t.equal(same[n]) for n, t in tensors.items())
    )
    return "unchanged" if equal else "MISSED weights"


def look_at_pickle(path: Path, original: Path) -> str:
    from mpdt.data.exchange.unpickle import load_pickle

    load_pickle(path)
    return "accepted"


LOOKS: dict[str, Callable[[Path, Path], str]] = {
    "dataset": look_at_dataset,
    "datasets.yaml": look_at_catalog,
    "datasets.lock": look_at_lock,
    "weights": look_at_weights,
    "Prompt-DT pickle": look_at_pickle,
}


def work() -> None:
    from mpdt.errors import MpdtError

    for line in sys.stdin:
        kind, path, original = json.loads(line)
        try:
            outcome = LOOKS[kind](Path(path), Path(original))
        except MpdtError:
            outcome = "found"
        except Exception as error:  # noqa: BLE001  exactly what must not happen
            outcome = f"TRACEBACK {type(error).__name__}: {str(error)[:80]}"
        print(json.dumps(outcome), flush=True)


class Worker:
    """A process that looks at files, replaced when it crashes or hangs."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def look(self, kind: str, path: Path, original: Path) -> str:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, __file__, "--worker"], text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        process = self._process
        assert process.stdin and process.stdout
        timer = threading.Timer(HANG_S, process.kill)
        began = time.monotonic()
        timer.start()
        try:
            process.stdin.write(json.dumps([kind, str(path), str(original)]) + "\n")
            process.stdin.flush()
            answer = process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        timer.cancel()
        if answer:
            return str(json.loads(answer))
        process.wait()
        self._process = None
        return "hang" if time.monotonic() - began >= HANG_S else "crash"


# ---- the originals ---------------------------------------------------------------------------


def originals(folder: Path) -> dict[str, Path]:
    """Small whole files of every kind, made with the project's own commands."""
    import torch

    from mpdt.model.weights import WeightsHeader, save_weights

    entry = {
        "version": "1.0.0", "family": "cheetah_dir", "horizon": 6, "seed": 5, "block": 2,
        "behaviour": {"network": "cheetah_dir", "rungs": 3, "noise": 0.1},
        "episodes": {"random": 2, "expert": 2, "history": 3}, "reference": 2,
        "tta": {"default": {"episodes": 2}}, "license": "CC0-1.0",
    }  # fmt: skip
    catalog = folder / "datasets.yaml"
    catalog.write_text(to_yaml({"schema": 1, "datasets": {"tiny": entry}}))
    run = [sys.executable, "-m", "mpdt.data.cli", "collect", "tiny", "-q", "--workers", "1"]
    subprocess.run(run, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    pickled = folder / "expert.pkl"
    random = np.random.Generator(np.random.PCG64(0))
    episode = {
        "observations": random.normal(size=(5, 20)).astype(np.float32),
        "actions": random.uniform(-1, 1, (5, 6)).astype(np.float32),
        "rewards": np.ones((5, 1), np.float32),
        "terminals": np.arange(5)[:, None] == 4,
    }
    pickled.write_bytes(pickle.dumps([episode, episode], protocol=4))
    weights = folder / "weights.safetensors"
    save_weights(weights, {"cross": torch.ones(3, 4)}, WeightsHeader(kind="mpdt"))
    return {
        "dataset": folder / "tiny.h5", "datasets.yaml": catalog,
        "datasets.lock": folder / "datasets.lock", "Prompt-DT pickle": pickled,
        "weights": weights,
    }  # fmt: skip


def to_yaml(value: Any, indent: int = 0) -> str:
    pad = "  " * indent
    return "".join(
        f"{pad}{key}:\n{to_yaml(item, indent + 1)}"
        if isinstance(item, dict)
        else f"{pad}{key}: {json.dumps(item)}\n"
        for key, item in value.items()
    )


# ---- the run ---------------------------------------------------------------------------------


def fuzz(flips: int, mutations: int, seed: int, limit_s: float) -> dict[str, dict[str, int]]:
    random = np.random.Generator(np.random.PCG64(seed))
    worker, end = Worker(), time.monotonic() + limit_s
    table: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        files = originals(Path(name))
        contents = {kind: path.read_bytes() for kind, path in files.items()}
        damaged = Path(name) / "damaged"

        def look(kind: str, row: str) -> None:
            target = damaged.with_suffix(files[kind].suffix)
            outcome = worker.look(kind, target, files[kind])
            table.setdefault(row, Counter())[outcome] += 1
            if outcome.startswith(("MISSED", "TRACEBACK")):
                print(f"{row}: {outcome}", flush=True)

        kinds = ["dataset"] * 3 + [kind for kind in files if kind != "dataset"]
        for number in range(mutations):
            if time.monotonic() > end:
                break
            kind = kinds[number % len(kinds)]
            target = damaged.with_suffix(files[kind].suffix)
            if kind == "dataset":
                target.write_bytes(contents[kind])
                mutate_hdf5(target, random)
            elif files[kind].suffix in (".yaml", ".lock"):
                target.write_bytes(mutate_text(contents[kind], random))
            else:
                target.write_bytes(mutate_bytes(contents[kind], random))
            look(kind, f"mutations of {kind}")
        for number in range(flips):
            if time.monotonic() > end:
                break
            damaged.with_suffix(".h5").write_bytes(flip(contents["dataset"], random))
            look("dataset", "bit flips of a dataset")
            if number % 500 == 499:
                print(f"{number + 1} flips {dict(table['bit flips of a dataset'])}", flush=True)
    return {row: dict(counts.most_common()) for row, counts in table.items()}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flips", type=int, default=10_000)
    parser.add_argument("--mutations", type=int, default=1_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit-s", type=float, default=3600.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if arguments.worker:
        work()
        return 0
    result = fuzz(arguments.flips, arguments.mutations, arguments.seed, arguments.limit_s)
    print(json.dumps(result, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps({"seed": arguments.seed, **result}, indent=1) + "\n")
    bad = [o for counts in result.values() for o in counts if o.startswith(("MISSED", "TRACE"))]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
