"""Read a bundle: every byte is proved before anything is made of it, and all of it fits or none.

config.json   size -> JSON -> format -> seal -> the struct -> figures that agree with each other
the others    size as declared -> SHA-256 -> names, shapes and types of tensors, all finite

What is declared is compared with what is there before memory is asked for; `build.py` makes the
policy of it.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec
import numpy as np
from safetensors import SafetensorError
from safetensors.torch import load

from mpdt.data.spec.tasks import Family, get_family
from mpdt.errors import BackboneError, FormatError, MissingFileError, MpdtError, UsageError
from mpdt.reading import decode_json
from mpdt.train.bundle.build import Bundle, built, table_of
from mpdt.train.bundle.format import (
    CARD,
    CONFIG,
    FORMAT,
    MODEL,
    BundleConfig,
    Contents,
    FamilyFacts,
    FileFacts,
    Returns,
    seal,
)

MOST_CONFIG_BYTES = 1 << 24
MOST_NUMBER = float(np.finfo(np.float32).max)
MOST_WINDOW, MOST_POSITIONS = 1 << 16, 1 << 24
_ANOTHER = "take another copy of the bundle, or write it again with mpdt-train bundle"


def is_bundle(folder: Path) -> bool:
    """Whether something there means to be a bundle: its names, or its format."""
    if (folder / MODEL).exists():
        return True
    path = folder / CONFIG
    return path.is_file() and b'"mpdt-policy/' in _first_bytes(path)


def read_config(folder: Path) -> BundleConfig:
    """config.json alone. Raises: MissingFileError; FormatError."""
    path = folder / CONFIG
    if not path.is_file():
        raise MissingFileError("no bundle here", where=str(folder), expected=CONFIG,
                               hint="`mpdt-train bundle RUN -o DIR` writes one")  # fmt: skip
    content = _bytes(path, None)
    try:
        plain = decode_json(content)
    except ValueError as error:
        raise FormatError("not JSON", where=str(path), found=str(error), hint=_ANOTHER) from error
    if not isinstance(plain, dict):
        raise FormatError("not a JSON object", where=str(path), found=type(plain).__name__,
                          hint=_ANOTHER)  # fmt: skip
    if plain.get("format") != FORMAT:
        raise FormatError("a bundle of another version, or none", where=str(path),
                          expected=FORMAT, found=str(plain.get("format"))[:40],
                          hint="install the version of mpdt that wrote it")  # fmt: skip
    sealed = plain.pop("seal", None)
    if sealed != seal(plain):
        raise FormatError("not what was written", where=str(path), expected=f"seal {seal(plain)}",
                          found=str(sealed)[:64], hint=_ANOTHER)  # fmt: skip
    try:
        config = msgspec.convert(plain, BundleConfig)
        _check(config)
    except (msgspec.ValidationError, MpdtError, ValueError) as error:
        raise FormatError("not a bundle's configuration", where=str(path), found=str(error),
                          hint=_ANOTHER) from error  # fmt: skip
    return config


def read_contents(folder: Path) -> Contents:
    """Facts and tensors, every byte proved; whether they fit each other `read_bundle` says.

    Raises: as `read_bundle`.
    """
    config = read_config(folder)
    _bytes(folder / CARD, config.files[CARD])
    path = folder / MODEL
    written = _bytes(path, config.files[MODEL])
    try:
        tensors = load(written)
    except (SafetensorError, ValueError, KeyError) as error:
        raise FormatError("not a safetensors file", where=str(path), found=str(error),
                          hint=_ANOTHER) from error  # fmt: skip
    for name, tensor in tensors.items():
        if not tensor.is_floating_point() or not bool(tensor.isfinite().all()):
            raise FormatError(f"tensor '{name}' holds what is no number", where=str(path),
                              hint=_ANOTHER)  # fmt: skip
    return Contents(config, tensors)


def read_bundle(folder: Path) -> Bundle:
    """All of it, or nothing.

    Raises: MissingFileError for a file that is not there; FormatError for what was changed,
        does not fit together or is of another version; UsageError for a family that is not known
        here; BackboneError where blocks are read by name and are others.
    """
    contents = read_contents(folder)
    family = _family(contents.config, folder)
    try:
        return built(contents, family)
    except BackboneError:
        raise
    except MpdtError as error:
        raise FormatError("the tensors do not fit the configuration", where=str(folder / MODEL),
                          found=str(error), hint=_ANOTHER) from error  # fmt: skip


def _first_bytes(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4096)


def _bytes(path: Path, stated: FileFacts | None) -> bytes:
    """A whole file of the stated size and digest, read once. Raises: as `read_bundle`."""
    if not path.is_file():
        raise MissingFileError("a file of this bundle is missing", where=str(path), hint=_ANOTHER)
    size = path.stat().st_size
    most = MOST_CONFIG_BYTES if stated is None else stated.size
    if size > most or (stated is not None and size != most):
        raise FormatError("not the size it was written with", where=str(path),
                          expected=f"{most:,} bytes", found=f"{size:,}",
                          hint=_ANOTHER)  # fmt: skip
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FormatError("unreadable", where=str(path), found=str(error)) from error
    found = hashlib.sha256(content).hexdigest()
    if stated is not None and found != stated.sha256:
        raise FormatError("not what was written", where=str(path), found=f"SHA-256 {found}",
                          expected=stated.sha256, hint=_ANOTHER)  # fmt: skip
    return content


def _check(config: BundleConfig) -> None:
    """Figures that the types cannot hold to each other. Raises: ValueError."""
    names = {task.name for task in config.tasks}
    observed = {len(config.statistics.mean), len(config.statistics.std)}
    if set(config.files) != {MODEL, CARD}:
        raise ValueError(f"files {sorted(config.files)}, expected {MODEL} and {CARD}")
    if observed != {config.family.observation_size}:
        raise ValueError("statistics of another size than the observations")
    if not _finite(*config.statistics.mean, *config.statistics.std):
        raise ValueError("statistics that are no numbers")
    if not 1 <= config.window <= MOST_WINDOW:
        raise ValueError(f"window {config.window}, expected 1 to {MOST_WINDOW}")
    if not (1 <= config.family.action_size <= MOST_WINDOW and names):
        raise ValueError("no actions, or no tasks")
    if not 0 <= config.inputs.time_table <= MOST_POSITIONS:
        raise ValueError(f"time_table {config.inputs.time_table}")
    shape = config.backbone.shape
    if shape is None and config.backbone.trained != "none":
        raise ValueError("a trained language model was left out")
    if shape is not None:
        sizes = [getattr(shape, field) for field in shape.__struct_fields__]
        if not all(1 <= size <= MOST_POSITIONS for size in sizes if type(size) is int):
            raise ValueError("a language model of an impossible size")
        if shape.num_attention_heads % shape.num_key_value_heads:
            raise ValueError("heads that do not divide")
        floats = (shape.epsilon, shape.angle_scaling, *shape.scaling)
        if not (_finite(*floats) and shape.epsilon > 0):
            raise ValueError("a language model with figures that are none")
    labels = [one.name for one in config.prompts]
    if not labels or len(set(labels)) != len(labels):
        raise ValueError("no prompts, or two sets of one name")
    for one in config.prompts:
        if not one.tasks or len(set(one.tasks)) != len(one.tasks) or not set(one.tasks) <= names:
            raise ValueError(f"prompts {one.name} of tasks that are not there")
        columns = [getattr(one.returns, field) for field in Returns.__struct_fields__]
        if any(len(column) != len(one.tasks) for column in columns):
            raise ValueError(f"prompts {one.name}: one return per task")
        if not _finite(*(number for column in columns for number in column)):
            raise ValueError(f"prompts {one.name}: a return that is no number")
        table_of(one.returns)


def _finite(*numbers: float) -> bool:
    """As float32, in which they are used."""
    return all(abs(number) <= MOST_NUMBER for number in numbers)


def _family(config: BundleConfig, folder: Path) -> Family:
    try:
        family = get_family(config.family.name)
    except UsageError as error:
        raise UsageError(
            f"this policy is for a family that is not known here: {error.what}",
            where=str(folder),
            hint="make the family known before its policies are loaded, or install the version "
            "of mpdt that has it",
        ) from error
    if FamilyFacts.of(family) != config.family:
        raise FormatError("this policy is for another family of that name", where=str(folder),
                          expected=str(FamilyFacts.of(family)),
                          found=str(config.family))  # fmt: skip
    for task in config.tasks:
        family.task(task.name)
    return family
