"""The parts of a trial, each against something slow and obviously right."""

import numpy as np
import pytest
import torch

from mpdt.data.spec.tasks import get_family
from mpdt.errors import FormatError
from mpdt.train.adapt.trials.climb import Move, next_mixture, next_move
from mpdt.train.adapt.trials.contenders import Contender, best
from mpdt.train.adapt.trials.features import SCALES_M, Features
from mpdt.train.adapt.trials.inside import plans
from mpdt.train.adapt.trials.lived import Lived, Stretch
from mpdt.train.adapt.trials.planner import Planner, imagine
from mpdt.train.adapt.trials.race import leader, next_runner
from mpdt.train.adapt.trials.settings import PlannerSettings, TrialSettings, WorldSettings
from mpdt.train.adapt.trials.store import TrialStore
from mpdt.train.adapt.trials.world import pretrain, refit

TINY = WorldSettings(members=2, hidden=16, pretraining=150, refitting=150, batch=64, lr=1e-2)
RIGHT = np.array([1.0, 0.0])


def stretch(length: int, seed: int, observation_size: int = 2, action_size: int = 2) -> Stretch:
    """A point that moves by half of the action; 1 for a step to the right."""
    generator = np.random.Generator(np.random.PCG64(seed))
    actions = generator.uniform(-1, 1, (length, action_size)).astype(np.float32)
    places = np.cumsum(0.5 * actions, axis=0)
    observations = np.zeros((length + 1, observation_size), np.float32)
    observations[1:, :2] = places[:, :2]
    return Stretch(observations, actions, (actions[:, :2] @ RIGHT).astype(np.float32))


class Plane:
    """A family of two columns."""

    columns, hidden_columns = ("x [m]", "y [m]"), ()


def plane_features(steps) -> Features:
    return Features(Plane, steps.observations, steps.following - steps.observations)


def test_steps_of_episodes_one_behind_the_other_equal_a_loop():
    """Two episodes of 3 and 2 steps: the next observation never is another episode's."""
    parts = [stretch(3, 0), stretch(2, 1)]
    steps = Lived(parts).as_steps([5, 7])
    at = 0
    for head, part in zip((5, 7), parts, strict=True):
        for t in range(len(part.rewards)):
            assert torch.equal(steps.observations[at], torch.from_numpy(part.observations[t]))
            assert torch.equal(steps.following[at], torch.from_numpy(part.observations[t + 1]))
            assert torch.equal(steps.first[at], torch.from_numpy(part.observations[0]))
            assert torch.equal(steps.actions[at], torch.from_numpy(part.actions[t]))
            assert (steps.rewards[at], steps.tasks[at]) == (part.rewards[t], head)
            at += 1
    assert at == len(steps) == 5


def test_the_next_observation_copies_the_columns_of_the_step_before():
    """ml10: 18 columns move, 18 repeat those of a step ago, the goal stays hidden."""
    family = get_family("ml10")
    generator = torch.Generator().manual_seed(0)
    seen = torch.randn(50, 39, generator=generator)
    seen[:, 36:] = 0
    features = Features(family, seen, torch.randn(50, 39, generator=generator))
    assert features.moving.tolist() == list(range(18))
    changes = torch.randn(50, 18, generator=generator)
    following = features.advance(seen, changes)
    assert torch.equal(following[:, 18:36], seen[:, :18])
    assert torch.allclose(following[:, :18], seen[:, :18] + changes * features.change)
    assert not following[:, 36:].any()


def test_distances_are_seen_at_sharp_scales():
    """Hand at the origin, the first object 3 cm off along x and where it was at first."""
    family = get_family("ml10")
    seen = torch.zeros(1, 39)
    seen[0, 4] = 0.03
    features = Features(family, torch.randn(9, 39), torch.randn(9, 39))
    inputs = features.inputs(seen, seen, torch.zeros(1, 0))[0]
    near = inputs[-4 * len(SCALES_M) :].reshape(len(SCALES_M), 4)
    for scale, row in zip(SCALES_M, near, strict=True):
        assert row[0] == pytest.approx(np.exp(-0.03 / scale))
        assert row[1:].tolist() == [1.0, 1.0, 1.0]


