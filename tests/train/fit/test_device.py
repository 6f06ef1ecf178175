"""Devices and arithmetic: equal to the plain path on the processor; nothing left behind."""

import dataclasses
from types import SimpleNamespace

import msgspec
import pytest
import torch

from mpdt.errors import UsageError
from mpdt.model.backbone import load_backbone
from mpdt.model.policy import PolicyBatch, PromptPolicy, action_loss
from mpdt.model.prompts import DecomposedPrompts, TeacherPrompts
from mpdt.seeding import phase_seed
from mpdt.train.fit.checkpoint import Subject
from mpdt.train.fit.data import load_material, return_table
from mpdt.train.fit.device import PROCESSOR, Hardware, HardwareSettings
from mpdt.train.fit.loop import OptimiserSettings, Update, fit, make_optimizer
from mpdt.train.fit.teacher import Teacher, TeacherSettings
from mpdt.train.run.presets import smoke

CONFIG = smoke()
OPTIMISER = OptimiserSettings(warmup_steps=3)


@pytest.fixture(scope="module")
def material(tiny_file):
    return load_material(str(tiny_file), "expert")


def losses(material, hardware, steps=4, dtype="float32"):
    """Losses of some updates with a teacher, and the subject they trained."""
    backbone = load_backbone("random:tiny", dtype=dtype)
    stats = material.dataset.stats["observations"]
    policy = PromptPolicy(backbone, CONFIG.inputs, CONFIG.head, stats["mean"], stats["std"], 6)
    prompts = DecomposedPrompts(CONFIG.prompts, 2, backbone.width, 0.2, seed=1)
    subject = Subject(policy, prompts, make_optimizer(policy, prompts, OPTIMISER))
    teacher = Teacher(policy, TeacherPrompts(CONFIG.prompts, 2, backbone.width, 0.2),
                      TeacherSettings())  # fmt: skip
    found = []
    with hardware.working(backbone, subject.optimizer, policy, prompts, teacher):
        windows, returns = sampler(material), return_table(material, "task", 0.9)
        update = Update(policy, prompts, returns, windows.seed, teacher, hardware=hardware)
        fit(update, windows, subject.optimizer, OPTIMISER, range(steps),
            lambda done, parts: found.append(parts["loss"]) or False)  # fmt: skip
    return found, subject


def sampler(material):
    return material.sampler(CONFIG.sampler, phase_seed(CONFIG.seed, "student"))


@pytest.fixture(scope="module")
def plain(material):
    return losses(material, PROCESSOR)[0]


@pytest.mark.parametrize("kind", ["bfloat16", "float16"])
def test_autocast_is_close_to_float32(material, plain, kind):
    """Eight or eleven bits of mantissa: a relative error near 2^-8, and not zero."""
    found, subject = losses(material, Hardware(HardwareSettings(autocast=kind)))
    assert found == pytest.approx(plain, rel=0.03) and found != plain
    assert all(p.dtype == torch.float32 for p in subject.prompts.parameters())


@pytest.mark.gpu
@pytest.mark.parametrize(("autocast", "near"), [("none", 1e-3), ("bfloat16", 0.03)])
def test_updates_on_an_accelerator_are_close_to_the_processors(material, plain, autocast, near):
    hardware = Hardware(HardwareSettings(device="cuda", autocast=autocast))
    found, subject = losses(material, hardware)
    assert found == pytest.approx(plain, rel=near)
    kept = [*subject.policy.parameters(), *subject.prompts.parameters()]
    assert {p.device.type for p in kept} == {"cpu"}, "afterwards everything is back"


@pytest.mark.slow  # ten seconds of tracing
@pytest.mark.filterwarnings("ignore:The .grad attribute")  # torch's tracer looks everywhere
def test_compiled_blocks_give_the_same_losses(material, plain):
    hardware = Hardware(HardwareSettings(compile="eager"))
    found, subject = losses(material, hardware, steps=2)
    assert found == pytest.approx(plain[:2], rel=1e-5)
    assert subject.policy.backbone.blocks()[0]._compiled_call_impl is None


