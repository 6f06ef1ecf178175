"""Format `mpdt/1`: names, dtypes and shapes of everything in a file. One truth for all readers.

Every array is contiguous, unfiltered and little-endian, so that a reader can map it. Shape
letters: N steps, E episodes, R = N+E observation rows, D / A observation / action size,
K tasks, M goals, G goal size, P policies.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import h5py

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.reference import REFERENCE_POLICIES
from mpdt.data.spec.entry import canonical_json
from mpdt.data.spec.tasks import Role
from mpdt.errors import FormatError, UsageError
from mpdt.reading import decode_json

FORMAT = "mpdt/1"
ALIGNMENT_BYTES = 64
ATTRIBUTE_LIMIT_BYTES = 60_000  # HDF5 attributes stop at 64 kB (h5py/h5py#1855)
ROOT_TEXTS = ("family", "name", "version", "license", "parent", "lineage", "definition", "spec",
              "packages", "platform")  # fmt: skip
FOREIGN_HINT = "take another copy, or bring a foreign file into this format: mpdt-data import -h"

NAME_LENGTH = 120
"""Of a name in a file: most file systems stop at 255 bytes, and exports add to it."""
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

_NAME = "[^/]+"
GROUP_PATHS = re.compile(
    rf"{'|'.join(GROUPS)}|stats(/({'|'.join(STATS_FIELDS)}))?|slices|tta(/{_NAME}(/steps|/episodes)?)?"
)
"""Every group that a file may have, by path."""
ARRAY_PATHS = re.compile(
    "|".join([
        *(f"{group}/{column.path}" for group, columns in GROUPS.items() for column in columns),
        *(f"tta/{_NAME}/{f'{group}/' if group else ''}{column.path}"
          for group, columns in TTA_GROUPS.items() for column in columns),
        f"stats/({'|'.join(STATS_FIELDS)})/({'|'.join(STATS)})",
        f"slices/{_NAME}",
        # Texts, where they are too long for an attribute.
        f"{'|'.join(ROOT_TEXTS)}|stats/slice|stats/constant|tta/{_NAME}/rule",
    ])
)  # fmt: skip
"""Every array that a file may have, by path."""


def checked_name(name: str) -> str:
    """A slice or TTA set name, if HDF5 takes it as one link and `FILE:name` can ask for it.

    Raises: UsageError.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", name) or len(name) > NAME_LENGTH:
        raise UsageError(f"{name!r} cannot be a name in a file",
                         expected=f"1 to {NAME_LENGTH} letters, digits, ._+-")  # fmt: skip
    return name


def quality_codes(present: Collection[int]) -> dict[str, int]:
    """What a file says of the codes of its column `quality`.

    `policy` came later than the format: files without it keep their bytes, and their seal.
    """
    later = QUALITY_CODES["policy"]
    codes = {k: v for k, v in QUALITY_CODES.items() if v != later or later in present}
    return codes | {"unknown": -1}


def write_text(group: h5py.Group, key: str, text: str) -> None:
    """Store text as an attribute, or as a scalar dataset where it is too long for one."""
    data = text.encode("utf-8")
    if len(data) <= ATTRIBUTE_LIMIT_BYTES:
        group.attrs[key] = text
    else:
        group.create_dataset(key, data=data, dtype=h5py.string_dtype())


def write_json(group: h5py.Group, key: str, value: Any) -> None:
    """Store a value as canonical JSON text."""
    write_text(group, key, canonical_json(value).decode("utf-8"))


def parse_json(text: str, where: str) -> dict[str, Any]:
    """The object of stored JSON text.

    Raises: FormatError.
    """
    try:
        value = decode_json(text)
    except ValueError as error:
        raise FormatError("not JSON", where=where, found=text[:60]) from error
    if not isinstance(value, dict):
        raise FormatError("not a JSON object", where=where, found=text[:60])
    return value