def test_a_refitted_model_learns_its_own_reward_and_leaves_the_pretrained_one():
    """Pretrained on a step to the right; the new task pays the contrary."""
    known = Lived([stretch(60, seed) for seed in range(4)]).as_steps()
    world = pretrain(plane_features(known), known, 1, TINY, 0)
    before = [parameter.clone() for parameter in world.parameters()]
    own = stretch(60, 9)
    new = Lived([Stretch(own.observations, own.actions, -own.rewards)]).as_steps()
    refitted = refit(world, new, 60, 150, 1)
    step = refitted.pick(0)
    here = torch.zeros(2, 2)
    following, paid = step(here, here, torch.tensor([[1.0, 0.0], [-1.0, 0.0]]))
    assert paid[1] > 0.5 > -0.5 > paid[0]
    assert following[:, 0].tolist() == pytest.approx([0.5, -0.5], abs=0.1)
    assert all(map(torch.equal, before, world.parameters()))
    again = refit(world, new, 60, 150, 1)
    assert all(map(torch.equal, refitted.parameters(), again.parameters()))


def point(observations, first, actions):
    """The plane itself as a world model: pays for nearness to (1, -1), less what was there."""
    following = observations + 0.5 * actions
    target = torch.tensor([1.0, -1.0]) + 0 * first
    return following, -(following - target).norm(dim=1)


def voices(observations, first):
    """Two: straight on along x; back to where it began."""
    return torch.stack([torch.ones_like(observations), first - observations], dim=1)


def test_roll_outs_side_by_side_equal_one_after_another():
    """Six sequences, the last four of them listening to a voice; a loop over rows and steps."""
    generator = torch.Generator().manual_seed(1)
    actions = torch.randn(6, 5, 2, generator=generator)
    start, first, own = torch.tensor([0.2, 0.1]), torch.tensor([-0.3, 0.4]), [0, 1, 1, 0]
    found = imagine(point, start, first, actions, 0.9, -1, 1, voices, torch.tensor(own))
    for row in range(6):
        now, earned = start[None], 0.0
        for step in range(5):
            action = actions[row, step]
            if row >= 2:
                action = action + voices(now, first[None])[0, own[row - 2]]
            action = action.clamp(-1, 1)
            assert torch.equal(found.actions[row, step], action)
            now, reward = point(now, first[None], action[None])
            earned += 0.9**step * float(reward[0])
        assert float(found.returns[row]) == pytest.approx(earned, abs=1e-5)


def planner(seed: int = 0, **changes) -> Planner:
    settings = PlannerSettings(horizon=6, knot=2, samples=64, noise=0.0, **changes)
    generator = np.random.Generator(np.random.PCG64(seed))
    return Planner(point, voices, 2, 2, -1, 1, settings, generator)


def test_the_planner_walks_to_the_place_that_pays_and_again_the_same_way():
    """From the origin to (1, -1) and stays there; another generator walks differently."""
    paths = []
    for seed in (0, 0, 1):
        subject, now = planner(seed, rounds=3), np.zeros(2, np.float32)
        path = [now]
        for _ in range(8):
            action = subject.act(now, path[0])
            now = now + 0.5 * action
            path.append(now)
        assert np.linalg.norm(now - [1, -1]) < 0.25
        paths.append(np.stack(path))
    assert np.array_equal(paths[0], paths[1]) and not np.array_equal(paths[0], paths[2])


