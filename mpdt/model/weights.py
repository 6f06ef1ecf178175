"""Trainables on disk: one safetensors file with a JSON header. Loading runs no code.

The header names what the numbers were trained on, as hashes; a file is refused rather than
loaded into another backbone, other data or other shapes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
from torch import Tensor, nn

FORMAT = "mpdt-weights/1"


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
    """Write atomically. Raises: StorageError if the disk refuses."""
    raise NotImplementedError


def load_weights(
    path: Path,
    *,
    kind: str | None = None,
    hashes: Mapping[str, str] | None = None,
    shapes: Mapping[str, tuple[int, ...]] | None = None,
) -> tuple[WeightsHeader, dict[str, Tensor]]:
    """Read and compare with what the caller expects; None compares nothing.

    Raises: MissingFileError, FormatError (not safetensors, no header, another format or kind,
    another hash), ShapeError (missing, unknown or misshapen tensors).
    """
    raise NotImplementedError


def module_shapes(module: nn.Module) -> dict[str, tuple[int, ...]]:
    """Name -> shape of a module's parameters, to pass as `shapes`."""
    return {name: tuple(value.shape) for name, value in module.named_parameters()}
