"""Task inference: goals found again, mixed and held out."""

import numpy as np
import pytest
import torch

from mpdt.train.adapt.infer import InferSettings, explain, explain_all, recognise
from mpdt.train.fit.classifier import TaskClassifier, fit_task_classifier
from mpdt.train.fit.reward import RewardSettings, Transitions, fit_reward_model

QUICK = RewardSettings(hidden=32, steps=400, batch=128, lr=1e-2)


def speeds(goal, seed, num=600):
    """One observation, the speed; reward -|speed - goal|. Speeds reach to both sides of it."""
    generator = np.random.Generator(np.random.PCG64(seed))
    inputs = generator.uniform(0, 4, (num, 3)).astype(np.float32)
    return Transitions(inputs, -np.abs(inputs[:, 0] - np.float32(goal)))


@pytest.fixture(scope="module")
def model():
    torch.set_num_threads(1)
    return fit_reward_model([speeds(goal, i) for i, goal in enumerate((1, 2, 3))], QUICK, seed=0)


def test_a_goal_between_two_is_their_mixture(model):
    """2.25: three quarters of 2 and a quarter of 3, as far as this small model can tell."""
    found = explain(model, speeds(2.25, 9), tasks=2)
    assert found.weights[0] == 0 and found.weights.sum() == pytest.approx(1)
    assert found.weights[1] == pytest.approx(0.75, abs=0.2)
    assert found.named("abc").keys() == {"b", "c"}
    assert found.errors[1] == pytest.approx(0.25, abs=0.1)  # |2.25 - 2| nearly everywhere


def test_a_trained_goal_is_found_and_can_be_held_out(model):
    x = speeds(1, 8)
    assert explain(model, x, tasks=1).weights.tolist() == [1, 0, 0]
    held_out = explain(model, x, tasks=2, banned=[0])
    assert held_out.weights[0] == 0 and held_out.weights[1] > 0.8
    assert explain(model, x, tasks=2, banned=[0, 1]).weights.tolist() == [0, 0, 1]


def scenes(place, seed, num=400):
    """An object stands at `place`; all pay nothing."""
    generator = np.random.Generator(np.random.PCG64(seed))
    inputs = generator.normal(place, 0.5, (num, 3)).astype(np.float32)
    return Transitions(inputs, np.zeros(num, np.float32))


def test_scenes_are_told_by_steps_where_rewards_say_nothing():
    known, x = [scenes(place, i) for i, place in enumerate((0, 2, 4))], scenes(2, 9)
    settings = {"hidden": 32, "steps": 200, "batch": 128, "lr": 1e-2}
    by_steps = explain_all(known, [x], InferSettings(by="steps", **settings), 2, 0)[0]
    assert by_steps.weights.argmax() == by_steps.errors.argmin() == 1
    assert by_steps.weights[1] > 0.9 and np.count_nonzero(by_steps.weights) == 2
    by_rewards = explain_all(known, [x], InferSettings(**settings), 3, 0)[0]
    assert np.ptp(by_rewards.errors) < 1e-3  # each explains nothing equally well


def test_where_all_see_the_same_rewards_tell():
    """One task's states are another's; the classifier has the rewards to go by."""
    known = [speeds(goal, i) for i, goal in enumerate((1, 2, 3))]
    settings = InferSettings(by="steps", hidden=32, steps=400, batch=128, lr=1e-2)
    assert explain_all(known, [speeds(3, 9)], settings, 1, 0)[0].weights.tolist() == [0, 0, 1]


def test_shares_as_a_loop_counts_them():
    """Probabilities of each step on its own, summed one after another."""
    known = [scenes(place, i) for i, place in enumerate((0, 0.5, 1))]
    classifier = fit_task_classifier(known, QUICK, seed=0)
    x, share, nats = scenes(0.4, 9, num=20), np.zeros(3), np.zeros(3)
    with torch.no_grad():
        for inputs, reward in zip(x.inputs, x.rewards, strict=True):
            row = np.concatenate([inputs, [reward]]).astype(np.float32)
            seen = torch.from_numpy(row).sub(classifier.mean).div(classifier.std)
            logits = classifier.net(seen).double().numpy()
            share += np.exp(logits) / np.exp(logits).sum() / 20
            nats -= (logits - np.log(np.exp(logits).sum())) / 20
    found = recognise(classifier, x, tasks=3)
    np.testing.assert_allclose(found.weights, share, rtol=1e-5)
    np.testing.assert_allclose(found.errors, nats, rtol=1e-5)
    two = recognise(classifier, x, tasks=2).weights
    assert two[share.argmin()] == 0 and two.sum() == pytest.approx(1)
    assert two[share.argmax()] == pytest.approx(share.max() / (1 - share.min()), rel=1e-5)


def test_the_classifier_is_a_function_of_its_seed_and_bears_what_stands_still():
    known = [scenes(0, 0, 8), scenes(1, 1, 8)]
    few = RewardSettings(hidden=4, steps=3, batch=8)
    x = (torch.from_numpy(known[0].inputs), torch.from_numpy(known[0].rewards))
    first, again, other = (fit_task_classifier(known, few, seed)(*x) for seed in (1, 1, 2))
    assert torch.equal(first, again) and not torch.equal(first, other)
    still = Transitions(np.ones((4, 3), np.float32), np.ones(4, np.float32))
    assert torch.isfinite(TaskClassifier([still, still], 4, 0)(*x)).all()


def test_what_no_training_task_showed_counts_as_ten_standard_deviations():
    """Mean 0, standard deviation 1."""
    inputs = np.array([[-1.0], [1.0]], np.float32)
    known = [Transitions(inputs, np.zeros(2, np.float32))] * 2
    seen = torch.tensor([[9.0], [10.0], [1e6]])
    near, edge, far = TaskClassifier(known, 4, 0)(seen, torch.zeros(3))
    assert not torch.equal(near, edge) and torch.equal(edge, far)


def test_many_episodes_make_no_task_likelier():
    """Two tasks that overlap, one with twenty times the steps; asked is one in between."""
    known = [scenes(0, 0, num=2000), scenes(0.4, 1, num=100)]
    settings = InferSettings(by="steps", hidden=16, steps=400, batch=256, lr=3e-3)
    found = explain_all(known, [scenes(0.2, 9), scenes(0.4, 8)], settings, 2, 0)
    assert found[0].weights == pytest.approx([0.5, 0.5], abs=0.15)
    assert found[1].weights.argmax() == 1
