"""Format `mpdt/1`: names, dtypes and shapes of everything in a file. One truth for all readers.

Every array is contiguous, unfiltered and little-endian, so that a reader can map it. Shape
letters: N steps, E episodes, R = N+E observation rows, D / A observation / action size,
K tasks, M goals, G goal size, P policies.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.reference import REFERENCE_POLICIES
from mpdt.data.spec.entry import canonical_json
from mpdt.data.spec.tasks import Role
from mpdt.errors import FormatError, UsageError

FORMAT = "mpdt/1"
ALIGNMENT_BYTES = 64
_ATTRIBUTE_LIMIT_BYTES = 60_000  # HDF5 attributes stop at 64 kB (h5py/h5py#1855)

ROLE_CODES: dict[Role, int] = {"train": 0, "test": 1, "both": 2}
STATS_FIELDS = ("observations", "actions", "rewards", "returns")
STATS = ("count", "mean", "std", "min", "max", "q01", "q10", "q50", "q90", "q99")


@dataclass(frozen=True)
class Column:
    """One dataset of the file: path, dtype (`str` = UTF-8 text) and shape letters."""

    path: str
    dtype: str
    shape: tuple[str | int, ...]
    optional: bool = False


STEPS = (
    Column("observations", "<f4", ("R", "D")),
    Column("actions", "<f4", ("N", "A")),
    Column("rewards", "<f4", ("N",)),
    Column("terminations", "?", ("N",)),
    Column("truncations", "?", ("N",)),
    Column("successes", "?", ("N",), optional=True),
)
EPISODES = (
    Column("task", "<i4", ("E",)),
    Column("policy", "<i4", ("E",)),
    Column("goal", "<i4", ("E",)),
    Column("start", "<i8", ("E",)),
    Column("obs_start", "<i8", ("E",)),
    Column("length", "<i4", ("E",)),
    Column("quality", "<i1", ("E",)),
    Column("progress", "<f4", ("E",)),
    Column("seed_key", "<u4", ("E", 5)),
    Column("return", "<f8", ("E",)),
    Column("success", "?", ("E",)),
    Column("digest", "<u1", ("E", 32)),
    Column("source", "<i8", ("E",), optional=True),
)
# `ref_expert` is the mean return, `ref_expert_error` its standard error, and so on: the fields
# of a Reference for each of REFERENCE_POLICIES. NaN, 0 episodes and empty text = not known.
REFERENCE_FIELDS = (
    ("mean", "", "<f8"),
    ("error", "_error", "<f8"),
    ("episodes", "_episodes", "<i4"),
    ("success", "_success", "<f8"),
    ("source", "_source", "str"),
)
TASKS = (
    Column("name", "str", ("K",)),
    Column("env", "str", ("K",)),
    Column("role", "<i1", ("K",)),
    *(
        Column(f"ref_{name}{suffix}", dtype, ("K",))
        for name in REFERENCE_POLICIES
        for _, suffix, dtype in REFERENCE_FIELDS
    ),
    Column("ref_constant_action", "<f4", ("K", "A")),  # NaN = none chosen
)
GOALS = (
    Column("values", "<f8", ("M", "G")),
    Column("dim", "<i4", ("M",)),
    Column("task", "<i4", ("M",)),
)
POLICIES = (
    Column("hash", "<u1", ("P", 32)),
    Column("task", "<i4", ("P",)),
    Column("rung", "<i4", ("P",)),
    Column("level", "<f4", ("P",)),
    Column("train_step", "<i8", ("P",)),
    Column("mix_rate", "<f4", ("P",)),
    Column("name", "str", ("P",)),
)
TTA_STEPS = tuple(c for c in STEPS if c.path not in ("rewards", "successes"))
TTA_EPISODES = (
    *(c for c in EPISODES if c.path in ("task", "goal", "start", "obs_start", "length")),
    *(c for c in EPISODES if c.path in ("seed_key", "digest")),
    Column("preset_return", "<f4", ("E",)),
)
TTA_SIMULATOR = (
    Column("sim_rewards", "<f4", ("N",)),
    Column("sim_successes", "?", ("N",), optional=True),
)
GROUPS: dict[str, tuple[Column, ...]] = {
    "steps": STEPS,
    "episodes": EPISODES,
    "tasks": TASKS,
    "goals": GOALS,
    "policies": POLICIES,
}
TTA_GROUPS: dict[str, tuple[Column, ...]] = {
    "steps": TTA_STEPS,
    "episodes": TTA_EPISODES,
    "": TTA_SIMULATOR,
}
QUALITY_ATTRIBUTE = dict(QUALITY_CODES, unknown=-1)


def check_group(
    group: h5py.Group,
    columns: tuple[Column, ...],
    sizes: dict[str, int] | None,
    where: str,
) -> dict[str, h5py.Dataset]:
    """Compare one group with its columns; letters met first bind a size in `sizes`.

    `sizes` None: each dataset may have sizes of its own, only the number of axes counts.

    Returns: the columns that are there. Looking one up twice would double the time of opening.

    Raises: FormatError naming the first missing dataset, wrong dtype or wrong shape.
    """
    present: dict[str, h5py.Dataset] = {}
    for column in columns:
        try:
            found = group[column.path]
        except KeyError:
            if column.optional:
                continue
            path = f"{group.name}/{column.path}".replace("//", "/")
            raise FormatError(f"dataset {path} is missing", where=where,
                              hint="the file is damaged or foreign; collect it again",
                              ) from None  # fmt: skip
        dtype, shape = found.dtype, found.shape
        if column.dtype == "str":
            good = h5py.check_string_dtype(dtype) is not None
        else:
            good = dtype == np.dtype(column.dtype)
        if not good:
            raise FormatError(f"dataset {found.name} has the wrong type", where=where,
                              expected=column.dtype, found=str(dtype))  # fmt: skip
        bound = {} if sizes is None else sizes
        wanted = [bound.setdefault(letter, size) if isinstance(letter, str) else letter
                  for letter, size in zip(column.shape, shape, strict=False)]  # fmt: skip
        if len(shape) != len(column.shape) or list(shape) != wanted:
            letters = ", ".join(map(str, column.shape))
            raise FormatError(f"dataset {found.name} has the wrong shape", where=where,
                              expected=f"({letters}) = {wanted}",
                              found=str(list(shape)))  # fmt: skip
        present[column.path] = found
    return present


def checked_name(name: str) -> str:
    """A slice or TTA set name, if HDF5 takes it as one link and `FILE:name` can ask for it.

    Raises: UsageError.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", name):
        raise UsageError(f"{name!r} cannot be a name in a file", expected="letters, digits, ._+-")
    return name