def test_the_best_sequence_is_at_least_as_good_as_any_prompt_echo():
    """A world where only a voice's way pays: no sample hits it, the plan is the voice's."""

    def picky(observations, first, actions):
        wished = voices(observations, first)[:, 0]
        return observations + 0.5 * actions, -100 * (actions - wished.clamp(-1, 1)).norm(dim=1)

    subject = Planner(picky, voices, 2, 2, -1, 1, PlannerSettings(horizon=6, knot=2, samples=8),
                      np.random.Generator(np.random.PCG64(0)))  # fmt: skip
    assert torch.equal(subject.plan(torch.zeros(2), torch.zeros(2)), torch.ones(6, 2))


def contender(name: str, returns=(), successes=()) -> Contender:
    return Contender(name, None, None, list(returns), list(successes))


def test_a_new_clone_goes_before_what_failed_and_after_what_succeeded():
    failed, new = contender("base", [1.0], [False]), contender("clone 1")
    good = contender("clone 2", [5.0, 4.0], [True, True])
    assert best([failed, new], True) == 1
    assert best([failed, new, good], True) == 2
    assert best([failed, contender("clone 1", [], [False])], True) == 0  # the same share: it earned


def test_without_successes_the_mean_return_decides():
    """-20 against -25 and one that nobody tried."""
    ones = [contender("base", [-25.0]), contender("clone 1", [-21.0, -19.0]), contender("clone 2")]
    assert best(ones, False) == 1
    assert best([contender("base")], False) == 0


def test_a_race_tries_each_once_and_takes_success_before_return():
    ones = [contender("mean", [9.0], [False]), contender("prompt 1", [3.0], [True]),
            contender("prompt 2")]  # fmt: skip
    assert next_runner(ones) == 2
    assert leader(ones) == 1
    assert leader([contender("mean"), contender("prompt 1")]) == 0


@pytest.mark.parametrize(
    ("better", "move"),
    [([], Move(0, 0.3)), ([True], Move(0, 0.3)), ([False], Move(1, 0.3)),
     ([False, False, True], Move(2, 0.3)), ([False] * 4, Move(0, 0.15)),
     ([False] * 3 + [True] + [False] * 3, Move(2, 0.3)),
     ([False] * 3 + [True] + [False] * 4, Move(3, 0.15))],
)  # fmt: skip
def test_moves_go_on_while_they_help_and_halve_after_a_round_that_did_not(better, move):
    assert next_move(better, 4) == move


def test_no_trial_is_spent_on_moving_to_where_the_best_mixture_is():
    """Two tasks at 0 and 1, the base at 0; then 0.3, which is better, 0.51, worse, back to 0."""
    near = torch.tensor([[[0.0]], [[1.0]]])
    prompts, earned = [near[:1]], [0.0]
    for wished, paid in ((0.3, 1.0), (0.51, 0.5), (0.21, 0.2), (0.405, 0.1)):
        _, prompt = next_mixture(prompts, earned, 1, near)
        assert prompt.item() == pytest.approx(wished)
        prompts, earned = [*prompts, prompt], [*earned, paid]
    move, _ = next_mixture([near[:1]], [0.0], 1, near[:1])
    assert move == Move(0, 0.3), "nowhere else to go: it is tried again"


@pytest.mark.parametrize(
    ("family", "trials", "planned"),
    [("ml10", {}, True), ("ml10", {"rows": ("race",)}, False),
     ("ml10", {"rows": ("race", "alone")}, True), ("cheetah_vel", {}, False),
     ("cheetah_vel", {"search": "plan"}, True),
     ("cheetah_vel", {"search": "plan", "rows": ("race",)}, False)],
)  # fmt: skip
def test_a_world_model_is_trained_only_where_something_plans(family, trials, planned):
    assert plans(TrialSettings(**trials), get_family(family)) == planned


def test_damaged_trials_are_moved_away_and_made_again(tmp_path):
    """The weights beside them are whole: nothing has to be trained again."""
    path = tmp_path / "forward alone.safetensors"
    path.write_bytes(b"half of it")
    with pytest.raises(FormatError) as caught:
        TrialStore(path, {"trials": "0" * 64}).load(shared=None)
    assert caught.value.hint == f"move '{path}' away: the same command makes its trials again"
