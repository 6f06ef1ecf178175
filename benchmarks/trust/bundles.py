"""Change bundles of policies; each change is one clear error, or acts as what it says.

    python benchmarks/trust/bundles.py [--mutations 300] [--seed 0] [--bundle DIR] [--json FILE]

bytes       bits, lengths, missing files, files of another bundle, folders and links in their place
facts       config.json under a new seal: types, names that leave the folder, huge numbers, versions
tensors     model.safetensors under new digests: names, shapes, types, headers that promise more

    error       one MpdtError, and nothing was loaded
    acts        what somebody may say who seals it again: the policy acts, in finite numbers
    TRACEBACK, NAN, HANG (over 20 s of processor time), MEMORY (over 512 MB more)     must be zero

Without --bundle it makes one, in about a minute.
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import json
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

CONFIG, MODEL, CARD = "config.json", "model.safetensors", "README.md"
FILES = (CONFIG, MODEL, CARD)
HANG_S, MOST_BYTES = 20, 512 << 20
Draw = np.random.Generator
NASTY: tuple[Any, ...] = (
    None, "", "x\0y", "../../etc/passwd", "/etc/passwd", -1, 0, 1, 10**6, 10**12, 2**70, 0.5, -0.0,
    1e39, 1e308, True, [], [[]], {}, {"a": 1}, ["own"], "mpdt-policy/2", "\ud7ff" * 50, "float16",
)  # fmt: skip


# ---- bytes -----------------------------------------------------------------------------------


def flip(folder: Path, draw: Draw) -> None:
    path = folder / FILES[draw.integers(3)]
    content = bytearray(path.read_bytes())
    content[draw.integers(len(content))] ^= 1 << int(draw.integers(8))
    path.write_bytes(content)


def cut(folder: Path, draw: Draw) -> None:
    path = folder / FILES[draw.integers(3)]
    content = path.read_bytes()
    path.write_bytes(content[: draw.integers(len(content))])


def longer(folder: Path, draw: Draw) -> None:
    with (folder / FILES[1 + draw.integers(2)]).open("ab") as file:
        file.write(draw.bytes(int(draw.integers(1, 5000))))


def missing(folder: Path, draw: Draw) -> None:
    (folder / FILES[draw.integers(3)]).unlink()


def other_kind(folder: Path, draw: Draw) -> None:
    path = folder / FILES[draw.integers(3)]
    path.unlink()
    if draw.integers(2):
        path.mkdir()
    else:
        path.symlink_to(path.name)


def swapped(folder: Path, draw: Draw) -> None:
    one, other = (folder / FILES[i] for i in draw.permutation(3)[:2])
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)


def no_json(folder: Path, draw: Draw) -> None:
    texts = (b"[" * 100_000, b"{}", b"[]", b"null", b"\xff\xfe", b'{"format": "mpdt-policy/1"}',
             b'{"format": "mpdt-policy/9"}', b"{" + b'"a":' * 50_000)  # fmt: skip
    (folder / CONFIG).write_bytes(texts[draw.integers(len(texts))])


# ---- facts, under a new seal -----------------------------------------------------------------


def resealed(folder: Path, plain: dict[str, Any]) -> None:
    from mpdt.train.bundle.format import seal

    plain.pop("seal", None)
    try:
        plain["seal"] = seal(plain)
    except (ValueError, UnicodeEncodeError):
        plain["seal"] = "none"
    (folder / CONFIG).write_text(json.dumps(plain), encoding="utf-8")


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every key and index below; a long list counts by its first elements."""
    items = value.items() if isinstance(value, dict) else enumerate(value[:2])
    found = []
    for key, below in items:
        found.append((*path, key))
        if isinstance(below, dict | list):
            found += places(below, (*path, key))
    return found


