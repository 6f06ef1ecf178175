"""Distillation losses by hand, and a teacher that does not move."""

import math

import pytest
import torch

from mpdt.errors import UsageError
from mpdt.model.policy import PolicyBatch, PolicyOutput
from mpdt.model.prompts import PromptSettings, TeacherPrompts
from mpdt.train.fit.data import load_material
from mpdt.train.fit.teacher import Teacher, TeacherSettings, missed_variance
from mpdt.train.run.presets import smoke


def test_missed_variance_by_hand():
    target = torch.tensor([[0.0], [2.0]])  # mean 1, variance 1
    assert missed_variance(torch.tensor([[0.0], [1.0]]), target).item() == 0.5
    assert missed_variance(target, target).item() == 0.0
    assert missed_variance(torch.ones(2, 1), target).item() == 1.0


def test_missed_variance_has_no_unit():
    """A thousand times the features: the same share."""
    generator = torch.Generator().manual_seed(0)
    own, target = torch.randn(2, 5, 3, generator=generator)
    scaled = missed_variance(1000 * own, 1000 * target)
    torch.testing.assert_close(scaled, missed_variance(own, target))


def test_prompt_target_by_hand():
    """P = 3 everywhere, teacher 2 everywhere: (3 - 2)^2 / 2^2 = 0.25."""
    prompts = TeacherPrompts(PromptSettings(length=2), 3, 4, spread=1.0)
    prompts.prompts.data.fill_(2.0)
    settings = TeacherSettings(distillation="prompt")

    class NoPolicy(torch.nn.Module):
        backbone = type("Frozen", (), {"frozen": True})()

    teacher = Teacher(NoPolicy(), prompts, settings)
    nothing = torch.zeros(())
    loss = teacher.loss(nothing, torch.tensor([0, 2]), torch.full((2, 2, 4), 3.0), nothing, nothing)
    assert loss.item() == 0.25 and not teacher.needs_features


def test_equal_policies_have_no_mpt_loss_and_the_teacher_stays_as_it_was(tiny_file):
    config, material = smoke(), load_material(str(tiny_file), "expert")
    from mpdt.model.backbone import load_backbone
    from mpdt.model.policy import PromptPolicy
    from mpdt.train.fit.data import return_table

    backbone = load_backbone("random:tiny", dtype="float32")
    stats = material.dataset.stats["observations"]
    policy = PromptPolicy(backbone, config.inputs, config.head, stats["mean"], stats["std"], 6)
    prompts = TeacherPrompts(config.prompts, 2, backbone.width, 1.0)
    teacher = Teacher(policy, prompts, TeacherSettings())
    assert teacher.needs_features
    windows = material.sampler(config.sampler, 1).batch(0)
    batch, slots = PolicyBatch.from_windows(windows), torch.from_numpy(windows.slots)
    returns = return_table(material, "task", 0.9)

    def loss(teacher=teacher, away=0.0):
        own = prompts.task_prompts(slots) + away
        output: PolicyOutput = policy(batch, own, returns, layer_features=True)
        return teacher.loss(batch, slots, own, output, returns)

    assert loss().item() == 0.0
    actions, once, thrice = (
        loss(Teacher(policy, prompts, TeacherSettings(hidden_weight=weight)), away=100.0).item()
        for weight in (0.0, 0.1, 0.3)
    )
    assert once > actions > 0.0 and thrice - actions == pytest.approx(
        3 * (once - actions), rel=1e-3, abs=0
    )
    with torch.no_grad():
        for parameter in policy.head.parameters():
            parameter.add_(0.1)
    assert loss().item() > 0.0, "the teacher moved along with the student's head"


@pytest.mark.parametrize("wrong", [-1, math.nan, math.inf])
@pytest.mark.parametrize("name", ["weight", "hidden_weight", "steps"])
def test_settings_out_of_range(name, wrong):
    with pytest.raises(UsageError, match=f"teacher.{name}: setting out of range"):
        TeacherSettings(**{name: wrong})


def test_a_target_without_variance_does_not_divide_by_zero():
    assert missed_variance(torch.ones(3, 2), torch.ones(3, 2)).item() == 0.0
    assert missed_variance(torch.zeros(3, 2), torch.ones(3, 2)).isfinite()
