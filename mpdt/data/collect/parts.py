"""Parts: the folder `<target>.parts/` where finished blocks wait for the pack.

    plan.json       spec, spec hash, what the bytes depend on beside it (versions, policies)
    blocks/*.npz    one finished block each, with a digest per episode:
        episodes, tta   flat columns as in the file to be, then length, goal, seed_key, progress,
                        policy and digest per episode
        reference       returns, policy and their digest, no steps: only a mean is ever kept

A part is written beside its place, forced to disk and renamed: it is there completely or not at
all. It is checked whenever it is read; a damaged one counts as missing.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mpdt.data.collect.plan import Block
from mpdt.data.episode import Episode
from mpdt.data.spec.change import changed_keys
from mpdt.data.store.digest import episode_digest
from mpdt.data.store.tables import Steps
from mpdt.disk import disk, holding, replacing, write_bytes
from mpdt.errors import (
    BusyError,
    DataError,
    FormatError,
    MissingFileError,
    MpdtError,
    StorageError,
)
from mpdt.reading import read_json

_COLUMNS = ("observations", "actions", "rewards", "terminations", "truncations")


@dataclass(frozen=True)
class PartsFolder:
    """The parts of one target file."""

    target: Path

    @property
    def path(self) -> Path:
        return self.target.with_name(self.target.name + ".parts")

    def part(self, block: Block) -> Part:
        return Part(self.path / "blocks", block)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the target, and create the folder.

        Raises: BusyError naming the process that holds it; StorageError.
        """
        # Collecting takes hours: whoever waited a little would only leave a little later.
        with holding(self.target, amends=True, wait_s=0, kept="finished blocks are kept"):
            with disk(self.path):
                (self.path / "blocks").mkdir(parents=True, exist_ok=True)
            yield

    def agree(self, plan: dict[str, Any]) -> None:
        """Write plan.json, or check that the one that is there says the same.

        Raises: DataError naming the keys that changed.
        """
        path = self.path / "plan.json"
        plan = _as_json(plan)
        found = self._read_plan()
        if found is None:
            if any((self.path / "blocks").iterdir()):
                self.clear()  # parts of an unknown plan are worth nothing
            write_bytes(path, json.dumps(plan, indent=1, sort_keys=True).encode())
        elif changed := changed_keys(found, plan):
            raise DataError(
                "the unfinished parts were made for another plan: " + "; ".join(changed),
                where=str(self.path),
                hint="--restart deletes them and starts again; or undo the change to resume",
            )

    def _read_plan(self) -> Any:
        try:
            return read_json(self.path / "plan.json")
        except (MissingFileError, FormatError):
            return None

    def clear(self) -> None:
        """Delete every part and the plan."""
        with disk(self.path):
            shutil.rmtree(self.path / "blocks", ignore_errors=True)
            (self.path / "blocks").mkdir()
            (self.path / "plan.json").unlink(missing_ok=True)

    def forget(self, plan: dict[str, Any]) -> None:
        """Delete what somebody left who was killed between a whole file and that; no error.

        Args:
            plan: of that file. Blocks of another one stay: whoever was interrupted goes on there.
        """
        with suppress(BusyError, StorageError), holding(self.target, amends=True, wait_s=0):
            if self.path.is_dir() and self._read_plan() in (None, _as_json(plan)):
                self.delete()

    @contextmanager
    def kept_if_worth(self) -> Iterator[None]:
        """Delete the folder, if what is done inside fails before any block is finished."""
        try:
            yield
        except MpdtError:
            with suppress(OSError):
                if not any((self.path / "blocks").glob("*.npz")):
                    self.delete()
            raise

    def delete(self) -> None:
        """Delete the folder; the caller holds its target. A leftover is harmless: no error."""
        shutil.rmtree(self.path / "blocks", ignore_errors=True)
        with suppress(OSError):
            for name in ("plan.json", "collector.pid"):  # the latter is of older versions
                (self.path / name).unlink(missing_ok=True)
            self.path.rmdir()