def parent(plain: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        plain = plain[key]
    return plain


def fact(folder: Path, draw: Draw) -> None:
    plain = json.loads((folder / CONFIG).read_text())
    known = [path for path in places(plain) if path[:2] != ("training", "settings")]
    path = known[draw.integers(len(known))]
    own = parent(plain, path)
    how = draw.integers(8)
    if how == 0:
        del own[path[-1]]
    elif how == 1 and isinstance(own, dict):
        own[f"{path[-1]}2"] = own[path[-1]]
    elif how == 2 and isinstance(own[path[-1]], list):
        own[path[-1]] = own[path[-1]] * 2
    else:
        own[path[-1]] = NASTY[draw.integers(len(NASTY))]
    resealed(folder, plain)


def huge(folder: Path, draw: Draw) -> None:
    """A size that somebody would allocate."""
    plain = json.loads((folder / CONFIG).read_text())
    known = [path for path in places(plain) if type(parent(plain, path)[path[-1]]) is int]
    path = known[draw.integers(len(known))]
    parent(plain, path)[path[-1]] = (10**7, 10**9, 2**62)[draw.integers(3)]
    resealed(folder, plain)


def files(folder: Path, draw: Draw) -> None:
    """Names that leave the folder, and digests of the other file."""
    plain = json.loads((folder / CONFIG).read_text())
    known = plain["files"]
    how = draw.integers(4)
    if how == 0:
        known["../x"] = known.pop(MODEL)
    elif how == 1:
        known["/etc/passwd"] = known[CARD]
    elif how == 2:
        known[MODEL], known[CARD] = known[CARD], known[MODEL]
    else:
        known[MODEL]["size"] += int(draw.integers(1, 1 << 40))
    resealed(folder, plain)


# ---- tensors, under new digests --------------------------------------------------------------


def stored(folder: Path, content: bytes) -> None:
    (folder / MODEL).write_bytes(content)
    plain = json.loads((folder / CONFIG).read_text())
    plain["files"][MODEL] = {"size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    resealed(folder, plain)


def tensor(folder: Path, draw: Draw) -> None:
    import torch
    from safetensors.torch import load, save

    tensors = load((folder / MODEL).read_bytes())
    names = sorted(tensors)
    name = names[draw.integers(len(names))]
    value = tensors.pop(name)
    changes: list[Callable[[], dict[str, Any]]] = [
        dict,
        lambda: {f"{name}.x": value},
        lambda: {name: value, "code.py": value.clone()},
        lambda: {name: value[None].clone()},
        lambda: {name: torch.cat([value, value])} if value.dim() else {},
        lambda: {name: value.to(torch.float16)},
        lambda: {name: value.to(torch.int32)},
        lambda: {name: torch.full_like(value, float("nan"))},
        lambda: {name: torch.full_like(value, float("inf"))},
        lambda: {name: value.flatten()[:1].clone()},
        lambda: {name: value.flatten()[:0].clone()},
        lambda: {name: value.double()},
    ]
    stored(folder, save({**tensors, **changes[draw.integers(len(changes))]()}))


def header(folder: Path, draw: Draw) -> None:
    """A safetensors header that promises what is not there."""
    content = (folder / MODEL).read_bytes()
    size = struct.unpack("<Q", content[:8])[0]
    said = json.loads(content[8 : 8 + size])
    name = sorted(key for key in said if key != "__metadata__")[draw.integers(len(said) - 1)]
    how = draw.integers(5)
    if how == 0:
        said[name]["shape"] = [10**6, 10**6]
    elif how == 1:
        said[name]["data_offsets"] = [0, 1 << 40]
    elif how == 2:
        said[name]["dtype"] = "I64"
    elif how == 3:
        said[f"{name}2"] = copy.deepcopy(said[name])
    text = json.dumps(said).encode()
    length = len(text) if how != 4 else int(draw.integers(1 << 40))
    stored(folder, struct.pack("<Q", length) + text + content[8 + size :])


KINDS: dict[str, tuple[Callable[[Path, Draw], None], ...]] = {
    "bytes": (flip, cut, longer, missing, other_kind, swapped, no_json),
    "facts": (fact, fact, fact, huge, files),
    "tensors": (tensor, tensor, header),
}


# ---- looking at what came of it --------------------------------------------------------------


def look(folder: Path) -> tuple[str, str]:
    """Load and act: what happened, and what was said."""
    import mpdt
    from mpdt.errors import MpdtError

    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    try:
        policy = mpdt.load_policy(folder)
        actions = [policy.act(np.zeros(policy.family.observation_size), paid) for paid in (None, 1)]
        outcome, said = "acts" if np.isfinite(actions).all() else "NAN", ""
    except MpdtError as error:
        outcome, said = ("error" if "\n" not in str(error) else "TRACEBACK"), str(error)
    except BaseException:  # noqa: BLE001, everything else is what this looks for
        outcome, said = "TRACEBACK", traceback.format_exc()
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    if grown > MOST_BYTES:
        return "MEMORY", f"{grown:,} bytes; {said}"
    return ("HANG", said) if time.process_time() - began > HANG_S else (outcome, said)


def run(bundle: Path, mutations: int, seed: int) -> dict[str, Any]:
    """Counts per kind of change, and what must not be."""
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    bad: list[str] = []
    assert look(bundle)[0] == "acts", "the bundle itself does not act"
    for number in range(mutations):
        kind = list(KINDS)[number % len(KINDS)]
        draw = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, number])))
        change = KINDS[kind][draw.integers(len(KINDS[kind]))]
        with tempfile.TemporaryDirectory() as work:
            folder = Path(shutil.copytree(bundle, Path(work) / "policy"))
            change(folder, draw)
            outcome, said = look(folder)
        if kind == "bytes" and outcome == "acts":
            outcome, said = "SILENT", "damage that nobody noticed"
        counts[kind][outcome] += 1
        if outcome not in ("error", "acts"):
            bad.append(f"{number} {change.__name__}: {outcome} {said}")
    return {"mutations": mutations, "seed": seed, "bad": bad,
            "outcomes": {kind: dict(of_kind) for kind, of_kind in counts.items()}}  # fmt: skip


def made(work: Path) -> Path:
    """A bundle of a tiny run."""
    train = [sys.executable, "-m", "mpdt.train.cli"]
    data = [sys.executable, "-m", "mpdt.data.cli", "collect", "cheetah_dir", "--smoke"]
    subprocess.run([*data, "-o", "tiny.h5", "--quiet"], cwd=work, check=True)
    words = "--data tiny.h5 --preset smoke --name run --threads 1 --quiet --evaluation.horizon 2"
    subprocess.run([*train, *words.split()], cwd=work, check=True, stdout=subprocess.DEVNULL)
    return work / "runs" / "run" / "policy"


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--mutations", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bundle", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        found = run(given.bundle or made(Path(work)), given.mutations, given.seed)
    for kind, outcomes in found["outcomes"].items():
        print(f"{kind:<8} {outcomes}")
    for line in found["bad"]:
        print(line)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n")
    return 1 if found["bad"] else 0


if __name__ == "__main__":
    sys.exit(main())
