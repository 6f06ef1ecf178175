"""Settings that cannot work together are refused before training, by name."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from mpdt.data.slices.sampler import SamplerSettings
from mpdt.errors import UsageError
from mpdt.model.prompts import PromptSettings
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt import AdaptSettings
from mpdt.train.config import TrainConfig
from mpdt.train.evaluate import EvaluationSettings
from mpdt.train.fit_check import check_fits


@dataclass(frozen=True)
class Shape:
    name: str = "small"
    num_layers: int = 2
    max_positions: int = 32


FITS = TrainConfig(
    inputs=InputSettings(time_table=10, tokens_per_step=3),
    prompts=PromptSettings(length=2),
    sampler=SamplerSettings(window=10),
    adapt=AdaptSettings(layers=(0, 1)),
    evaluation=EvaluationSettings(horizon=10),
)


def test_settings_at_every_limit_fit() -> None:
    """2 + 3 * 10 = 32 positions, 10 steps for 10 rows, blocks 0 and 1 of 2."""
    check_fits(Shape(), FITS, 10)


def refused(shape: Shape, horizon: int) -> UsageError:
    with pytest.raises(UsageError) as caught:
        check_fits(shape, FITS, horizon)
    assert caught.value.expected and caught.value.found and caught.value.hint
    return caught.value


def test_time_table_must_hold_the_episodes() -> None:
    error = refused(Shape(), 11)
    assert error.where == "inputs.time_table" and "11" in error.expected


def test_time_table_must_hold_a_longer_evaluation() -> None:
    longer = TrainConfig(inputs=InputSettings(time_table=9), evaluation=FITS.evaluation)
    with pytest.raises(UsageError, match=r"inputs\.time_table"):
        check_fits(Shape(max_positions=1000), longer, 5)


def test_without_a_time_table_any_horizon_fits() -> None:
    check_fits(Shape(max_positions=50), TrainConfig(inputs=InputSettings(time_table=0)), 10**6)


def test_prompt_and_window_must_fit_the_language_model() -> None:
    error = refused(Shape(max_positions=31), 10)
    assert "prompts.length" in error.where and error.found == "2 + 30"


def test_adapted_layers_must_exist() -> None:
    error = refused(Shape(num_layers=1), 10)
    assert (error.where, error.expected, error.found) == ("adapt.layers", "0 to 0", "0 1")
