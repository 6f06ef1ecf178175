"""Minari datasets, arrow: the same sets as in `minari.py`, a folder per episode.

    <set>/data/metadata.json
    <set>/data/<number>/metadata.json     seed and options of the episode
    <set>/data/<number>/part-0.arrow      T + 1 rows: observations, actions, rewards, terminations,
                                          truncations, infos; all but the first padded by one row

Written by Minari's own storage class, which adds up the sizes of all files after every episode:
2,400 episodes in eight sets took 27 s of processor time, in hdf5 5. Read with pyarrow alone:
Minari's reader makes the environment that a file names where the file says no spaces.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from mpdt.data.exchange import minari
from mpdt.data.exchange.manifest import KEY, Manifest
from mpdt.data.exchange.selection import Run, Selection
from mpdt.errors import FormatError, MpdtError
from mpdt.reading import read_json, refuse_other

_MOST_COMPRESSED = 100
"""Numbers per stored one at most; Minari does not compress."""
_DAMAGE = (pa.ArrowException, OSError, KeyError, ValueError, TypeError, MemoryError)


# ---- out ----


def write(selection: Selection, folder: Path) -> None:
    """One set per task and quality below `folder`. Raises: OSError."""
    from minari.dataset.minari_storage import MinariStorage
    from minari.serialization import deserialize_space

    manifest = Manifest.of(selection).to_json()
    for run in selection.runs():
        name = minari.set_id(selection, run)
        place = folder / name / "data"
        place.mkdir(parents=True)
        told = minari.metadata_of(selection, run, name) | {KEY: manifest}
        storage = MinariStorage.new(
            place,
            deserialize_space(told["observation_space"]),
            deserialize_space(told["action_space"]),
            EnvSpec.from_json(told["env_spec"]),
            "arrow",
            jpeg_encoding=False,
        )
        storage.update_episodes(_buffers(selection, run))
        known = MinariStorage.read_raw_metadata(place)
        rest = {key: value for key, value in told.items() if key not in known}
        storage.update_metadata(rest | {key: set(rest[key]) for key in ("author", "author_email")})


def _buffers(selection: Selection, run: Run) -> Iterator[Any]:
    """The episodes of a set as Minari takes them."""
    from minari.data_collector import EpisodeBuffer

    for number, i in enumerate(run.ids.tolist()):
        episode = selection.episode(i)
        told = minari.attributes_of(selection, i)
        options = {key.removeprefix("options/"): _plain(value) for key, value in told.items()
                   if key.startswith("options/")}  # fmt: skip
        infos = {}
        if episode.successes is not None:
            # A list: of an array of one number a row Minari cannot read the shape it writes.
            infos["success"] = [False, *episode.successes.tolist()]
        yield EpisodeBuffer(
            id=number, seed=told.get("seed"), options=options, infos=infos,
            **{name: getattr(episode, name) for name in minari.STEPS},
        )  # fmt: skip


def _plain(value: Any) -> Any:
    """As JSON has it, which has no NaN."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.floating):
        return None if math.isnan(value) else float(value)
    return value


# ---- in ----


@dataclass(frozen=True)
class ArrowSet:
    """The episodes below a folder."""

    folder: Path

    @cached_property
    def _numbers(self) -> frozenset[str]:
        return frozenset(path.name for path in self.folder.iterdir() if path.is_dir())

    def __len__(self) -> int:
        return len(self._numbers)

    def episode(self, number: int) -> ArrowEpisode:
        place = self.folder / str(number)
        where = f"{self.folder}: episode {number}"
        if place.name not in self._numbers:
            raise FormatError(f"no episode {number}", where=str(self.folder))
        said = read_json(place / "metadata.json", wide=("seed",))  # Minari draws 64 bits
        options = said.get("options") or {}
        if not isinstance(options, dict):
            raise FormatError("options of an episode are wrong", where=where,
                              found=type(options).__name__)  # fmt: skip
        attributes = {key: value for key, value in said.items() if key != "options"}
        attributes |= {f"options/{key}": value for key, value in options.items()}
        return ArrowEpisode(_batch(place, where), where, attributes)


@dataclass(frozen=True)
class ArrowEpisode:
    """One episode: a batch of one row more than it has steps."""

    batch: Any
    where: str
    attributes: Mapping[str, Any]

    def length(self) -> int | None:
        return len(self.batch) - 1

    def shape(self, name: str) -> tuple[int, ...]:
        return self.array(name, 0).shape[1:]

    def array(self, name: str, rows: int) -> NDArray[Any]:
        padded = 0 if name == "observations" else 1
        with _told(self.where):
            return _numbers(self._column(name)[: min(rows, len(self.batch) - padded)], name,
                            self.where)  # fmt: skip

    def _column(self, name: str) -> Any:
        if name not in self.batch.schema.names:
            raise FormatError(f"no {name}", where=self.where)
        return self.batch.column(name)

    def successes(self, rows: int) -> NDArray[Any] | None:
        if "infos" not in self.batch.schema.names:
            return None
        infos = self.batch.column("infos")
        if not pa.types.is_struct(infos.type) or infos.type.get_field_index("success") < 0:
            return None
        with _told(self.where):
            return _numbers(infos.field("success")[1:rows], "success", self.where)


def files_of(folder: Path) -> list[Path]:
    """What a set consists of, beside its own metadata."""
    return sorted(path for path in folder.glob("*/*") if path.suffix in (".arrow", ".json"))


def _batch(place: Path, where: str) -> Any:
    """The rows of one episode. Raises: FormatError."""
    found = sorted(place.glob("*.arrow"))
    if len(found) != 1:
        raise FormatError("not one file of steps", where=where, expected="part-0.arrow",
                          found=", ".join(path.name for path in found[:3]) or "none")  # fmt: skip
    refuse_other(found[0], "an Arrow file", "an Arrow file")
    size = found[0].stat().st_size
    with _told(where), pa.OSFile(str(found[0])) as stream, pa.ipc.open_file(stream) as file:
        if file.num_record_batches != 1:
            raise FormatError("not one batch of steps", where=where,
                              found=str(file.num_record_batches))  # fmt: skip
        batch = file.get_batch(0)
        batch.validate(full=True)
    if not len(batch) or batch.nbytes > _MOST_COMPRESSED * size + 1_000_000:
        raise FormatError("no steps, or more than a file of its size can hold", where=where,
                          found=f"{len(batch):,} rows, {batch.nbytes:,} bytes")  # fmt: skip
    return batch


def _numbers(column: Any, name: str, where: str) -> NDArray[Any]:
    """(rows,) or (rows, width). Raises: FormatError for anything else."""
    width = None
    kind = column.type
    if pa.types.is_fixed_size_list(kind):
        width, kind = kind.list_size, kind.value_type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        several = "observations of several parts are not supported"
        raise FormatError(f"{name} is no array of numbers", where=where, found=f"type {kind}",
                          hint=several if pa.types.is_struct(kind) else "")  # fmt: skip
    values = column if width is None else column.flatten()
    if column.null_count or values.null_count:
        raise FormatError(f"{name} has empty cells", where=where)
    found: NDArray[Any] = values.to_numpy(zero_copy_only=False)
    return found if width is None else found.reshape(len(column), width)


@contextmanager
def _told(where: str) -> Iterator[None]:
    """What pyarrow says of a file that makes no sense, as one error."""
    try:
        yield
    except MpdtError:
        raise
    except _DAMAGE as error:
        raise FormatError("damaged, or not an Arrow file of Minari", where=where,
                          found=f"{type(error).__name__}: {error}"[:160]) from error  # fmt: skip
