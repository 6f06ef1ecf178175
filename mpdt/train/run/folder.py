"""The folder of one run: whose it is, and the names of what lies in it.

runs/<name>/
  config.json           settings and data; refuses another run
  metrics.jsonl         losses while it goes
  checkpoint-PHASE.safetensors   exact resume, until the phase has all its updates
  teacher.safetensors   teacher prompts with their time table and head
  weights.safetensors   the trained policy, trainables only
  spent.json            seconds of training, of all processes
  results.json, report.md
  policy/               the bundle: all that acting needs (mpdt/train/bundle)
  tracked.json          what trackers have of it; tensorboard/ and wandb/ are theirs (--log)
  trials/               own episodes on unseen tasks and what was learnt from them, to go on with
  judged/HASH.json      results.json of earlier judgements of these weights, under other settings
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpdt.data.spec.change import changed_keys
from mpdt.disk import disk, expect_rights, holding, sync, write_bytes
from mpdt.errors import (
    FormatError,
    MissingFileError,
    MpdtError,
    SpecError,
    StorageError,
    TrainingError,
    UsageError,
    quoted,
)
from mpdt.reading import read_json
from mpdt.train.fit.log import MetricsLog
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.identity import Identity, from_record
from mpdt.train.run.names import MOST_LETTERS

FORMAT = "mpdt-run/3"


@dataclass(frozen=True)
class RunFolder:
    """The names in one folder, which may not exist yet."""

    path: Path

    @property
    def config(self) -> Path:
        return self.path / "config.json"

    @property
    def log(self) -> MetricsLog:
        return MetricsLog(self.path / "metrics.jsonl")

    def checkpoint(self, phase: str) -> Path:
        return self.path / f"checkpoint-{phase}.safetensors"

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
    def spent(self) -> Path:
        return self.path / "spent.json"

    @property
    def tracked(self) -> Path:
        return self.path / "tracked.json"

    @property
    def report(self) -> Path:
        return self.path / "report.md"

    @property
    def policy(self) -> Path:
        return self.path / "policy"

    @property
    def trials(self) -> Path:
        return self.path / "trials"

    def judged(self, judging: str) -> Path:
        """Where results of that hash of judging go when others take their place."""
        return self.path / "judged" / f"{judging[:16]}.json"

    def judged_ones(self) -> list[Path]:
        return sorted((self.path / "judged").glob("*.json"))

    def check_entries(self) -> None:
        """A folder brought from elsewhere may hold anything under our names.

        Raises: FormatError for a link, through which would be written; for a folder in place of a
            file, or a file in place of a folder.
        """
        for path in filter(_is_ours, sorted(self.path.glob("*"))):
            if path.is_symlink():
                raise FormatError("a link in the folder of a run", where=str(path),
                                  found=str(path.readlink()),
                                  hint="put a copy of what it leads to in its place")  # fmt: skip
            wanted, found = ("a folder", "a file")[:: 1 if _FOLDERS.fullmatch(path.name) else -1]
            if path.is_dir() != (wanted == "a folder"):
                raise FormatError("not what a run keeps under this name", where=str(path),
                                  expected=wanted, found=found,
                                  hint=f"move {quoted(path)} away")  # fmt: skip


def _is_ours(path: Path) -> bool:
    return _OURS.fullmatch(path.name) is not None


def locate(runs_dir: Path, name: str) -> RunFolder:
    """The folder of that name; touches no disk. Raises: UsageError for a bad name."""
    if not re.fullmatch(rf"[A-Za-z0-9][A-Za-z0-9_.+-]{{0,{MOST_LETTERS - 1}}}", name):
        raise UsageError(f"'{name}' cannot name a run", where="--name",
                         expected=f"1 to {MOST_LETTERS} letters, digits, . _ + -")  # fmt: skip
    return RunFolder(runs_dir / name)


def inspect(folder: RunFolder, identity: Identity, restart: bool, judges: bool = False) -> None:
    """Whether this run may be in there; changes nothing.

    Args:
        judges: its weights are only judged, by a command that neither names nor restarts a run.
        restart: what an earlier run left may be another's, for it will go.
    Raises: TrainingError for a folder of another run or of no run at all, FormatError for one
        whose config.json is damaged or that holds links, StorageError where the disk would refuse.
    """
    path = folder.path
    with disk(path):
        existing = next(
            place for place in (path, *path.absolute().parents) if os.path.lexists(place)
        )
        if not existing.is_dir():
            raise StorageError("a file is in the way", where=str(existing),
                               expected="a folder", hint=_ELSEWHERE)  # fmt: skip
        if not os.access(existing, os.R_OK | os.W_OK | os.X_OK):
            hint = "copy the run's folder to where you may write" if judges else _ELSEWHERE
            raise StorageError("no permission to write there", where=str(existing), hint=hint)
        if existing != path:
            return
        if not restart:  # which removes them
            folder.check_entries()
            for entry in filter(_is_ours, sorted(path.iterdir())):
                expect_rights(entry, grows=entry == folder.log.path)
        if folder.config.exists():
            if not restart:
                _compare(folder, identity, judges)
        elif any(not _LEFTOVER.fullmatch(entry.name) for entry in path.iterdir()):
            raise TrainingError("this folder holds files but no run", where=str(path),
                                hint="choose another --name, or move it away")  # fmt: skip


@contextmanager
def claimed(folder: RunFolder, identity: Identity, restart: bool) -> Iterator[None]:
    """Create the folder or continue in it, and keep every other process out of it.

    Args:
        restart: throw away what an earlier run left there.
    Raises: as `inspect`; BusyError with the process id of who is at work there.
    """
    inspect(folder, identity, restart)
    with disk(folder.path):
        folder.path.parent.mkdir(parents=True, exist_ok=True)
    # Training takes hours: whoever waited a little would only leave a little later.
    kept = "training goes on from its checkpoint, a judgement begins anew"
    with holding(folder.path, amends=True, wait_s=0, kept=kept):
        inspect(folder, identity, restart)  # again: only now nobody else can change it
        try:
            with disk(folder.path):
                folder.path.mkdir(exist_ok=True)
                sync(folder.path.parent)
            if restart:
                _clear(folder)
            if not folder.config.exists():
                write_config(folder, identity)
            yield
        finally:
            with suppress(OSError):
                folder.path.rmdir()  # only if nothing was written: a full disk leaves no trace


def write_config(folder: RunFolder, identity: Identity) -> None:
    """With the first step, and beside every results.json: a judgement that fails leaves the
    settings of the one before, which the next one starts from.

    Raises: StorageError.
    """
    stored = {"format": FORMAT, "training": identity.training, "judging": identity.judging}
    write_bytes(folder.config, (json.dumps(stored, indent=1) + "\n").encode())


def _compare(folder: RunFolder, identity: Identity, judges: bool) -> None:
    """Raises: TrainingError naming what differs from the training of the run that is there."""
    stored = _read_config(folder)
    old, new = stored["training"]["data"], identity.training["data"]
    for key, what in (("family", "another family"), ("content_hash", "other episodes")):
        if old.get(key) != new[key]:
            raise TrainingError(
                f"the run in this folder was trained on {what}", where=str(folder.path),
                expected=str(old.get(key))[:12], found=new[key][:12],
                hint="take the file it was trained on"
                + ("" if judges else f", or keep both with --name {quoted(folder.path.name)}-2"),
            )  # fmt: skip
    changed = changed_keys(stored["training"], identity.training)
    if changed:
        text = "; ".join(changed[:4]) + (f" and {len(changed) - 4} more" if changed[4:] else "")
        what, hint = (
            "another run lives in this folder",
            f"keep both with --name {quoted(folder.path.name)}-2, or begin anew: --restart",
        )
        if judges:
            what = "this run was trained with other settings"
            hint = f"mpdt-train --data FILE --name {quoted(folder.path.name)}-2 trains another"
        raise TrainingError(
            what, where=str(folder.path), hint=hint,
            found=re.sub(r"\b([0-9a-f]{12})[0-9a-f]{52}\b", r"\1", text),
        )  # fmt: skip


def _anew(folder: RunFolder) -> str:
    """What to do about a config.json that tells nothing, in a command that takes it."""
    return (f"move the folder away, or mpdt-train --data FILE --name {quoted(folder.path.name)} "
            "--restart begins anew")  # fmt: skip


def _read_config(folder: RunFolder) -> dict[str, Any]:
    """config.json: `training` and `judging`, each with its `data`.

    Raises: TrainingError for what is no JSON or of another version, FormatError for what is
        damaged; StorageError.
    """
    try:
        stored = read_json(folder.config)
    except StorageError:  # nothing says that it is damaged
        raise
    except MpdtError as error:
        raise TrainingError("unreadable", where=str(folder.config),
                            found=error.found or error.what,
                            hint=_anew(folder)) from error  # fmt: skip
    if (found := str(stored.get("format"))) != FORMAT:
        raise TrainingError(
            "not a run of this version",
            where=str(folder.config),
            expected=FORMAT,
            found=found,
            hint=_anew(folder),
        )
    for part in ("training", "judging"):
        facts = stored.get(part)
        if not (isinstance(facts, dict) and isinstance(facts.get("data"), dict)):
            raise FormatError(f"no object '{part}' with its 'data'", where=str(folder.config),
                              found=json.dumps(facts)[:40],
                              hint=_anew(folder))  # fmt: skip
        if not isinstance(facts["data"].get("slice"), str | None):
            raise FormatError(f"the slice in '{part}' is no name", where=str(folder.config),
                              hint=_anew(folder))  # fmt: skip
    return stored


def stored_slice(folder: RunFolder) -> str | None:
    """The slice that the run in that folder was trained on. Raises: as `stored_settings`."""
    found: str | None = _read_config(folder)["training"]["data"].get("slice")
    return found


def stored_settings(path: Path) -> TrainConfig:
    """The settings of the run in that folder.

    Raises: MissingFileError, TrainingError for what is no run or one of another version,
        FormatError for one whose config.json is damaged.
    """
    folder = RunFolder(path)
    folder.check_entries()
    if not folder.config.exists():
        raise MissingFileError("no run here", where=str(path),
                               hint="`mpdt-train --data FILE` makes one")  # fmt: skip
    stored = _read_config(folder)
    plain = {**stored["training"], **stored["judging"]}
    plain.pop("data")
    try:
        return from_record(plain)
    except SpecError as error:
        raise FormatError(
            "the settings of this run are damaged", where=str(folder.config), found=error.found,
            hint=_anew(folder),
        ) from error  # fmt: skip


def _clear(folder: RunFolder) -> None:
    """Remove everything; config.json last, so that a kill leaves a run's folder."""
    with disk(folder.path):
        for entry in sorted(folder.path.iterdir(), key=lambda entry: entry == folder.config):
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()


_FOLDERS = re.compile(r"policy|judged|trials|tensorboard|wandb|\.wandb-sending")
_OURS = re.compile(r"(config|results|spent|tracked)\.json|metrics\.jsonl|report\.md"
                   rf"|{_FOLDERS.pattern}|(teacher|weights|checkpoint-.*)\.safetensors"
                   )  # fmt: skip
_ELSEWHERE = "choose another --name or --runs-dir"
# What a kill in the first moment leaves in a new folder; the first two are of older versions.
_LEFTOVER = re.compile(r"run\.pid|config\.json\.tmp|\.config\.json\.[0-9a-f]{16}\.(tmp|lock)")
