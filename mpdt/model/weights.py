"""Trainables on disk: one safetensors file with a JSON header. Loading runs no code.

The header names what the numbers were trained on, as hashes; a file is refused rather than
loaded into another backbone, other data or other shapes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import msgspec
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from mpdt.disk import disk, write_bytes
from mpdt.errors import FormatError, MissingFileError, ShapeError
from mpdt.reading import open_plain

FORMAT = "mpdt-weights/1"
_MOST_HEADER = 2**24  # bytes; ours have some thousands
# What the library trips over in a file that is none, or holds kinds of numbers that torch lacks.
_UNREADABLE = (
    SafetensorError, OSError, ValueError, TypeError, RuntimeError, LookupError, AttributeError,
    OverflowError,
)  # fmt: skip


class WeightsHeader(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a file of weights says about itself."""

    kind: str
    """What the tensors are: "mpdt", "teacher", "soft-prompt", ..."""
    hashes: dict[str, str] = {}
    """What they were trained on, e.g. backbone fingerprint, content hash of the data."""
    settings: dict[str, object] = {}
    """Settings of the run, JSON values only."""
    format: str = FORMAT


def save_weights(path: Path, tensors: Mapping[str, Tensor], header: WeightsHeader) -> None:
    """Write atomically. Raises: BusyError, or StorageError if the disk refuses."""
    # Own copies: safetensors refuses tensors that share memory.
    own = {name: value.detach().clone().contiguous() for name, value in tensors.items()}
    # One key: safetensors writes several in any order, and the bytes would differ.
    said = msgspec.json.encode(header).decode()
    data = save(own, metadata={"mpdt": f"{_digest(own, said)}\n{said}"})
    with disk(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)


def load_weights(
    path: Path, *, kind: str | None = None, hashes: Mapping[str, str] | None = None
) -> tuple[WeightsHeader, dict[str, Tensor]]:
    """Read and compare with what the caller expects; None compares nothing.

    Raises: MissingFileError, FormatError (not safetensors, no header, another format or kind,
    another hash); StorageError where the disk refuses.
    """
    if not path.is_file():
        is_folder = path.is_dir()
        raise MissingFileError(
            "no such file of weights", where=str(path), found="a folder" if is_folder else "",
            hint="move it away" if is_folder else "`mpdt-train --data FILE` writes one",
        )  # fmt: skip
    open_plain(path).close()  # what the disk refuses is no damage
    try:
        _check_length(path)
        with safe_open(path, framework="pt") as stored:
            text = (stored.metadata() or {}).get("mpdt")
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
        found = _digest(tensors, (text or "").rpartition("\n")[2])
    except _UNREADABLE as error:
        raise FormatError(
            "not a whole safetensors file",
            where=str(path),
            found=str(error),
            hint="take another copy, or train again",
        ) from error
    digest, _, text = (text or "").rpartition("\n")
    header = _read_header(path, text or None)
    if digest != found:
        raise FormatError(
            "the contents are not those that were written",
            where=str(path),
            hint="take another copy, or train again",
        )
    if kind is not None and header.kind != kind:
        raise FormatError("other weights", where=str(path), expected=kind, found=header.kind,
                          hint="put back those that were there, or train again with --restart"
                          )  # fmt: skip
    for name, value in (hashes or {}).items():
        if header.hashes.get(name) != value:
            raise FormatError(
                f"trained on another {name}",
                where=str(path),
                expected=value,
                found=header.hashes.get(name, "nothing recorded"),
                hint=f"use the {name} these weights were trained with, or train again",
            )
    return header, tensors


def _check_length(path: Path) -> None:
    """Before the library reserves what a header asks for. Raises: ValueError."""
    with path.open("rb") as file:
        declared = int.from_bytes(file.read(8), "little")
    if declared > min(path.stat().st_size - 8, _MOST_HEADER):
        raise ValueError(f"a header of {declared:,} bytes, in a file of {path.stat().st_size:,}")


def _digest(tensors: Mapping[str, Tensor], header: str) -> str:
    """SHA-256 over the header, then name, type, shape and bytes of each tensor, by name."""
    whole = hashlib.sha256(f"{header}\n".encode())
    for name in sorted(tensors):
        tensor = tensors[name].cpu().contiguous()
        whole.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        whole.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return whole.hexdigest()


def check_shapes(
    expected: Mapping[str, tuple[int, ...]], tensors: Mapping[str, Tensor], where: str
) -> None:
    """Raises: ShapeError naming the first tensor that is missing, unknown or misshapen."""
    for name in sorted(set(expected) | set(tensors)):
        want = str(expected[name]) if name in expected else "no such tensor"
        have = str(tuple(tensors[name].shape)) if name in tensors else "no such tensor"
        if want != have:
            raise ShapeError(
                f"tensor '{name}' does not fit", where=where, expected=want, found=have
            )


def _read_header(path: Path, text: str | None) -> WeightsHeader:
    if text is None:
        raise FormatError(
            "safetensors, but not written by mpdt", where=str(path), expected=f"format {FORMAT}"
        )
    try:
        found = str(msgspec.json.decode(text, type=dict[str, object]).get("format"))
        if found != FORMAT:
            raise FormatError(
                "weights of another format",
                where=str(path),
                expected=FORMAT,
                found=found,
                hint="install the version of mpdt that wrote them",
            )
        return msgspec.json.decode(text, type=WeightsHeader)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise FormatError("unreadable header", where=str(path), found=str(error)) from error
