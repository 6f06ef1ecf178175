"""Hashes: of one episode, and of a header with all its episodes.

    digest        SHA-256 over the arrays (name, dtype, shape, C-order bytes each), then
                  task name, goal, quality, progress, policy hash, seed key
    content hash  SHA-256 over the header's canonical JSON, then all digests in order

Name, version, slices, stats, packages and TTA sets are outside the content hash.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpdt.data.episode import Episode
from mpdt.data.spec.entry import canonical_json
from mpdt.data.store.layout import FORMAT, STEPS


def episode_digest(episode: Episode, task_name: str) -> bytes:
    """32 bytes that change with any bit of the episode.

    The policy counts by its hash, the task by its name; file-dependent row numbers do not.
    """
    parts: list[tuple[str, str, Any]] = [
        ("observations", "<f4", episode.observations),
        ("actions", "<f4", episode.actions),
        ("rewards", "<f4", episode.rewards),
        ("terminations", "|b1", episode.terminations),
        ("truncations", "|b1", episode.truncations),
    ]
    if episode.successes is not None:
        parts.append(("successes", "|b1", episode.successes))
    parts += [
        ("task", "|u1", np.frombuffer(task_name.encode("utf-8"), np.uint8)),
        ("goal", "<f8", episode.goal),
        ("quality", "|i1", episode.quality),
        ("progress", "<f4", episode.progress),
        ("policy", "|u1", np.frombuffer(episode.policy, np.uint8)),
        ("seed_key", "<u4", episode.seed_key),
    ]
    state = hashlib.sha256()
    for name, dtype, value in parts:
        array = np.ascontiguousarray(value, dtype=dtype).reshape(np.shape(value))
        shape = ",".join(map(str, array.shape))
        # The zero bytes keep name, dtype and shape apart, whatever the values are.
        state.update(f"{name}\0{dtype}\0{shape}\0".encode())
        state.update(array.data if array.ndim else array.tobytes())  # no copy of what is long
    return state.digest()


def content_header(
    family: str,
    tasks: Sequence[str],
    observation_size: int,
    action_size: int,
    has_success: bool,
) -> dict[str, Any]:
    """What the content hash knows of a file beside its episodes."""
    fields = [c.path for c in STEPS if not c.optional or has_success]
    return {
        "format": FORMAT, "family": family, "tasks": list(tasks),
        "observation_size": observation_size, "action_size": action_size,
        "fields": fields,
    }  # fmt: skip


def content_hash(header: Mapping[str, Any], digests: NDArray[np.uint8] | Iterable[bytes]) -> str:
    """64 hex digits; `digests` is (E, 32) u1 or the 32-byte digests in canonical order."""
    state = hashlib.sha256(canonical_json(dict(header)))
    if isinstance(digests, np.ndarray):
        state.update(np.ascontiguousarray(digests, dtype=np.uint8).data)
    else:
        for digest in digests:
            state.update(digest)
    return state.hexdigest()
