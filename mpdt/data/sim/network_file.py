"""The two files of a behaviour network, and nothing believed of them.

    <name>.safetensors    arrays rung-00/w0, rung-00/b0, ... rung-19/b2, mean, std; of SAC low, high
    <name>.json           how it was made; each rung's measured return and level per task

Used by network.py (acting), rungs.py and pretrain.py (making). Shipped ones lie in
`mpdt/data/weights`; one's own are read where datasets.yaml says so with a path, and nowhere else:
the spec inside a data file never leads here.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load

from mpdt.data.spec.entry import is_own_network
from mpdt.disk import disk
from mpdt.errors import FormatError, MissingFileError, unknown_name

Weights = Mapping[str, NDArray[np.float32]]
"""mean, std (I,); w0 (I, H), b0 (H,), w1 (H, H), b1 (H,), w2 (H, A), b2 (A,).

With low, high (A,) it is one of SAC: `network_actions` says what that changes."""

SUFFIXES = (".safetensors", ".json")


class Rung(msgspec.Struct, frozen=True):
    """One snapshot as its record tells of it; `levels` by task name."""

    train_step: int
    levels: dict[str, float]


class NetworkRecord(msgspec.Struct, frozen=True):
    """What is needed of `<name>.json`.

    Args:
        weights_sha256: of the arrays it tells of; records of before 2026-11-30 have none.
    """

    robot: str
    reward: str
    rungs: list[Rung]
    weights_sha256: str = ""


@dataclass(frozen=True)
class Network:
    """The rungs of a network file, from untrained to final, and how they came about.

    Args:
        own: path of the arrays and their SHA-256, if they are not those that mpdt comes with.
    """

    record: NetworkRecord
    rungs: list[Weights]
    own: tuple[Path, str] | None = None


def network_files(name: str) -> tuple[Path, Path]:
    """Paths of a network's arrays and record.

    Args:
        name: of a shipped network, or the path of one's own without suffix, such as
            `./weights/cheetah_dir`.
    Raises: UsageError for an unknown name; MissingFileError.
    """
    folder, own = Path(str(resources.files("mpdt.data.weights"))), is_own_network(name)
    arrays, record = (Path(f"{name if own else folder / name}{end}") for end in SUFFIXES)
    for path in (arrays, record):
        if path.is_file():
            continue
        if own:
            raise MissingFileError("behaviour weights are not there", where=str(path),
                                   hint="mpdt-data pretrain writes both files")  # fmt: skip
        known = [path.stem for path in folder.glob("*.safetensors")]
        raise unknown_name("behaviour network", name, known, where="behaviour.network")
    return arrays, record


def load_network(name: str) -> Network:
    """The network of these files.

    Raises: as `network_files`; FormatError for files that are no network; StorageError.
    """
    arrays, record = network_files(name)
    with disk(arrays):
        content, told = arrays.read_bytes(), record.read_bytes()
    try:
        described = msgspec.json.decode(told, type=NetworkRecord)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise FormatError("not the record of a behaviour network", where=str(record),
                          found=str(error)[:160]) from error  # fmt: skip
    rungs = split_rungs(content, arrays)
    if len(rungs) != len(described.rungs):
        raise FormatError("weights and their record disagree", where=str(record),
                          expected=f"{len(rungs)} rungs",
                          found=str(len(described.rungs)))  # fmt: skip
    digest = hashlib.sha256(content).hexdigest()
    if described.weights_sha256 not in ("", digest):  # killed between the two, over older ones
        raise FormatError("weights and their record are of two trainings", where=str(record),
                          expected=f"weights of SHA-256 {described.weights_sha256[:16]}",
                          found=digest[:16],
                          hint="the same mpdt-data pretrain again writes both")  # fmt: skip
    return Network(described, rungs, (arrays.absolute(), digest) if is_own_network(name) else None)


def is_squashed(weights: Weights) -> bool:
    """Whether SAC trained it."""
    return "low" in weights or "high" in weights


def split_rungs(content: bytes, where: Path) -> list[Weights]:
    """Arrays of every rung in a network file. Raises: FormatError."""
    rungs: dict[str, dict[str, NDArray[np.float32]]] = {}
    for name, array in _arrays(content, where).items():
        rung, _, field = name.partition("/")
        rungs.setdefault(rung, {})[field] = array
    for weights in rungs.values():
        _check(weights, where)
    return [rungs[name] for name in sorted(rungs)]


def load_snapshot(path: Path) -> Weights:
    """Arrays of one rung in a file of its own. Raises: FormatError; StorageError."""
    with disk(path):
        weights = _arrays(path.read_bytes(), path)
    _check(weights, path)
    return weights


def _arrays(content: bytes, where: Path) -> dict[str, NDArray[np.float32]]:
    try:
        return dict(load(content))
    except (SafetensorError, ValueError, KeyError) as error:
        raise FormatError("not a file of weights", where=str(where),
                          found=str(error)[:160]) from error  # fmt: skip


def _check(weights: Weights, where: Path) -> None:
    """Raises: FormatError unless these are two layers and an output, all finite float32."""
    shapes = {name: array.shape for name, array in weights.items()}
    sizes = [*shapes.get("mean", ()), *(n for b in "012" for n in shapes.get(f"b{b}", ()))]
    wanted = {"mean": tuple(sizes[:1]), "std": tuple(sizes[:1])} if len(sizes) == 4 else {}
    for layer, size in enumerate(sizes[1:] if wanted else ()):
        wanted |= {f"w{layer}": (sizes[layer], size), f"b{layer}": (size,)}
    if wanted and is_squashed(weights):
        wanted |= {"low": tuple(sizes[3:]), "high": tuple(sizes[3:])}
    sound = all(a.dtype == np.float32 and np.isfinite(a).all() for a in weights.values())
    if shapes != wanted or not sound:
        found = f"{shapes}" if shapes != wanted else "numbers that are not finite float32"
        raise FormatError("not a behaviour network", where=str(where), found=found[:160],
                          expected="mean, std and three layers of finite float32, for SAC "
                          "low and high",
                          )  # fmt: skip
