"""Adaptation touches P_c of its own task and nothing else; its data hold no label."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mpdt.data.store.reader import open_tta_rewards
from mpdt.data.store.ttaset import find_tta_set
from mpdt.errors import DataError, TrainingError, UsageError
from mpdt.model.backbone import load_backbone
from mpdt.model.policy import PromptPolicy
from mpdt.model.prompts import DecomposedPrompts, PromptSettings
from mpdt.model.returns import ReturnTable
from mpdt.model.tokens import InputSettings
from mpdt.train.adapt.align import (
    AdaptationSet,
    AdaptSettings,
    adapt,
    alignment_loss,
    returns_of_test_tasks,
)
from mpdt.train.adapt.statistics import LayerStatistics
from mpdt.train.fit.data import load_material
from mpdt.train.run.presets import smoke

SETTINGS = AdaptSettings(windows=3, steps=2, lr=0.01)


@pytest.fixture(scope="module")
def dataset(tiny_file):
    return load_material(str(tiny_file), "expert").dataset


@pytest.fixture(scope="module")
def policy(dataset):
    backbone = load_backbone("random:tiny", dtype="float32")
    stats = dataset.stats["observations"]
    return PromptPolicy(backbone, InputSettings(), smoke().head, stats["mean"], stats["std"], 6)


@pytest.fixture
def trained(policy):
    return DecomposedPrompts(PromptSettings(length=3), 2, policy.backbone.width, 0.2)


RETURNS = ReturnTable(*(torch.tensor([x, x]) for x in (30.0, 0.0, 30.0, 25.0)))


def unseen(dataset, rows=(0, 1), settings=SETTINGS, seed=5):
    return AdaptationSet(dataset, rows, settings, 4, seed, -1.0, 1.0)


def source(policy):
    shape = (policy.backbone.num_layers, policy.backbone.width)
    return LayerStatistics(torch.zeros(shape), torch.ones(shape))


def test_alignment_by_hand():
    """Features 1 and 3: mean 2, variance 1. Source mean 0, variance 4: |2| + |-3| = 5."""
    features = (torch.tensor([[[[1.0], [3.0]]]]),)
    mask = torch.ones(1, 1, 2, dtype=torch.bool)
    wanted = LayerStatistics(torch.zeros(1, 1), torch.full((1, 1), 4.0))
    assert alignment_loss(features, mask, wanted, "channel", ()).tolist() == [5.0]


def test_alignment_looks_at_the_chosen_layers_only():
    features = (torch.full((1, 1, 1, 1), 7.0), torch.zeros(1, 1, 1, 1))
    wanted = LayerStatistics(torch.zeros(2, 1), torch.zeros(2, 1))
    mask = torch.ones(1, 1, 1, dtype=torch.bool)
    assert alignment_loss(features, mask, wanted, "channel", ()).tolist() == [3.5]
    assert alignment_loss(features, mask, wanted, "channel", (1,)).tolist() == [0.0]


def test_only_the_prompt_moves(dataset, policy, trained):
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    cross = trained.cross.detach().clone()
    losses = []
    prompts = adapt(
        policy, trained, "cross", unseen(dataset), RETURNS, source(policy), SETTINGS,
        "channel", 0, lambda step, loss: losses.append(sum(loss)),
    )  # fmt: skip
    assert all(torch.equal(value, before[name]) for name, value in policy.state_dict().items())
    assert all(parameter.grad is None for parameter in policy.parameters())
    assert torch.equal(trained.cross, cross)
    assert prompts.shape == (2, 3, 64) and not torch.equal(prompts[0], cross)
    assert not torch.equal(prompts[0], prompts[1]), "each test task starts from P_c anew"
    assert len(losses) == 2


def test_a_task_ends_where_it_would_have_ended_alone(dataset, policy, trained):
    """One window of a one-episode X, so that both runs see the same windows."""
    settings = AdaptSettings(windows=40, steps=3, lr=0.01, episodes=1)
    arguments = (source(policy), settings, "channel", 0)
    both = adapt(
        policy, trained, "cross_mean", _Whole(dataset, (0, 1), settings), RETURNS, *arguments
    )
    alone = adapt(policy, trained, "cross_mean", _Whole(dataset, (1,), settings),
                  RETURNS.select(torch.tensor([1])), *arguments)  # fmt: skip
    torch.testing.assert_close(both[1], alone[0], rtol=1e-4, atol=1e-6)


class _Whole(AdaptationSet):
    """All windows of X in order, whatever the step."""

    def __init__(self, dataset, rows, settings):
        super().__init__(dataset, rows, settings, 4, 0, -1.0, 1.0)

    def batch(self, step):
        import mpdt.train.adapt.align as module

        picks = [np.arange(2) for _ in self._covers]
        return module.gather_windows(
            self.source,
            np.stack([ids[p] for (ids, _), p in zip(self._covers, picks, strict=True)]),
            np.stack([s[p] for (_, s), p in zip(self._covers, picks, strict=True)]),
            self._window, self._returns, tasks=self._rows,
        )  # fmt: skip


def test_longer_adaptation_lowers_the_loss(dataset, policy, trained):
    losses = []
    settings = AdaptSettings(windows=8, steps=30, lr=0.02)
    adapt(policy, trained, "cross", unseen(dataset, settings=settings), RETURNS, source(policy),
          settings, "channel", 0, lambda step, loss: losses.append(sum(loss)))  # fmt: skip
    assert losses[-1] < losses[0]


def test_no_adaptation_is_mean_prompt_untouched(dataset, policy, trained):
    arguments = (unseen(dataset), RETURNS, source(policy), SETTINGS, "channel", 0)
    prompts = adapt(policy, trained, "none", *arguments)
    expected = trained.cross * trained.task_parts().mean(dim=0)
    torch.testing.assert_close(prompts[1], expected.detach())


def test_one_donor_per_task_and_random_parts_leave_p_c_fixed(dataset, policy, trained):
    arguments = (unseen(dataset), RETURNS, source(policy), SETTINGS, "channel", 0)
    assert adapt(policy, trained, "cross_one", *arguments).shape == (2, 3, 64)
    assert adapt(policy, trained, "cross_random", *arguments).shape == (2, 3, 64)


def test_x_holds_the_preset_and_actions_as_executed(dataset):
    """Presets 20 and 30; drawn actions reach +-3, executed ones +-1."""
    batch = unseen(dataset).batch(0)
    assert set(batch.returns_to_go[0][batch.mask[0]].tolist()) == {20.0}
    assert set(batch.returns_to_go[1][batch.mask[1]].tolist()) == {30.0}
    assert np.abs(batch.previous_actions).max() == 1.0
    drawn = unseen(dataset, settings=AdaptSettings(windows=3, clip_actions=False)).batch(0)
    assert np.abs(drawn.previous_actions).max() > 1.5


def test_x_is_a_function_of_seed_and_step_and_nested(dataset):
    first, again, other = (
        unseen(dataset).batch(1),
        unseen(dataset).batch(1),
        unseen(dataset).batch(2),
    )
    np.testing.assert_array_equal(first.starts, again.starts)
    assert (first.starts != other.starts).any() or (first.episodes != other.episodes).any()
    one = AdaptationSet(dataset, (1,), AdaptSettings(windows=9, episodes=1), 4, 0, -1.0, 1.0)
    assert set(one.batch(0).episodes.ravel().tolist()) == {2}


def test_decrement_reads_the_simulated_rewards(dataset):
    """Rewards of X are 1 + 4 = 5 a step: 20, 15, 10, ... from the episode's first step."""
    rewards, _ = open_tta_rewards(dataset.path, "default")
    assert set(rewards.tolist()) == {5.0}
    settings = AdaptSettings(windows=9, returns="decrement")
    batch = unseen(dataset, rows=(0,), settings=settings).batch(0)
    np.testing.assert_array_equal(
        batch.returns_to_go[batch.mask], (20 - 5 * batch.timesteps[batch.mask]).astype(np.float32)
    )