def write_text(group: h5py.Group, key: str, text: str) -> None:
    """Store text as an attribute, or as a scalar dataset where it is too long for one."""
    data = text.encode("utf-8")
    if len(data) <= _ATTRIBUTE_LIMIT_BYTES:
        group.attrs[key] = text
    else:
        group.create_dataset(key, data=data, dtype=h5py.string_dtype())


def read_text(group: h5py.Group, key: str, where: str) -> str:
    """What `write_text` stored.

    Raises: FormatError where there is neither attribute nor dataset; UnicodeError.
    """
    if key in group.attrs:
        value = group.attrs[key]
    elif isinstance(dataset := group.get(key), h5py.Dataset) and dataset.shape == ():
        value = dataset[()]
    else:
        raise FormatError(f"attribute '{key}' of {group.name} is missing", where=where,
                          hint="the file is damaged or foreign; collect it again")  # fmt: skip
    text = value.decode("utf-8") if isinstance(value, bytes) else str(value)
    text.encode("utf-8")  # h5py hides bytes that are no text; they would fail when printed
    return text


def write_json(group: h5py.Group, key: str, value: Any) -> None:
    """Store a value as canonical JSON text."""
    write_text(group, key, canonical_json(value).decode("utf-8"))


def read_json(group: h5py.Group, key: str, where: str) -> dict[str, Any]:
    """What `write_json` stored; a file holds JSON objects only.

    Raises: FormatError for text that is not a JSON object.
    """
    return parse_json(read_text(group, key, where), f"{where}: {group.name} {key}")


def parse_json(text: str, where: str) -> dict[str, Any]:
    """The object of stored JSON text.

    Raises: FormatError.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError("not JSON", where=where, found=text[:60]) from error
    if not isinstance(value, dict):
        raise FormatError("not a JSON object", where=where, found=text[:60])
    return value
