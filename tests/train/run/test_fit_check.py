"""Settings that cannot work together are refused before training, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import msgspec
import pytest

from mpdt.data.slices.sampler import SamplerSettings
from mpdt.errors import UsageError
from mpdt.model.prompts import PromptSettings
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt.align import AdaptSettings
from mpdt.train.evaluate.rollout import EvaluationSettings
from mpdt.train.fit.teacher import TeacherSettings
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.fit_check import check_fits

PromptKind = Literal["shared", "none", "demonstration", "hyper"]
NO_TEACHER = TeacherSettings(distillation="none")


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


@pytest.mark.parametrize(
    ("kind", "positions"),
    [("shared", 2), ("none", 0), ("demonstration", 3 * 2), ("hyper", 0)],
)
def test_prompts_of_other_kinds_take_other_room(kind: PromptKind, positions: int) -> None:
    """Two steps of three tokens each; adapters and nothing take no room."""
    config = msgspec.structs.replace(
        FITS, prompts=PromptSettings(kind=kind, length=2), teacher=NO_TEACHER
    )
    check_fits(Shape(max_positions=positions + 30), config, 10)
    with pytest.raises(UsageError) as caught:
        check_fits(Shape(max_positions=positions + 29), config, 10)
    assert caught.value.found == f"{positions} + 30"


def test_a_teacher_has_a_soft_prompt_whatever_its_student_has() -> None:
    config = msgspec.structs.replace(FITS, prompts=PromptSettings(kind="none", length=2))
    with pytest.raises(UsageError, match=r"found 2 \+ 30"):
        check_fits(Shape(max_positions=31), config, 10)


@pytest.mark.parametrize(
    ("kind", "distillation"), [("hyper", "mpt"), ("demonstration", "prompt"), ("none", "prompt")]
)
def test_a_teacher_must_be_able_to_teach(
    kind: PromptKind, distillation: Literal["mpt", "prompt"]
) -> None:
    config = msgspec.structs.replace(
        FITS, prompts=PromptSettings(kind=kind), teacher=TeacherSettings(distillation=distillation)
    )
    with pytest.raises(UsageError, match=rf"teacher\.distillation: .* found {kind}"):
        check_fits(Shape(max_positions=1000), config, 10)


def test_adapted_layers_must_exist() -> None:
    error = refused(Shape(num_layers=1), 10)
    assert (error.where, error.expected, error.found) == ("adapt.layers", "0 to 0", "0 1")
