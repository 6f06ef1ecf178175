"""The loop: rates by hand, what moves, what stops it, and stop-and-resume to the byte."""

import math

import pytest
import torch

from mpdt.errors import FormatError, TrainingError, UsageError
from mpdt.model.backbone import load_backbone
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import DecomposedPrompts, TeacherPrompts
from mpdt.train.fit.checkpoint import Checkpoint, Subject
from mpdt.train.fit.data import load_material, return_table
from mpdt.train.fit.log import MetricsLog
from mpdt.train.fit.loop import (
    MultitaskSettings,
    OptimiserSettings,
    Update,
    fit,
    make_optimizer,
    rate_factor,
)
from mpdt.train.fit.teacher import Teacher, TeacherSettings
from mpdt.train.run.presets import smoke

CONFIG = smoke()
OPTIMISER = OptimiserSettings(warmup_steps=3)


@pytest.fixture(scope="module")
def backbone():
    return load_backbone("random:tiny", dtype="float32")


@pytest.fixture(scope="module")
def material(tiny_file):
    return load_material(str(tiny_file), "expert")


def make_subject(material, backbone, kind=DecomposedPrompts, optimiser=OPTIMISER):
    stats = material.dataset.stats["observations"]
    policy = PromptPolicy(backbone, CONFIG.inputs, CONFIG.head, stats["mean"], stats["std"], 6)
    prompts = kind(CONFIG.prompts, 2, backbone.width, 0.2, seed=1)
    return Subject(policy, prompts, make_optimizer(policy, prompts, optimiser))


def train(material, subject, first, last, on_step=lambda done, parts: False, **options):
    sampler = material.sampler(CONFIG.sampler, 1)
    returns = return_table(material, "task", 0.9)
    update = Update(subject.policy, subject.prompts, returns, sampler.seed, **options)
    return fit(update, sampler, subject.optimizer, OPTIMISER, range(first, last), on_step)


def test_rates_by_hand():
    """Warm-up over 4: 1/4, 2/4, 3/4, 1, 1. Cosine of 8: half way at step 4, cos(pi/2) = 0."""
    plain = OptimiserSettings(warmup_steps=4)
    assert [rate_factor(plain, step, 8) for step in range(5)] == [0.25, 0.5, 0.75, 1.0, 1.0]
    falling = OptimiserSettings(warmup_steps=0, schedule="cosine")
    assert rate_factor(falling, 0, 8) == 1.0
    assert math.isclose(rate_factor(falling, 4, 8), 0.5)


def test_each_part_has_its_rate(material, backbone):
    rates = OptimiserSettings(lr=1.0, lr_cross=2.0, lr_task=3.0, lr_teacher=4.0)
    student = make_subject(material, backbone, optimiser=rates)
    names = dict(student.prompts.named_parameters())
    found = {id(p): group["base_lr"] for group in student.optimizer.param_groups
             for p in group["params"]}  # fmt: skip
    assert [found[id(names[name])] for name in ("cross", "task_v", "task_u")] == [2.0, 3.0, 3.0]
    assert {found[id(p)] for p in student.policy.head.parameters() if p.requires_grad} == {1.0}
    teacher = make_subject(material, backbone, TeacherPrompts, rates)
    assert teacher.optimizer.param_groups[-1]["base_lr"] == 4.0


def test_training_lowers_the_loss_and_leaves_the_backbone_alone(material, backbone):
    before = {name: value.clone() for name, value in backbone.state_dict().items()}
    losses = []
    subject = make_subject(material, backbone)
    train(material, subject, 0, 60, lambda done, parts: losses.append(parts["action_loss"]))
    assert sum(losses[-10:]) < 0.7 * sum(losses[:10])
    assert all(torch.equal(value, before[name]) for name, value in backbone.state_dict().items())


def test_a_teachers_prompt_learns_from_its_own_task_alone(material, backbone):
    """The gradient of prompt 0 must not depend on task 1's windows: task 1's is zero alone."""
    subject = make_subject(material, backbone, TeacherPrompts)
    from mpdt.model.policy import PolicyBatch, action_loss

    windows = material.sampler(CONFIG.sampler, 2).batch(0)
    batch = PolicyBatch.from_windows(windows)
    returns = return_table(material, "task", 0.9)
    output = subject.policy(batch, subject.prompts.task_prompts(), returns)
    loss = action_loss(output.actions[:1], batch.actions[:1], batch.mask[:1])
    (gradient,) = torch.autograd.grad(loss, [subject.prompts.prompts])
    assert gradient[0].abs().sum() > 0 and gradient[1].abs().sum() == 0


def test_on_step_may_end_it(material, backbone):
    assert train(material, make_subject(material, backbone), 0, 9, lambda done, _: done == 4) == 4


def test_nan_stops_with_step_and_windows(material, backbone):
    subject = make_subject(material, backbone)

    def spoil(done, _parts):
        if done == 2:
            with torch.no_grad():
                subject.prompts.cross[0, 0] = math.nan
        return False

    with pytest.raises(TrainingError, match=r"action_loss is nan at step 2; found tasks \[0, 1\]"):
        train(material, subject, 0, 5, spoil)


