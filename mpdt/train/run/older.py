"""Runs from before `--backbone.name auto` was given up: their folders keep the word.

It stood for GPT-2 where that could be reached, and for the shipped model elsewhere, so two
machines made different runs of the same settings. Now it is only another name of the shipped
model. What a run is called by is part of its identity: the folder's own word goes on counting,
and its results say what was really loaded.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import msgspec

from mpdt.errors import FormatError, MissingFileError
from mpdt.model.language import ONCE_AUTO, SHIPPED
from mpdt.train.run.folder import RunFolder, stored_settings
from mpdt.train.run.prepare import Prepared
from mpdt.train.run.results import read_results


def as_stored(prepared: Prepared, folder: RunFolder) -> Prepared:
    """The same run under the folder's word for its language model, loading what it stood for.

    Raises: FormatError, TrainingError for a folder whose files are damaged.
    """
    if not folder.config.exists():
        return prepared
    word = stored_settings(folder.path).backbone.name
    if not {word, prepared.config.backbone.name} <= {ONCE_AUTO, SHIPPED}:
        return prepared
    meant = SHIPPED
    if word == ONCE_AUTO:
        # Without results that can be read it is the shipped one; weights of another refuse it.
        with suppress(MissingFileError, FormatError):
            meant = str(read_results(folder.path)["backbone"].get("name", SHIPPED))
    config = msgspec.structs.replace(
        prepared.config, backbone=msgspec.structs.replace(prepared.config.backbone, name=meant)
    )
    identity = replace(prepared.identity, training=_called(prepared.identity.training, word))
    return replace(prepared, config=config, plain=_called(prepared.plain, word), identity=identity)


def called_once(plain: dict[str, Any]) -> dict[str, Any]:
    """Settings under the word that results on record have for the shipped model."""
    return _called(plain, ONCE_AUTO) if plain["backbone"]["name"] == SHIPPED else plain


def _called(plain: dict[str, Any], word: str) -> dict[str, Any]:
    return {**plain, "backbone": {**plain["backbone"], "name": word}}
