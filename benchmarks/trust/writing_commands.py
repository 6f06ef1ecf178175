"""The commands that writers.py lets meet: as typed, and what each leaves."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ENTRY = """schema: 1
datasets:
  tiny:
    version: "1.0.0"
    family: cheetah_dir
    horizon: 20
    seed: 5
    block: 4
    behaviour: {network: cheetah_dir, rungs: 5, noise: 0.1}
    episodes: {random: 4, medium: 4, expert: 4}
    tta: {default: {episodes: 2}}
    license: CC0-1.0
"""
TRAINING = (
    "--preset smoke --threads 1 --statistics.batches 1 --evaluation.horizon 3 -q "
    "--evaluation.no-constants --multitask.log-every 1 --teacher.steps 2 --multitask.steps 2 "
    "--adapt.starts cross"
)
PUSHED = re.compile(r"[em]\.h5(\.sha256)?$")


@dataclass(frozen=True)
class Command:
    """One way to write a target.

    Args:
        words: as typed, with T for the target, N for a name of its own, S for the sources.
        start: "absent", or "dataset" for what adds to a file.
        replaces: whatever is at the target, because it was asked to.
        result: what of the target is its result, given the name; equal to that of a calm run.
        share: of the pairs that come up, how many are run; training takes seconds.
    """

    words: str
    result: Callable[[Path, str], Any]
    start: str = "absent"
    replaces: bool = False
    share: float = 1.0


def content(path: Path, name: str) -> Any:
    from mpdt.data.store.reader import open_dataset

    return open_dataset(path).content_hash


def pushed(sent: str) -> Callable[[Path, str], Any]:
    """A folder that is there already gets the file inside."""
    return lambda path, name: content(path / sent if path.is_dir() else path, name)


def text_of(path: Path, name: str) -> Any:
    """First and last line and the number of lines; what is between holds times."""
    lines = path.read_text().splitlines()
    return lines[0], lines[-1], len(lines)


def tree_of(path: Path, name: str) -> Any:
    """Names in a folder."""
    if not path.is_dir():
        raise ValueError("no folder")
    names = {str(p.relative_to(path)) for p in path.rglob("*")}
    return sorted(name for name in names if not PUSHED.match(name))


def has_slice(path: Path, name: str) -> Any:
    from mpdt.data.store.reader import open_dataset

    return len(open_dataset(path).slices[name])


def has_set(path: Path, name: str) -> Any:
    from mpdt.data.store.reader import open_dataset

    return len(open_dataset(path).tta[name])


def entries(path: Path, name: str) -> Any:
    return sorted((e["scene"], e["horizon"]) for e in json.loads(path.read_text())["entries"])


def run_of(path: Path, name: str) -> Any:
    results = json.loads((path / "results.json").read_text())
    names = sorted(p.name for p in path.iterdir() if not PUSHED.match(p.name))
    return names, results["identity"], len(results["scores"])


COMMANDS = {
    "split": Command("split S/cd.h5 --quality expert -o T", content),
    "split --name": Command("split T --episodes 1 --name N", has_slice, start="dataset"),
    "tta": Command("tta T --name N --episodes 1 --horizon 4 --workers 0", has_set,
                   start="dataset"),
    "merge": Command("merge S/m.h5 S/e.h5 -o T", content),
    "drop": Command("drop S/cd.h5 --episodes 0 -o T", content),
    "collect": Command("collect tiny --workers 0 -o T --spec S/datasets.yaml", content),
    "import": Command("import S/npz --from npz -o T", content),
    "export": Command("export S/cd.h5 --to npz -o T", tree_of),
    "export parquet": Command("export S/cd.h5 --to parquet -o T", tree_of),
    "pull": Command("pull S/m.h5 -o T", content),
    "pull of a folder": Command("pull S/sent -o T", tree_of),
    "push": Command("push S/m.h5 T", pushed("m.h5")),
    "push --replace": Command("push S/e.h5 T --replace", pushed("e.h5"), replaces=True),
    "report": Command("report S/cd.h5 --film none --no-verify -o T", text_of, replaces=True),
    "verify --markdown": Command("verify S/cd.h5 --only hash --markdown T", text_of,
                                 replaces=True),
    "reference": Command("reference tiny --policies zero --most 20 --workers 0 -o T "
                         "--spec S/datasets.yaml", entries),
    "training": Command("TRAIN --data S/cd.h5 --runs-dir T/.. --name t.h5 QUICK", run_of,
                        share=0.1),
    "page of a run": Command("TRAIN report S/run --html T", text_of, replaces=True),
}  # fmt: skip
