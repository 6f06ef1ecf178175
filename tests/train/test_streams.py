"""Every stream of random numbers outside the episodes, pinned by what its user draws from it.

The numbers were drawn before the generators moved to `mpdt/seeding.py`. Another one here means
that old runs no longer repeat.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from mpdt.data.sim.locomotion import LocomotionBatch
from mpdt.data.sim.vector import LocomotionVector
from mpdt.data.slices.sampler import WindowSampler
from mpdt.data.spec.tasks import get_family
from mpdt.model.backbone import load_backbone
from mpdt.model.demonstrations import DemonstrationPrompts, HyperPrompts
from mpdt.model.lowrank import LowRank, add_low_rank
from mpdt.model.policy import HeadSettings, PromptPolicy
from mpdt.model.prompts import (
    AdaptedPrompts,
    DecomposedPrompts,
    MixedPrompts,
    PromptSettings,
    SharedPrompt,
    TaughtParts,
    TeacherPrompts,
)
from mpdt.model.tokens import InputSettings, word_rows
from mpdt.seeding import Beside, torch_generator_at
from mpdt.train.adapt import align
from mpdt.train.adapt.few_shot import choose_steps
from mpdt.train.fit import data

SEED = 5
WIDTH = 64


def drawn_by_prompts(kind: type[Any]) -> torch.Tensor:
    made = kind(PromptSettings(length=2, rank=3, init_std=1.0), 2, WIDTH, 0.5, SEED)
    return torch.cat([parameter.detach().flatten()[-2:] for parameter in made.parameters()])


def mixture(_: Path) -> torch.Tensor:
    prompts = MixedPrompts(PromptSettings(length=1, rank=1), 3, 2, 0.5, SEED)
    prompts.mix([torch.eye(3)] * 3, 0.7, SEED)
    with torch.no_grad():
        prompts.cross.fill_(1)
        prompts.task_v.fill_(1)
        prompts.task_u.copy_(torch.arange(3.0)[:, None, None].expand(3, 1, 2))
    return torch.stack([prompts.task_prompts(step=step)[:, 0, 0] for step in (0, 1, 7)])


def demonstration(_: Path) -> list[Any]:
    prompts = object.__new__(DemonstrationPrompts)
    torch.nn.Module.__init__(prompts)
    asked: list[Any] = []
    shown = SimpleNamespace(mask=torch.zeros(3, 9))
    prompts._bank, prompts._seed = shown, SEED  # type: ignore[assignment]
    original = torch.from_numpy
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "from_numpy", lambda x: asked.append(x.tolist()) or original(x))
        for step in (0, 7):
            with pytest.raises(TypeError):  # the bank is no batch
                prompts.task_prompts(step=step)
    return asked


def hyper_network(_: Path) -> torch.Tensor:
    bank: Any = SimpleNamespace()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(HyperPrompts, "_seen", lambda self, bank: bank)
        made = HyperPrompts(torch.nn.Module(), bank, bank, 2, 1, 8, SEED)  # type: ignore[arg-type]
    return torch.cat([made.layers.flatten()[:2], made.net[1].weight.flatten()[:2]])


def low_rank(_: Path) -> torch.Tensor:
    model = torch.nn.ModuleDict({"q_proj": torch.nn.Linear(4, 4, bias=False)})
    add_low_rank(model, 2, 1.0, SEED)
    (made,) = (module for module in model.modules() if isinstance(module, LowRank))
    return made.down.flatten()[:3]


def random_rows(_: Path) -> torch.Tensor:
    words = torch.arange(12.0).reshape(4, 3).sin()
    return word_rows(InputSettings(start="random"), words, 2, SEED)[0].flatten()[:3]


def policy_layers(_: Path) -> torch.Tensor:
    backbone = load_backbone("random:tiny", dtype="float32", seed=SEED)
    inputs, head = InputSettings(kind="mlp"), HeadSettings(hidden=4)
    policy = PromptPolicy(backbone, inputs, head, np.zeros(5), np.ones(5), 2, SEED)
    layers = [policy.inputs.maps[0].block[0].weight, policy.head[-1].weight]
    frozen = [p for p in backbone.model.parameters() if p.ndim == 2 and p.std() > 0]
    return torch.cat([layer.detach().flatten()[:1] for layer in [*layers, *frozen[:1]]])


def windows(_: Path) -> list[Any]:
    lengths = np.array([10, 30, 20])
    start = np.cumsum(lengths) - lengths
    numbers = np.zeros((63, 1), np.float32)
    steps = SimpleNamespace(observations=numbers, actions=numbers[:60], rewards=numbers[:60, 0])
    episodes = SimpleNamespace(start=start, obs_start=start + np.arange(3), length=lengths)
    source = SimpleNamespace(steps=steps, episodes=episodes)
    ids = {0: np.array([0, 1]), 1: np.array([2])}
    sampler = WindowSampler(source, ids, [0, 1], 4, 3, SEED)
    return [sampler.batch(step).starts.tolist() for step in (0, 7)]


def dropout(_: Path) -> list[int]:
    return [torch_generator_at(SEED, step, Beside.DROPOUT).initial_seed() for step in (0, 7)]


def demonstrations(tiny_file: Path) -> list[Any]:
    batch = data.sample_demonstrations(data.load_material(str(tiny_file), "all"), 3, SEED, each=4)
    return [batch.episodes.tolist(), batch.starts.tolist()]


def labelled(tiny_file: Path) -> list[Any]:
    dataset = data.load_material(str(tiny_file), "all").dataset
    return [ids.tolist() for ids in choose_steps(dataset, (0, 1), "expert", 20, SEED).ids.values()]


def unlabelled(tiny_file: Path) -> list[Any]:
    dataset = data.load_material(str(tiny_file), "all").dataset
    settings = align.AdaptSettings(windows=4)
    unseen = align.AdaptationSet(dataset, (0, 1), settings, 2, SEED, -1.0, 1.0)
    return [unseen.batch(step).starts.tolist() for step in (0, 7)]


def donors(_: Path) -> list[int]:
    taken: list[torch.Tensor] = []

    def stop(trained: Any, start: Any, n: int, weights: torch.Tensor, seed: int) -> Any:
        taken.append(weights)
        raise StopIteration

    policy: Any = SimpleNamespace(backbone=SimpleNamespace(num_layers=1))
    trained: Any = SimpleNamespace(task_parts=lambda: range(50))
    settings = align.AdaptSettings()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(align, "AdaptedPrompts", stop)
        with pytest.raises(StopIteration):
            align.adapt(
                policy, trained, "cross_one", None, [0] * 4, None, settings, "channel", SEED
            )  # type: ignore[arg-type]
    found: list[int] = taken[0].argmax(dim=1).tolist()
    return found


def reset_noise(_: Path) -> list[Any]:
    family = get_family("cheetah_dir")
    batch = LocomotionBatch(family, family.tasks)
    batch.reset_row(1, SEED, 1.0)
    vector = LocomotionVector(2, "cheetah_dir", "forward")
    return [batch.observations()[1, :2].tolist(), vector.reset(seed=SEED)[0][1, :2].tolist()]


def reward_model(_: Path) -> torch.Tensor:
    from mpdt.train.fit import reward

    inputs = np.arange(60, dtype=np.float32).reshape(20, 3)
    tasks = [reward.Transitions(inputs, inputs[:, 0]), reward.Transitions(inputs, inputs[:, 1])]
    settings = reward.RewardSettings(hidden=4, steps=2, batch=4, lr=0.1)
    fitted = reward.fit_reward_model(tasks, settings, SEED)
    return torch.cat([fitted.net[0].weight.flatten()[:2], fitted.net[4].weight.flatten()[:2]])


def intervals(_: Path) -> list[float]:
    from mpdt.train.evaluate.aggregate import bootstrap, stratified_interval

    scores = np.arange(12.0).reshape(3, 4) ** 2
    return [*bootstrap(scores, SEED), *stratified_interval(scores, seed=SEED)]


def phases(_: Path) -> list[int]:
    from mpdt.seeding import PHASES, phase_seed

    return [phase_seed(SEED, phase) for phase in PHASES]


def adapted(_: Path) -> torch.Tensor:
    trained = DecomposedPrompts(PromptSettings(length=2, rank=3, init_std=1.0), 2, WIDTH, 0.5)
    made = AdaptedPrompts(trained, "cross_random", 2, seed=SEED)
    return torch.cat([made.task_v.flatten()[-2:], made.task_u.flatten()[-2:]])


DRAWN: dict[str, Callable[[Path], Any]] = {
    "prompts decomposed": lambda _: drawn_by_prompts(DecomposedPrompts),
    "prompts teacher": lambda _: drawn_by_prompts(TeacherPrompts),
    "prompts taught": lambda _: drawn_by_prompts(TaughtParts),
    "prompts shared": lambda _: drawn_by_prompts(SharedPrompt),
    "prompts adapted": adapted,
    "mixture": mixture,
    "demonstration": demonstration,
    "hyper network": hyper_network,
    "low rank": low_rank,
    "random rows": random_rows,
    "policy layers": policy_layers,
    "windows": windows,
    "dropout": dropout,
    "demonstrations": demonstrations,
    "labelled": labelled,
    "unlabelled": unlabelled,
    "donors": donors,
    "reset noise": reset_noise,
    "reward model": reward_model,
    "intervals": intervals,
    "phases": phases,
}

PINNED: dict[str, Any] = {
    "prompts decomposed": [-1.649708, 0.02865453, -0.2313216, 0.3688659, -0.2064465, -0.4932385],
    "prompts teacher": [-1.013003, 0.6989576],
    "prompts taught": [-1.649708, 0.02865453],
    "prompts shared": [-1.649708, 0.02865453],
    "prompts adapted": [-0.5577934, 0.6907188, 0.2140987, 0.1466185],
    "mixture": [[0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 1.0, 1.0]],
    "demonstration": [[7, 5, 3], [8, 8, 2]],
    "hyper network": [1.84233, 0.5188872, 0.04405859, 0.1998349],
    "low rank": [-0.2433904, -0.3019108, -0.2790481],
    "random rows": [-0.6224739, -0.7721406, -0.713669],
    "policy layers": [0.1322639, -0.1153802, -0.2657508],
    "windows": [[[24, 14, 5], [1, 5, 7]], [[8, 28, 28], [4, 17, 9]]],
    "dropout": [3462322709277726755, 8669751424075416578],
    "demonstrations": [[[5, 6, 0, 6], [9, 14, 14, 11]], [[2, 3, 2, 1], [5, 4, 5, 4]]],
    "labelled": [[5, 6, 7], [12, 14, 15]],
    "unlabelled": [[[4, 0, 4, 2], [0, 2, 4, 2]], [[4, 2, 4, 6], [2, 0, 6, 4]]],
    "donors": [35, 13, 0, 1],
    "reset noise": [[0.06158816, 0.003065112], [-0.03134583, -0.02618655]],
    "reward model": [0.5269525, -0.2861072, 0.6195935, -0.2932856],
    "intervals": [34.16458, 50.25, 10.5, 65.66667],
    "phases": [*(803261128, 3767054407, 3210010690, 2928346150, 3860361780, 4170728348), 456984185],
}


@pytest.mark.parametrize("stream", DRAWN)
def test_a_stream_keeps_its_numbers(stream: str, tiny_file: Path) -> None:
    found = DRAWN[stream](tiny_file)
    values = found.tolist() if isinstance(found, torch.Tensor) else found
    if np.asarray(values).dtype.kind == "f":  # layers compute with them: not to the last bit
        np.testing.assert_allclose(values, PINNED[stream], rtol=1e-5)
    else:
        assert values == PINNED[stream]