def test_stop_and_resume_gives_the_bytes_of_an_unbroken_run(material, backbone, tmp_path):
    """Losses and all numbers, AdamW's included; with a teacher and sub-sampled dropout streams."""
    prompts = TeacherPrompts(CONFIG.prompts, 2, backbone.width, 0.2)

    def make():
        subject = make_subject(material, backbone)
        return subject, {
            "teacher": Teacher(subject.policy, prompts, TeacherSettings()),
            "sparse": 0.01,
        }

    log = MetricsLog(tmp_path / "metrics.jsonl")
    whole, broken = [], []
    unbroken, options = make()
    train(material, unbroken, 0, 8, lambda done, parts: whole.append(parts), **options)

    subject, options = make()
    checkpoint = Checkpoint(tmp_path / "checkpoint", {"run": "x"}, log)
    train(material, subject, 0, 3, lambda done, parts: broken.append(parts), **options)
    checkpoint.save("student", 3, subject)
    # The loop may run on after a checkpoint and then be killed: none of it may count.
    train(material, subject, 3, 5, **options)
    fresh, options = make()
    assert checkpoint.resume("student", fresh) == 3
    train(material, fresh, 3, 8, lambda done, parts: broken.append(parts), **options)

    assert broken == whole
    ours, theirs = fresh.tensors(), unbroken.tensors()
    assert ours.keys() == theirs.keys() and any(name.startswith("optimizer.") for name in ours)
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)


def test_a_checkpoint_of_another_run_is_refused(material, backbone, tmp_path):
    subject, log = make_subject(material, backbone), MetricsLog(tmp_path / "m")
    Checkpoint(tmp_path / "c", {"run": "one"}, log).save("student", 0, subject)
    with pytest.raises(FormatError, match="trained on another run"):
        Checkpoint(tmp_path / "c", {"run": "two"}, log).resume("student", subject)


def test_resuming_cuts_the_log_and_another_phase_starts_at_zero(material, backbone, tmp_path):
    subject, log = make_subject(material, backbone), MetricsLog(tmp_path / "m")
    checkpoint = Checkpoint(tmp_path / "c", {"run": "one"}, log)
    log.append({"phase": "x", "step": 1})
    checkpoint.save("teacher", 5, subject)
    log.append({"phase": "x", "step": 2})
    assert checkpoint.resume("teacher", subject) == 5
    assert log.records() == [{"phase": "x", "step": 1}]
    assert checkpoint.resume("student", subject) == 0


@pytest.mark.parametrize("wrong", [{"lr": -1.0}, {"clip": math.nan}, {"warmup_steps": -1}])
def test_settings_out_of_range(wrong):
    with pytest.raises(UsageError, match=f"optimiser.{next(iter(wrong))}: setting out of range"):
        OptimiserSettings(**wrong)


@pytest.mark.parametrize("wrong", [{"sparse": math.nan}, {"sparse": math.inf}, {"log_every": 0}])
def test_settings_of_the_second_phase_out_of_range(wrong):
    with pytest.raises(UsageError, match=f"multitask.{next(iter(wrong))}: setting out of range"):
        MultitaskSettings(**wrong)


def test_the_loss_is_action_plus_weighted_distillation(material, backbone):
    subject, seen = make_subject(material, backbone), []
    prompts = TeacherPrompts(CONFIG.prompts, 2, backbone.width, 0.2)
    teacher = Teacher(subject.policy, prompts, TeacherSettings(distillation="prompt", weight=0.5))
    train(material, subject, 0, 1, lambda done, parts: seen.append(parts),
          teacher=teacher)  # fmt: skip
    parts = seen[0]
    assert parts["distillation_loss"] > 0
    assert math.isclose(
        parts["loss"], parts["action_loss"] + 0.5 * parts["distillation_loss"], rel_tol=1e-6
    )


def test_a_sparse_prompt_pays_for_its_task_parts(material, backbone):
    subject, seen = make_subject(material, backbone), []
    size = float(subject.prompts.task_parts().detach().abs().mean())
    train(material, subject, 0, 1, lambda done, parts: seen.append(parts), sparse=0.25)
    assert size > 0.01
    assert math.isclose(seen[0]["loss"], seen[0]["action_loss"] + 0.25 * size, rel_tol=1e-5)


def test_weights_decay_by_rate_and_share(material, backbone):
    """Without a gradient AdamW leaves p (1 - lr decay): 1 - 0.5 * 0.1 of every number."""
    rates = OptimiserSettings(lr=0.5, lr_cross=0.5, lr_task=0.5, weight_decay=0.1)
    subject = make_subject(material, backbone, optimiser=rates)
    before = [p.detach().clone() for p in subject.prompts.parameters()]
    for parameter in subject.prompts.parameters():
        parameter.grad = torch.zeros_like(parameter)
    subject.optimizer.step()
    for parameter, value in zip(subject.prompts.parameters(), before, strict=True):
        torch.testing.assert_close(parameter.detach(), 0.95 * value)
