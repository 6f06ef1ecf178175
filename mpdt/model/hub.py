"""Models by hub id: from the local cache, else from the host, if it answers.

    folder on disk          read as it is
    whole in the cache      read, the network is not asked
    otherwise               one request; no answer within seconds is an error at once

The hub's own client retries for half a minute and writes a page; here one line says what to do.
"""

from __future__ import annotations

import contextlib
import logging
import re
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import msgspec

from mpdt.errors import BackboneError, nearest

_log = logging.getLogger(__name__)

_PROBE_S = 3.0
_HUB_ID = re.compile(r"\w[\w.-]*(/\w[\w.-]*)?")
_WEIGHTS, _INDEX = "model.safetensors", "model.safetensors.index.json"


class _Index(msgspec.Struct):
    weight_map: dict[str, str]


class UnreachableError(BackboneError):
    """Neither cached nor to be had from the host just now; another model may do."""


def local_folder(name: str, known: list[str]) -> Path | None:
    """The folder that holds everything on this machine; None: the host has it, or may have.

    Args:
        known: names to suggest where `name` is none.
    Raises: BackboneError for what can be neither a folder nor a hub id; UnreachableError.
    """
    if Path(name).is_dir():
        return Path(name)
    if not _HUB_ID.fullmatch(name):
        raise BackboneError(
            "no such folder", where=name, expected="a folder, a hub id or a known name",
            hint=f"known: {', '.join(known)}",
        )  # fmt: skip
    folder = _cached(name)
    if folder is not None:
        return folder
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        raise unreachable(name, "offline mode (HF_HUB_OFFLINE)", known)
    if not _answers(f"{constants.ENDPOINT}/{name}/resolve/main/config.json"):
        raise unreachable(name, f"no answer from {constants.ENDPOINT}", known)
    _log.warning("downloading %s from %s", name, constants.ENDPOINT)
    return None


def unreachable(name: str, found: str, known: list[str]) -> UnreachableError:
    """The error for a hub id that cannot be downloaded, and all the ways around it."""
    guess = "" if "/" in name or name in known else nearest(name, known)
    return UnreachableError(
        f"this language model is not in the local cache and cannot be downloaded {guess}".strip(),
        where=name,
        found=found,
        hint=f"download it once where there is network (hf download {name}) and point HF_HOME at "
        "that cache, or give a local folder, or take smollm2-135m, which needs no network",
    )


def _cached(name: str) -> Path | None:
    """Where configuration and all weights lie; a download broken off half-way is not all."""
    from huggingface_hub import try_to_load_from_cache

    def path(file: str) -> Path | None:
        found = try_to_load_from_cache(name, file)
        return Path(found) if isinstance(found, str) else None

    config, index = path("config.json"), path(_INDEX)
    if config is None:
        return None
    whole = path(_WEIGHTS) is not None
    if not whole and index is not None:
        whole = all(path(shard) is not None for shard in _shards(index))
    return config.parent if whole else None


def _shards(index: Path) -> set[str]:
    """The files an index names. Raises: BackboneError for what is none."""
    try:
        read = msgspec.json.decode(index.read_bytes(), type=_Index)
    except (OSError, msgspec.MsgspecError, RecursionError) as error:
        raise BackboneError("not an index of weights", where=str(index), found=str(error),
                            hint="download the model again") from error  # fmt: skip
    return set(read.weight_map.values())


def _answers(url: str) -> bool:
    """One request. A refusal is an answer: what is missing, the hub's client knows better."""
    try:
        request = urllib.request.Request(url, method="HEAD")
        with urllib.request.urlopen(request, timeout=_PROBE_S):
            return True
    except urllib.error.HTTPError as error:
        return error.code < 500
    except (OSError, ValueError) as error:
        _log.debug("%s does not answer: %s", url, error)
        return False


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """No progress bars, no report of the blocks left out on purpose, no lines about retries."""
    from huggingface_hub.utils import logging as hub_talk
    from transformers.utils import logging as talk

    levels, bars = (talk.get_verbosity(), hub_talk.get_verbosity()), talk.is_progress_bar_enabled()
    # What goes wrong arrives as an exception and is told once.
    talk.set_verbosity(logging.CRITICAL)
    hub_talk.set_verbosity(logging.CRITICAL)
    talk.disable_progress_bar()
    try:
        yield
    finally:
        talk.set_verbosity(levels[0])
        hub_talk.set_verbosity(levels[1])
        if bars:
            talk.enable_progress_bar()