def test_target_of_unseen_tasks():
    table = ReturnTable(*(torch.tensor(x) for x in ([10.0, 20], [0.0, -5], [9.0, 19], [8.0, 18])))
    preset = returns_of_test_tasks(table, AdaptSettings(), [100.0])
    assert preset.target.tolist() == [100.0] and preset.scale.tolist() == [15.0]
    own = returns_of_test_tasks(table, AdaptSettings(target="training"), [100.0])
    assert own.target.tolist() == [13.0] and own.high.tolist() == [19.0]


def test_refusals(dataset, medium_file, policy, trained):
    bare = load_material(str(medium_file), "auto").dataset
    with pytest.raises(DataError, match="no set for test-time adaptation"):
        find_tta_set(bare, "default", (0,))
    with pytest.raises(UsageError, match=r"unknown TTA set 'defalt' \(did you mean 'default'"):
        find_tta_set(dataset, "defalt", (0,))
    settings = AdaptSettings(layers=(2,))
    with pytest.raises(UsageError, match=r"adapt.layers: no such layer; expected 0 to 1"):
        adapt(policy, trained, "cross", unseen(dataset), RETURNS, source(policy), settings,
              "channel", 0)  # fmt: skip


def test_what_is_no_number_is_refused(dataset):
    """Rewards of no number would leave weights of zero, and nobody would be told."""
    tta = dataset.tta["default"]
    rewards = open_tta_rewards(dataset, "default")[0].copy()
    rewards[tta.start[1]] = np.nan
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpdt.train.adapt.align.open_tta_rewards", lambda *_: (rewards, None))
        with pytest.raises(DataError, match="episode 1 of the TTA set 'default' has what is no n"):
            unseen(dataset).rewards()
    for name in ("observations", "actions", "preset_return"):
        values = np.array(getattr(tta, name))
        values[-1] = np.inf
        broken = replace(dataset, tta={"default": replace(tta, **{name: values})})
        with pytest.raises(DataError, match=f"episode {len(tta) - 1} of the TTA set 'default'"):
            unseen(broken)