def test_blocks_are_compiled_while_they_work_and_no_longer():
    backbone = load_backbone("random:tiny", dtype="float32")
    (block, *_), module = backbone.blocks(), torch.nn.Linear(2, 2)
    optimizer = torch.optim.SGD(module.parameters())
    with Hardware(HardwareSettings(compile="eager")).working(backbone, optimizer, module):
        assert block._compiled_call_impl is not None
    assert block._compiled_call_impl is None


def test_an_overflow_of_float16_is_skipped_and_the_scale_halved(material):
    hardware = Hardware(HardwareSettings(autocast="float16"))
    hardware.scaler = torch.amp.GradScaler("cpu", init_scale=2.0**40)
    _, subject = losses(material, hardware, steps=1)
    untouched = DecomposedPrompts(CONFIG.prompts, 2, subject.policy.backbone.width, 0.2, seed=1)
    assert torch.equal(subject.prompts.cross, untouched.cross)
    assert hardware.scaler.get_scale() == 2.0**39


def test_a_missing_device_is_refused():
    if torch.cuda.is_available():
        pytest.skip("this machine has one")
    with pytest.raises(UsageError, match=r"hardware\.device.*found cuda"):
        Hardware(HardwareSettings(device="cuda"))


@pytest.mark.parametrize("dropout", [0.0, 0.5])
def test_nothing_of_an_update_stays_on_the_processor(material, dropout):
    """Tensors with a device and no values: whatever mixes two devices raises."""
    backbone = load_backbone("random:tiny", dtype="float32")
    stats = material.dataset.stats["observations"]
    inputs = msgspec.structs.replace(CONFIG.inputs, return_dropout=dropout, return_to_go="task")
    policy = PromptPolicy(backbone, inputs, CONFIG.head, stats["mean"], stats["std"], 6)
    prompts = DecomposedPrompts(CONFIG.prompts, 2, backbone.width, 0.2, seed=1)
    table = return_table(material, "task", 0.9)
    batch = PolicyBatch.from_windows(sampler(material).batch(0))

    def moved(table):
        found = type(table).__new__(type(table))  # checks would look at values
        for field in dataclasses.fields(table):
            object.__setattr__(found, field.name, getattr(table, field.name).to("meta"))
        return found

    policy.to("meta"), prompts.to("meta")
    policy.inputs._check_timesteps = lambda timesteps: None  # as would this one
    there = moved(batch)
    output = policy(there, prompts.task_prompts(), moved(table),
                    generator=torch.Generator().manual_seed(0), layer_features=True)  # fmt: skip
    action_loss(output.actions, there.actions, there.mask).backward()
    assert prompts.cross.grad.device.type == "meta"


def test_only_an_overflow_of_float16_may_be_tried_again():
    finite, infinite = torch.tensor(1.0), torch.tensor(torch.inf)
    scaled = Hardware(HardwareSettings(autocast="float16"))
    assert scaled.accepts(finite) and not scaled.accepts(infinite)
    assert PROCESSOR.accepts(infinite), "told as a loss that is no number"


def test_a_backend_without_a_compiler_is_refused_first(monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(UsageError, match="no C\\+\\+ compiler") as caught:
        Hardware(HardwareSettings(compile="inductor"))
    assert "--hardware.compile none" in caught.value.hint
    Hardware(HardwareSettings(compile="eager"))


def test_a_backend_that_fails_is_one_error():
    class FailedError(RuntimeError):
        __module__ = "torch._inductor.exc"

    module = torch.nn.Linear(2, 2)
    optimizer = torch.optim.AdamW(module.parameters())
    backbone = SimpleNamespace(blocks=lambda: [module])
    hardware = Hardware(HardwareSettings(compile="eager"))
    told = "CppCompileError: boom\n" + "line\n" * 150
    failing = pytest.raises(UsageError, match="cannot be compiled here")
    with failing as caught, hardware.working(backbone, optimizer, module):
        raise FailedError(told)
    assert caught.value.found == "CppCompileError: boom"
    with pytest.raises(RuntimeError, match="ours"), hardware.working(backbone, optimizer, module):
        raise RuntimeError("ours")
