"""Settings outside their range are refused where they are made, with both sides named."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mpdt.errors import UsageError
from mpdt.model.backbone import BackboneSettings
from mpdt.model.policy import HeadSettings
from mpdt.model.prompts import PromptSettings
from mpdt.model.tokens import InputSettings

REFUSED: list[tuple[type, str, Any, str]] = [
    (PromptSettings, "prompts.length", 0, "at least 1"),
    (PromptSettings, "prompts.rank", 0, "at least 1"),
    (PromptSettings, "prompts.init_std", 0.0, "above 0"),
    (PromptSettings, "prompts.init_std", math.inf, "above 0"),
    (PromptSettings, "prompts.task_noise", -0.1, "at least 0"),
    (InputSettings, "inputs.time_table", -1, "at least 0"),
    (InputSettings, "inputs.return_dropout", -0.1, "at least 0 and below 1"),
    (InputSettings, "inputs.return_dropout", 1.0, "at least 0 and below 1"),
    (InputSettings, "inputs.return_dropout", math.nan, "at least 0 and below 1"),
    (InputSettings, "inputs.scale", 0.0, "above 0"),
    (InputSettings, "inputs.observation_clip", -1.0, "at least 0"),
    (InputSettings, "inputs.observation_clip", math.nan, "at least 0"),
    (HeadSettings, "head.hidden", -1, "at least 0"),
    (BackboneSettings, "backbone.depth", 0, "at least 1"),
]


@pytest.mark.parametrize(("kind", "where", "value", "expected"), REFUSED)
def test_out_of_range(kind: type, where: str, value: Any, expected: str) -> None:
    with pytest.raises(UsageError) as caught:
        kind(**{where.partition(".")[2]: value})
    error = caught.value
    assert (error.where, error.expected, error.found) == (where, expected, str(value))


def test_the_edges_are_inside() -> None:
    assert PromptSettings(length=1, rank=1, init_std=1e-9, task_noise=0.0).length == 1
    assert InputSettings(time_table=0, scale=0.1, observation_clip=0.0).time_table == 0
    assert InputSettings(return_dropout=0.99).return_dropout == 0.99
    assert HeadSettings(hidden=0).hidden == 0
    assert BackboneSettings(depth=1).depth == 1