@dataclass(frozen=True)
class Part:
    """The file of one block in the folder `blocks`."""

    folder: Path
    block: Block

    @property
    def path(self) -> Path:
        return self.folder / f"{self.block.label}.npz"

    def save_episodes(self, episodes: Sequence[Episode]) -> None:
        """Write the part of a block, all or nothing."""
        goal_size = max(len(episode.goal) for episode in episodes)
        goals = np.zeros((len(episodes), goal_size))
        for row, episode in enumerate(episodes):
            goals[row, : len(episode.goal)] = episode.goal
        columns: dict[str, npt.NDArray[Any]] = {
            name: np.concatenate([getattr(episode, name) for episode in episodes])
            for name in _COLUMNS
        }
        successes = [e.successes for e in episodes if e.successes is not None]
        if successes:
            columns["successes"] = np.concatenate(successes)
        self._save(
            **columns,
            length=np.array([episode.length for episode in episodes]),
            goal=goals,
            goal_dim=np.array([len(episode.goal) for episode in episodes]),
            seed_key=np.array([episode.seed_key for episode in episodes], dtype=np.uint32),
            progress=np.array([episode.progress for episode in episodes]),
            policy=_bytes_rows([episode.policy for episode in episodes]),
            digest=_bytes_rows([episode_digest(e, self.block.task.name) for e in episodes]),
        )

    def load_episodes(self) -> list[Episode]:
        """Read the part of a block back.

        Raises: DataError if it is missing, damaged or made for another block.
        """
        labels = ("length", "goal", "goal_dim", "seed_key", "progress", "policy")
        data = self._load(*_COLUMNS, *labels)
        self._check_keys(data["seed_key"])
        steps = Steps(**{name: data[name] for name in _COLUMNS}, successes=data.get("successes"))
        starts = np.cumsum(data["length"]) - data["length"]
        episodes = []
        for row, (start, length) in enumerate(zip(starts, data["length"], strict=True)):
            episodes.append(
                steps.episode(
                    int(start),
                    int(start) + row,
                    int(length),
                    data["seed_key"][row],
                    task=self.block.task.index,
                    goal=data["goal"][row, : data["goal_dim"][row]],
                    quality=int(self.block.quality),
                    progress=float(data["progress"][row]),
                    policy=data["policy"][row].tobytes(),
                )
            )
            if episode_digest(episodes[-1], self.block.task.name) != data["digest"][row].tobytes():
                raise self._damaged(f"digest of row {row} does not match")
        return episodes

    def save_returns(self, returns: npt.NDArray[np.float64], policy: bytes) -> None:
        """Write the part of a reference block: returns only, bound to the hash of who acted."""
        digest = _returns_digest(self.block, returns, policy)
        columns = {"policy": _bytes_rows([policy]), "digest": _bytes_rows([digest])}
        self._save(returns=returns, **columns)

    def load_returns(self) -> tuple[npt.NDArray[np.float64], bytes]:
        """Read a reference block back: returns (rows,), and the hash of who acted.

        Raises: DataError as `load_episodes`.
        """
        data = self._load("returns", "policy")
        returns, policy = data["returns"], data["policy"].tobytes()
        if data["digest"].tobytes() != _returns_digest(self.block, returns, policy):
            raise self._damaged("digest does not match")
        if len(returns) != self.block.rows:
            raise self._damaged(f"{len(returns)} of {self.block.rows} returns")
        return returns, policy

    def _save(self, **arrays: npt.NDArray[Any]) -> None:
        with replacing(self.path) as temporary, disk(self.path), temporary.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]

    def _load(self, *names: str) -> dict[str, npt.NDArray[Any]]:
        try:
            # Opened here: np.load leaks the file it opens if that is no archive.
            with self.path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                data = {name: archive[name] for name in archive.files}
        except FileNotFoundError:
            raise self._damaged("no such part") from None
        except (zipfile.BadZipFile, ValueError, KeyError, EOFError, OSError) as error:
            raise self._damaged(str(error)) from error
        if missing := {*names, "digest"} - set(data):
            raise self._damaged(f"no column {sorted(missing)[0]}")
        return data

    def _check_keys(self, keys: npt.NDArray[np.uint32]) -> None:
        """A part moved to another block's name is whole, but not this block."""
        wanted = (self.block.task.index, int(self.block.quality), self.block.number)
        found = [tuple(int(n) for n in key[1:]) for key in keys]
        if found != [(*wanted, row) for row in range(self.block.rows)]:
            raise self._damaged(f"{len(found)} episodes, from {found[:1]}")

    def _damaged(self, found: str) -> DataError:
        return DataError(
            "damaged part",
            where=str(self.path),
            found=found,
            hint="run the same collect again: damaged parts are done again",
        )


def _bytes_rows(digests: Sequence[bytes]) -> npt.NDArray[np.uint8]:
    return np.frombuffer(b"".join(digests), dtype=np.uint8).reshape(len(digests), 32)


def _returns_digest(block: Block, returns: npt.NDArray[np.float64], policy: bytes) -> bytes:
    return hashlib.sha256(block.label.encode() + b"\0" + policy + returns.tobytes()).digest()


def _as_json(plan: dict[str, Any]) -> Any:
    """A round trip, so that tuples and lists compare equal."""
    return json.loads(json.dumps(plan))
