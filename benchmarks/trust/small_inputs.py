"""The inputs of limits.py: each is small, announces much, and is written by its `make`."""

from __future__ import annotations

import os
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mpdt.data.store.seal import seal

SHARE = 1
"""What the largest are divided by; writing them takes longer than refusing them."""
ENTRY = """schema: 1
datasets:
  tiny: {version: "1.0.0", family: cheetah_dir, horizon: 6, seed: 5, block: 2, license: CC0-1.0,
    behaviour: {network: cheetah_dir, rungs: 3, noise: 0.1}, reference: 2,
    episodes: {random: RANDOM, expert: 2}}
"""


@dataclass(frozen=True)
class Input:
    """One input: `make` writes it into the working folder and returns its path.

    code: the exit code that is right.
    """

    name: str
    make: Callable[[], Path]
    words: tuple[str, ...]
    code: int


def plain() -> Path:
    return Path("tiny.h5")


def declared(shape: tuple[int, int], **how: Any) -> Callable[[], Path]:
    def make() -> Path:
        path = Path(shutil.copy("tiny.h5", "declared.h5"))
        with h5py.File(path, "r+") as file:
            del file["steps/observations"]
            file.create_dataset("steps/observations", shape, "<f4", **how)
            seal(file)
        return path

    return make


def texts() -> Path:
    """A text whose length is four billion."""
    path = Path(shutil.copy("tiny.h5", "texts.h5"))
    with h5py.File(path, "r") as file:
        place = file["tasks/name"].id.get_offset()
    data = bytearray(path.read_bytes())
    data[place : place + 4] = (4_000_000_000).to_bytes(4, "little")
    path.write_bytes(data)
    return path


def zeros(archive: zipfile.ZipFile, name: str, megabytes: int) -> None:
    header = {"descr": "<f4", "fortran_order": False, "shape": (megabytes << 18,)}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, header)
        for _ in range(megabytes):
            file.write(bytes(1 << 20))


def one_more_member() -> Path:
    path = Path(shutil.copy("npz/tiny.npz", "more.npz"))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        zeros(archive, "notes", 1200 // SHARE)
    return path


def grown_member() -> Path:
    with (
        zipfile.ZipFile("npz/tiny.npz") as old,
        zipfile.ZipFile("grown.npz", "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for info in old.infolist():
            if info.filename != "rewards.npy":
                new.writestr(info, old.read(info))
        zeros(new, "rewards", 1200 // SHARE)
    return Path("grown.npz")


def equal_rows() -> Path:
    folder = Path(shutil.copytree("parquet", "rows"))
    many = 200_000_000 // SHARE
    kinds = {"dim": pa.int32(), "task": pa.int32()}
    columns = {name: pa.chunked_array([pa.repeat(pa.scalar(0, kind), 1_000_000)] * (many // 10**6))
               for name, kind in kinds.items()}  # fmt: skip
    values = pa.FixedSizeListArray.from_arrays(pa.repeat(0.0, 1_000_000), 1)
    columns["values"] = pa.chunked_array([values] * (many // 10**6))
    pq.write_table(pa.table(columns), folder / "goals.parquet", compression="zstd")
    return folder


def flat() -> Path:
    with h5py.File("flat.hdf5", "w") as file:
        for name in ("observations", "next_observations", "actions", "rewards", "terminals"):
            file.create_dataset(name, (10**12,), "<f4", chunks=(1000,))
    return Path("flat.hdf5")


def bomb() -> Path:
    """Chunks of zeros, a thousandth of their size when packed."""
    with h5py.File("bomb.hdf5", "w") as file:
        for name in ("observations", "next_observations", "actions", "rewards", "terminals"):
            array = file.create_dataset(
                name, (300_000_000,), "<f4", chunks=(10**7,), compression="gzip"
            )
            array[: 10**7] = 0
    return Path("bomb.hdf5")


def metadata() -> Path:
    folder = Path(shutil.copytree("minari", "nested"))
    for path in folder.rglob("metadata.json"):
        path.write_text('{"a": ' * 100_000)
    return folder


def text(name: str, content: str) -> Callable[[], Path]:
    def make() -> Path:
        Path(name).write_text(content)
        return Path(name)

    return make


def pipe(name: str) -> Callable[[], Path]:
    def make() -> Path:
        os.mkfifo(name)
        return Path(name)

    return make


ALIASES = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n"
    for a, b in ["ab", "bc", "cd", "de", "ef", "fg", "gh", "hi"]
)
D4RL = ("--from", "d4rl", "--family", "cheetah_dir", "--task", "forward", "-o", "x.h5")
INPUTS = (
    Input("a plain file", plain, ("show", "IN"), 0),
    Input("a plain file", plain, ("verify", "IN"), 0),
    Input("observations of shape (20,000,000, 20), none stored", declared((20_000_000, 20)),
          ("show", "IN"), 1),
    Input("observations of shape (20,000,000, 20), none stored", declared((20_000_000, 20)),
          ("verify", "IN"), 1),
    Input("observations of a terabyte in chunks, none stored",
          declared((1 << 34, 20), chunks=(1000, 20)), ("show", "IN"), 1),
    Input("a task's name of 4 GB", texts, ("show", "IN"), 1),
    Input("an npz export", lambda: Path("npz"), ("import", "IN", "--from", "npz", "-o", "x.h5"), 0),
    Input("the same with one more member of 1.2 GB", one_more_member,
          ("import", "IN", "--from", "npz", "-o", "x.h5"), 0),
    Input("rewards of 1.2 GB in it", grown_member,
          ("import", "IN", "--from", "npz", "-o", "x.h5"), 1),
    Input("a Parquet table of 200 million equal rows", equal_rows,
          ("import", "IN", "--from", "parquet", "-o", "x.h5"), 1),
    Input("flat HDF5 of 10^12 rows, none stored", flat, ("import", "IN", *D4RL), 1),
    Input("flat HDF5 of chunks of zeros", bomb, ("import", "IN", *D4RL), 1),
    Input("Minari metadata nested 100,000 deep", metadata,
          ("import", "IN", "--from", "minari", "-o", "x.h5"), 1),
    Input("datasets.yaml with aliases nested nine deep", text("datasets.yaml", ALIASES),
          ("list",), 2),
    Input("datasets.yaml of 100,000 brackets", text("datasets.yaml", "a: " + "[" * 100_000),
          ("list",), 2),
    Input("datasets.yaml that asks for 10^12 episodes",
          text("datasets.yaml", ENTRY.replace("RANDOM", "1000000000000")), ("plan", "tiny"), 2),
    Input("datasets.yaml that asks for a million blocks",
          text("datasets.yaml", ENTRY.replace("RANDOM", "1000000").replace("block: 2", "block: 1")),
          ("plan", "tiny"), 2),
    Input("a pipe named x.h5", pipe("x.h5"), ("list",), 0),
    Input("a pipe named x.h5", pipe("x.h5"), ("show", "x.h5"), 1),
    Input("a pipe named datasets.yaml", pipe("datasets.yaml"), ("list",), 1),
    Input("/dev/zero", lambda: Path("/dev/zero"), ("show", "IN"), 1),
)  # fmt: skip
