"""results.json of a run: what stands in it, and how it is read, found again and set aside."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from mpdt.disk import sync
from mpdt.draw.table import html_table
from mpdt.errors import FormatError, MissingFileError, MpdtError
from mpdt.reading import read_json
from mpdt.train.evaluate.score import Score
from mpdt.train.evaluate.sealed import FORMAT, check_digest
from mpdt.train.evaluate.tables import build_tables
from mpdt.train.fit.trained import Trained
from mpdt.train.run.config import to_plain
from mpdt.train.run.folder import RunFolder
from mpdt.train.run.identity import Identity, files_of
from mpdt.train.run.machine import machine
from mpdt.train.run.prepare import Prepared

_AGAIN = "move it away; the same mpdt-train command judges the run again"
VERSIONED = ("mpdt", "torch", "transformers", "numpy", "mujoco", "metaworld")


class RunHeader(msgspec.Struct, frozen=True):
    """What is looked at of results.json beside its scores; other keys may stand there too."""

    name: str = ""
    format: str = ""
    digest: str = ""
    data: dict[str, Any] = {}
    config: dict[str, Any] = {}
    backbone: dict[str, Any] = {}
    num_trainables: int = 0
    updates: dict[str, int] = {}
    updates_asked: dict[str, int] = {}
    complete: bool = True


def results_header(
    name: str, prepared: Prepared, trained: Trained, seconds: Mapping[str, float]
) -> dict[str, Any]:
    """All of results.json but the scores.

    Args:
        seconds: wall time by part.
    """
    material, config, backbone = trained.material, prepared.config, trained.policy.backbone
    dataset = material.dataset
    return {
        "format": FORMAT,
        "name": name,
        "data": {
            "file": dataset.title,
            "name": dataset.name,
            "version": dataset.version,
            "content_hash": dataset.content_hash,
            "slice": material.slice,
            "quality": material.quality,
            "horizon": config.evaluation.horizon or material.horizon,
            **files_of(dataset),
        },
        "backbone": {
            "name": backbone.name,
            "num_layers": backbone.num_layers,
            "width": backbone.width,
            "fingerprint": backbone.fingerprint,
            "dtype": str(backbone.dtype).removeprefix("torch."),
        },
        "num_trainables": trained.num_trainables,
        "updates": dict(trained.steps),
        "updates_asked": dict(trained.asked),
        "complete": trained.complete,
        "seconds": {phase: round(value, 2) for phase, value in seconds.items()},
        "machine": machine(),
        "versions": {name: version(name) for name in VERSIONED},
        "config": to_plain(config),
        "identity": prepared.identity.hashes,
    }


class Results(dict[str, Any]):
    """results.json as a dict; a notebook shows its tables."""

    def _repr_html_(self) -> str:
        tables = build_tables(scores_in(self), "policy" not in self)
        return "".join(map(html_table, tables))


def read_results(folder: Path | str) -> Results:
    """results.json of a run's folder: settings, data, and under `scores` every row of its tables.

    Raises: MissingFileError for no folder or no end yet; FormatError for changes, another run's.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFileError("no folder of a run", where=str(folder),
                               hint="runs/NAME, as mpdt-train made it")  # fmt: skip
    RunFolder(folder).check_entries()
    results = Results(read_results_file(folder / "results.json"))
    _check_whose(results, RunFolder(folder))
    return results


def trained_as(results: Mapping[str, Any]) -> str:
    """SHA-256 of all that the training read; "" where the results do not say."""
    identity = results.get("identity")
    return str(identity.get("training")) if isinstance(identity, dict) else ""


def _check_whose(results: Mapping[str, Any], folder: RunFolder) -> None:
    """Raises: FormatError where config.json is there, whole, and tells of another training."""
    found, wanted = trained_as(results), ""
    with suppress(MpdtError):  # whoever needs config.json says what is wrong with it
        training = read_json(folder.config).get("training")
        wanted = Identity(training, {}).hashes["training"] if isinstance(training, dict) else ""
    if wanted and found and found != wanted:
        raise FormatError("the results of another run", where=str(folder.results),
                          expected=wanted[:12], found=found[:12], hint=_AGAIN)  # fmt: skip


def read_results_file(path: Path) -> dict[str, Any]:
    """The results of a run, whose parts have their types and which nobody changed.

    Raises: MissingFileError; FormatError; StorageError.
    """
    try:
        results = read_json(path)
        msgspec.convert(results, RunHeader)
        scores_in(results)
    except MissingFileError as error:
        raise MissingFileError(
            "no results here",
            where=str(path),
            hint="a run writes them at its end; the same command continues it",
        ) from error
    except FormatError as error:
        raise error.with_hint(_AGAIN) from error
    except (ValueError, KeyError) as error:
        found = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        raise FormatError("not the results of a run", where=str(path), found=found) from error
    check_digest(results, str(path), _AGAIN)
    return results


def find_results(folder: Path, identity: Mapping[str, str]) -> dict[str, Any] | None:
    """results.json if it is that of a finished run of this identity; damaged ones do not count."""
    try:
        results = read_results(folder)
    except (MissingFileError, FormatError, OSError):
        return None
    same = results.get("identity") == dict(identity) and results.get("complete") is True
    return results if same else None


def set_aside(folder: RunFolder) -> None:
    """Make room for new results: finished ones are kept under judged/, all others go."""
    with suppress(MissingFileError, FormatError):
        results = read_results_file(folder.results)
        identity = results.get("identity")
        judging = str(identity.get("judging")) if isinstance(identity, dict) else ""
        if re.fullmatch("[0-9a-f]{64}", judging) and results.get("complete") is True:
            kept = folder.judged(judging)
            kept.parent.mkdir(exist_ok=True)
            folder.results.replace(kept)
            sync(kept.parent)
            sync(folder.path)
    folder.results.unlink(missing_ok=True)


def scores_in(results: Mapping[str, Any]) -> list[Score]:
    """The scores of results.json; null is nan again."""
    rows = [
        {
            key: float("nan") if value is None and key != "success" else value
            for key, value in row.items()
        }
        for row in msgspec.convert(results["scores"], list[dict[str, Any]])
    ]
    return msgspec.convert(rows, list[Score])
