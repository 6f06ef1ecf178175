"""The folder of one run: whose it is, and the names of what lies in it.

runs/<name>/
  config.json           settings, data and backbone; refuses another run
  metrics.jsonl         losses while it goes
  checkpoint.safetensors   exact resume, until the run is done
  teacher.safetensors   teacher prompts with their time table and head
  weights.safetensors   the trained policy, trainables only
  results.json, report.md
"""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpdt.errors import StorageError, TrainingError, UsageError
from mpdt.train.config import TrainConfig, differences, identity, to_plain
from mpdt.train.material import Material
from mpdt.train.results import MetricsLog, write_atomic

FORMAT = "mpdt-run/1"


@dataclass(frozen=True)
class RunFolder:
    """An opened folder; `identity` is the hash of settings and data."""

    path: Path
    identity: str

    @property
    def config(self) -> Path:
        return self.path / "config.json"

    @property
    def log(self) -> MetricsLog:
        return MetricsLog(self.path / "metrics.jsonl")

    @property
    def checkpoint(self) -> Path:
        return self.path / "checkpoint.safetensors"

    @property
    def teacher(self) -> Path:
        return self.path / "teacher.safetensors"

    @property
    def weights(self) -> Path:
        return self.path / "weights.safetensors"

    @property
    def results(self) -> Path:
        return self.path / "results.json"

    @property
    def report(self) -> Path:
        return self.path / "report.md"


def open_folder(
    runs_dir: Path, name: str, config: TrainConfig, material: Material, restart: bool
) -> RunFolder:
    """Create the folder, or continue in it if it belongs to the same settings and data.

    Args:
        restart: throw away what an earlier run left there.
    Raises: UsageError for a bad name, TrainingError for a folder of another run,
        StorageError where the disk refuses.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", name):
        raise UsageError(f"'{name}' cannot name a run", where="--name",
                         expected="letters, digits, . _ + -")  # fmt: skip
    path = runs_dir / name
    dataset = material.dataset
    folder = RunFolder(path, identity(config, dataset.content_hash, material.slice))
    if restart and path.exists():
        _remove(path)
    if folder.config.exists():
        _compare(folder, config, material)
        return folder
    if path.exists() and any(path.iterdir()):
        raise TrainingError("this folder holds files but no run", where=str(path),
                            hint="choose another --name, or move it away")  # fmt: skip
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be created: {error.strerror}", where=str(path),
                           hint="choose another --runs-dir") from error  # fmt: skip
    _write_config(folder, config, material)
    return folder


def read_config(folder: RunFolder) -> dict[str, Any]:
    """Raises: TrainingError if config.json is not what a run writes."""
    try:
        stored: dict[str, Any] = json.loads(folder.config.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise TrainingError("unreadable", where=str(folder.config), found=str(error),
                            hint="begin anew with --restart") from error  # fmt: skip
    if stored.get("format") != FORMAT:
        raise TrainingError(
            "not a run of this version",
            where=str(folder.config),
            expected=FORMAT,
            found=str(stored.get("format")),
            hint="choose another --name, or begin anew with --restart",
        )
    return stored


def _write_config(folder: RunFolder, config: TrainConfig, material: Material) -> None:
    stored = {
        "format": FORMAT,
        "identity": folder.identity,
        "data": {
            "file": material.dataset.path.name,
            "name": material.dataset.name,
            "content_hash": material.dataset.content_hash,
            "slice": material.slice,
            "quality": material.quality,
        },
        "config": to_plain(config),
    }
    write_atomic(folder.config, (json.dumps(stored, indent=1) + "\n").encode())


def _compare(folder: RunFolder, config: TrainConfig, material: Material) -> None:
    stored = read_config(folder)
    if stored["identity"] == folder.identity:
        return
    data = {"content_hash": material.dataset.content_hash, "slice": material.slice}
    changed = differences({key: stored["data"].get(key) for key in data}, data, "data.")
    changed += differences(stored["config"], json.loads(json.dumps(to_plain(config))))
    raise TrainingError(
        "another run lives in this folder",
        where=str(folder.path),
        found="; ".join(changed[:4]) + (f" and {len(changed) - 4} more" if changed[4:] else ""),
        hint=f"keep both with --name {folder.path.name}-2, or begin anew with --restart",
    )


def _remove(path: Path) -> None:
    """Only a folder that holds a run: --restart with a wrong --name must not eat anything."""
    if any(path.iterdir()) and not (path / "config.json").exists():
        raise TrainingError("this folder holds files but no run; it is not removed",
                            where=str(path), hint="choose another --name")  # fmt: skip
    try:
        shutil.rmtree(path)
    except OSError as error:
        raise StorageError(f"cannot be removed: {error.strerror}", where=str(path)) from error
