"""Write a bundle: one folder, there whole or not at all, the same bytes for the same policy."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import msgspec
from safetensors.torch import save

from mpdt.disk import appearing, disk, expect_folder, holding, sweep
from mpdt.errors import StorageError
from mpdt.train.bundle.format import (
    CARD,
    CONFIG,
    MODEL,
    BundleConfig,
    Contents,
    FileFacts,
    encoded,
)


def write_bundle(target: Path, contents: Contents, card: str) -> BundleConfig:
    """The bundle at `target`, where nothing may be; its config as it was written.

    Raises: StorageError, also where something is in the way; BusyError.
    """
    check_free(target)
    # One key: safetensors writes several in any order, and the bytes would differ.
    files = {MODEL: save(dict(contents.tensors), metadata={"format": "pt"}), CARD: card.encode()}
    config = msgspec.structs.replace(contents.config, files={
        name: FileFacts(size=len(content), sha256=hashlib.sha256(content).hexdigest())
        for name, content in files.items()
    })  # fmt: skip
    files[CONFIG] = encoded(config)
    with appearing(target) as folder, disk(target):
        for name, content in files.items():
            (folder / name).write_bytes(content)
    return config


def check_free(target: Path) -> None:
    """Raises: StorageError where no bundle can be written, before the work for it is done."""
    expect_folder(target.parent)
    if target.exists() or target.is_symlink():
        sweep(target)
        raise StorageError("something is there already", where=str(target),
                           hint="choose another folder with -o")  # fmt: skip


def remove_bundle(target: Path) -> None:
    """Take a bundle away, if there is one, all at once. Raises: StorageError; BusyError."""
    if not target.is_dir():
        return
    with holding(target) as hold, disk(target):
        try:
            target.rename(hold.temporary)
            shutil.rmtree(hold.temporary)
        except BaseException:  # a second signal: nobody finds that name once the lock is gone
            shutil.rmtree(hold.temporary, ignore_errors=True)
            raise
        hold.found = None
