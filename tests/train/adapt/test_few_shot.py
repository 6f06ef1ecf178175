"""Few-shot: exactly the labelled steps, only what is to be tuned, each task by itself."""

import numpy as np
import pytest
import torch

from mpdt.data.slices.sampler import WindowSampler
from mpdt.errors import DataError, TrainingError, UsageError
from mpdt.model.backbone import load_backbone
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import AdaptedPrompts, DecomposedPrompts, PromptSettings
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt.few_shot import FewShotSettings, choose_steps, tune
from mpdt.train.fit.data import load_material
from mpdt.train.run.presets import smoke

QUICK = FewShotSettings(steps=12, updates=3, per_task=4, lr=0.01)
RETURNS = ReturnTable(*(torch.tensor([x, x + 9]) for x in (30.0, 0.0, 30.0, 25.0)))


@pytest.fixture(scope="module")
def dataset(tiny_file):
    return load_material(str(tiny_file), "expert").dataset


@pytest.fixture(scope="module")
def policy(dataset):
    stats = dataset.stats["observations"]
    backbone = load_backbone("random:tiny", dtype="float32")
    return PromptPolicy(backbone, InputSettings(), smoke().head, stats["mean"], stats["std"], 6)


def prompts(policy, start="cross"):
    trained = DecomposedPrompts(PromptSettings(length=3), 2, policy.backbone.width, 0.2)
    return AdaptedPrompts(trained, start, 2)


def test_exactly_the_steps_asked_for(dataset):
    """Expert episodes of task 0 have 6, 7, 8, 9 steps: 10 steps are one and a piece of another."""
    labelled = choose_steps(dataset, (0, 1), "expert", 10, seed=0)
    assert (labelled.num_steps(0), labelled.num_steps(1)) == (10, 10)
    assert len(labelled.ids[0]) == 2
    again = choose_steps(dataset, (0, 1), "expert", 10, seed=0)
    np.testing.assert_array_equal(again.ids[1], labelled.ids[1])
    drawn = {tuple(choose_steps(dataset, (0,), "expert", 10, s).ids[0]) for s in range(9)}
    assert len(drawn) > 1


def test_windows_end_where_the_labels_end(dataset):
    """Six labelled steps: no window shows a seventh, though the episode goes on."""
    labelled = choose_steps(dataset, (1,), "expert", 6, seed=1)
    sampler = WindowSampler(labelled, labelled.ids, [1], window=5, per_task=200, seed=0)
    batch = sampler.batch(0)
    assert batch.timesteps[batch.mask].max() == 5
    assert batch.returns_to_go[batch.mask].max() == 18.0, "six expert rewards of 3"


def test_mixed_is_a_third_of_each_level(dataset):
    labelled = choose_steps(dataset, (0,), "mixed", 8, seed=0)
    quality = dataset.episodes.quality[labelled.ids[0]]
    steps = [int(labelled.episodes.length[labelled.ids[0]][quality == q].sum()) for q in (2, 1, 0)]
    assert steps == [3, 3, 2]


def test_only_the_prompt_is_tuned(dataset, policy):
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    labelled = choose_steps(dataset, (0, 1), "expert", 12, 0)
    start = prompts(policy).task_prompts().detach().clone()
    tuned = tune(policy, prompts(policy), labelled, (0, 1), 4, RETURNS, QUICK, 0)
    assert all(own is policy for own, _ in tuned)
    assert all(torch.equal(value, before[name]) for name, value in policy.state_dict().items())
    assert all(parameter.grad is None for parameter in policy.parameters())
    for i, (_, prompt) in enumerate(tuned):
        assert prompt.shape == (1, 3, 64) and not torch.equal(prompt[0], start[i])
    assert not torch.equal(tuned[0][1], tuned[1][1])


def test_whole_policies_are_tuned_one_by_one(dataset, policy):
    """Task 1 ends where it ends alone: no moments of an optimiser leak from task 0."""
    settings = FewShotSettings(steps=12, updates=3, per_task=4, lr=0.01, tuned="all")
    labelled = choose_steps(dataset, (0, 1), "expert", 12, 0)
    both = tune(policy, prompts(policy), labelled, (0, 1), 4, RETURNS, settings, 0)
    alone = tune(policy, prompts(policy).select(torch.tensor([1])), labelled, (1,), 4,
                 RETURNS.select(torch.tensor([1])), settings, 0)  # fmt: skip
    torch.testing.assert_close(both[1][1], alone[0][1])
    for name, value in both[1][0].own_state().items():
        torch.testing.assert_close(value, alone[0][0].own_state()[name])
    assert not torch.equal(both[0][0].head[1].weight, policy.head[1].weight)


def test_tuning_lowers_the_loss(dataset, policy):
    losses = []
    settings = FewShotSettings(steps=12, updates=40, per_task=8, lr=0.02)
    labelled = choose_steps(dataset, (0, 1), "expert", 12, 0)
    tune(policy, prompts(policy), labelled, (0, 1), 4, RETURNS, settings, 0,
         lambda _, parts: losses.append(parts["action_loss"]))  # fmt: skip
    assert losses[-1] < losses[0]


def test_what_diverges_names_few_shot_and_its_rate(dataset, policy):
    settings = FewShotSettings(steps=12, updates=9, per_task=4, lr=1e30)
    labelled = choose_steps(dataset, (0, 1), "expert", 12, 0)
    with pytest.raises(TrainingError, match=r"few-shot: .* nan at step") as caught:
        tune(policy, prompts(policy), labelled, (0, 1), 4, RETURNS, settings, 0)
    assert "--few-shot.lr" in caught.value.hint and "--optimiser" not in caught.value.hint


def test_refusals(dataset):
    with pytest.raises(DataError, match="too few expert steps of test task forward"):
        choose_steps(dataset, (0,), "expert", 200, 0)
    with pytest.raises(UsageError, match=r"few_shot\.updates"):
        FewShotSettings(updates=0)