@pytest.mark.parametrize("wrong", [{"windows": 0}, {"lr": -1.0}, {"lr": np.nan}, {"lr": np.inf}])
def test_settings_out_of_range(wrong):
    with pytest.raises(UsageError, match=f"adapt.{next(iter(wrong))}: setting out of range"):
        AdaptSettings(**wrong)


def test_what_diverges_names_adaptation_and_its_rate(dataset, policy, trained):
    """A step of 1e30 in the first update; the second one cannot be computed."""
    settings = AdaptSettings(windows=3, steps=9, lr=1e30)
    with pytest.raises(
        TrainingError, match=r"cross: .* nan at step 1; found tasks \[0, 1\]"
    ) as caught:
        adapt(policy, trained, "cross", unseen(dataset), RETURNS, source(policy), settings,
              "channel", 0)  # fmt: skip
    assert "--adapt.lr" in caught.value.hint


def test_a_step_shows_no_window_twice_while_there_are_others(dataset):
    """Six windows of 4 steps or so per task; all of them, then more than there are."""
    every = unseen(dataset, settings=AdaptSettings(windows=1))
    count = min(len(ids) for ids, _ in every._covers)
    batch = unseen(dataset, settings=AdaptSettings(windows=count)).batch(0)
    for row in range(2):
        shown = set(zip(batch.episodes[row].tolist(), batch.starts[row].tolist(), strict=True))
        assert len(shown) == count
    assert unseen(dataset, settings=AdaptSettings(windows=50)).batch(0).mask.shape[1] == 50


def test_actions_are_shown_as_they_were_executed_or_as_they_were_drawn(dataset):
    """Drawn up to 3, executed up to 1; the action of the step before as well."""
    cut = unseen(dataset, settings=AdaptSettings(windows=9)).batch(0)
    drawn = unseen(dataset, settings=AdaptSettings(windows=9, clip_actions=False)).batch(0)
    for name in ("actions", "previous_actions"):
        assert np.abs(getattr(cut, name)).max() == 1 < np.abs(getattr(drawn, name)).max()


def test_the_first_n_episodes_of_x(dataset):
    one = unseen(dataset, settings=AdaptSettings(episodes=1))
    assert [len(ids) for ids in one.ids] == [1, 1]
    assert [ids[0] for ids in one.ids] == [ids[0] for ids in unseen(dataset).ids]
