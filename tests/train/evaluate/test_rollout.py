"""Closed-loop sums by hand, on a simulator whose rewards are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from mpdt.data.sim.actors import ConstantPolicy, Rows, UniformPolicy, ZeroPolicy, uniform_actions
from mpdt.data.sim.batch import StepResult
from mpdt.data.spec.tasks import get_family
from mpdt.errors import TrainingError, UsageError
from mpdt.seeding import Quality, SeedKey
from mpdt.train.evaluate.rollout import (
    EvaluationSettings,
    SimulatorCache,
    evaluate,
)

FAMILY = SimpleNamespace(name="toy", id=3, hidden_columns=(1,), has_success=True)
TASKS = [SimpleNamespace(name="a", index=7), SimpleNamespace(name="b", index=9)]


class ToyEnv:
    """Reward = the row's task index x the action; ends after 2 steps in rows of task 9."""

    low, high = np.array([-1.0]), np.array([1.0])
    keys: list = []  # noqa: RUF012 - shared on purpose, the test reads it

    def __init__(self, family, tasks, options):
        self.index = np.array([task.index for task in tasks], np.float64)

    def draw_goals(self, keys):
        ToyEnv.keys.extend(keys)
        return [np.zeros(0)] * len(keys)

    def reset(self, keys, goals):
        self.steps = 0
        return np.ones((len(keys), 2))

    def step(self, actions):
        self.steps += 1
        over = (self.index == 9) & (self.steps >= 2)
        return StepResult(
            np.ones((len(actions), 2)), self.index * actions[:, 0], over, self.index == 7
        )


class Watcher(ConstantPolicy):
    """Acts 2 (to be clipped to 1) and remembers what it was shown and paid."""

    def __init__(self):
        super().__init__(np.array([2.0], np.float32))
        self.seen, self.rewards, self.tasks = [], [], []

    def begin(self, rows):
        super().begin(rows)
        assert rows.goals == ()
        self.tasks.append(rows.tasks.tolist())

    def act(self, step, observations, rewards=None):
        self.seen.append(observations.tolist())
        self.rewards.append(None if rewards is None else rewards.tolist())
        return super().act(step, observations)


def run(controller, **options):
    ToyEnv.keys = []
    arguments = {"horizon": 3, "episodes": 2, "seed": 5, "make": ToyEnv} | options
    return evaluate(controller, FAMILY, TASKS, {}, **arguments)


def test_sums_by_hand():
    """Task a: 3 steps of 7 x 1. Task b: ends after 2 steps of 9 x 1; its third does not count."""
    watcher = Watcher()
    result = run(watcher)
    assert result.tasks == ("a", "b")
    assert result.returns.tolist() == [[21.0, 21.0], [18.0, 18.0]]
    assert result.lengths.tolist() == [[3, 3], [2, 2]]
    assert result.successes.tolist() == [[True, True], [False, False]]
    assert watcher.seen[0] == [[1.0, 0.0]] * 4, "column 1 is hidden"
    assert watcher.rewards[0] is None
    assert watcher.rewards[1] == [7.0, 7.0, 9.0, 9.0], "the raw action 2 was clipped to 1"
    assert watcher.tasks == [[0, 0, 1, 1]]


def test_seeds_depend_on_task_and_episode_alone():
    run(Watcher())
    keys = [(k.seed, k.family, k.task, k.quality, k.block, k.row) for k in ToyEnv.keys]
    E = int(Quality.EVALUATION)
    assert keys == [(5, 3, 7, E, 0, 0), (5, 3, 7, E, 0, 1), (5, 3, 9, E, 0, 0), (5, 3, 9, E, 0, 1)]


def test_goals_may_be_drawn_from_other_keys():
    run(Watcher(), goal_key=lambda key: key.at_row(key.row + 40))
    assert [key.row for key in ToyEnv.keys] == [40, 41, 40, 41]


def test_chunks_change_nothing():
    whole, chunked = run(Watcher()), run(Watcher(), max_rows=3)
    np.testing.assert_array_equal(whole.returns, chunked.returns)
    np.testing.assert_array_equal(whole.lengths, chunked.lengths)


def test_progress_counts_steps():
    seen = []
    run(Watcher(), on_progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_a_diverged_policy_is_named():
    diverged = Watcher()
    diverged.act = lambda step, seen, rewards=None: np.full((len(seen), 1), np.nan)
    with pytest.raises(TrainingError, match="toy: the policy's action is not a number; found step"):
        run(diverged)


def test_rows_that_have_ended_may_answer_anything():
    """Task b ends after 2 steps; from then on its rows answer NaN and are shown to no one."""

    class Ends(Watcher):
        def act(self, step, observations, rewards=None):
            actions = super().act(step, observations, rewards)
            if step > 1:
                actions[2:] = np.nan
            return actions

    watcher = Ends()
    result = run(watcher, horizon=4)
    assert result.returns.tolist() == [[28.0, 28.0], [18.0, 18.0]]
    assert watcher.rewards[3] == [7.0, 7.0, 0.0, 0.0]


def test_random_actions_are_those_the_data_would_draw():
    """Another batch or horizon changes no row."""
    keys = [SeedKey(5, 3, task, Quality.EVALUATION, 0, row) for task in (7, 9) for row in (0, 1)]
    twin = uniform_actions(keys, 4, 2, -1.0, 1.0).astype(np.float32)
    acting = UniformPolicy(2, -1.0, 1.0)
    nothing = np.zeros((4, 1), np.float32)
    acting.begin(Rows(keys, horizon=4))
    acted = np.stack([acting.act(step, nothing) for step in range(4)], 1)
    np.testing.assert_array_equal(acted.astype(np.float32), twin)
    acting.begin(Rows(keys[2:3], horizon=1))
    np.testing.assert_array_equal(acting.act(0, nothing[:1]).astype(np.float32), twin[2:3, 0])


TRIVIAL = {  # returns (2 tasks, 2 episodes), from when evaluation had actors of its own
    ("cheetah_dir", "zero"): [
        [0.6514615528285503, -0.5436108708381653], [0.22919786348938942, -0.16700990917161107],
    ],
    ("cheetah_dir", "uniform"): [
        [-1.155244529247284, 0.258211474865675], [0.3960640737786889, -1.4843267500400543],
    ],
    ("cheetah_dir", "constant"): [
        [1.9025258272886276, 1.700876623392105], [-2.5586061775684357, -2.403450071811676],
    ],
    ("ant_dir", "zero"): [
        [4.4530141949653625, 4.695204377174377], [4.8444704413414, 4.75806999206543],
    ],
    ("ant_dir", "uniform"): [
        [-1.676209481433034, -3.5641587525606155], [1.8839834854006767, -0.35282937809824944],
    ],
    ("ant_dir", "constant"): [
        [-1.2885422930121422, 0.4998173303902149], [0.5819035097956657, -0.09958753152750432],
    ],
}  # fmt: skip


@pytest.mark.parametrize(("name", "who"), TRIVIAL)
def test_trivial_rows_earn_what_they_always_did(name, who):
    family = get_family(name)
    size = family.action_size
    actors = {
        "zero": ZeroPolicy(size),
        "uniform": UniformPolicy(size, -1.0, 1.0),
        "constant": ConstantPolicy(np.full(size, 0.5, np.float32)),
    }
    found = evaluate(actors[who], family, family.tasks[:2], {}, 5, 2, 3)
    np.testing.assert_allclose(found.returns, TRIVIAL[name, who], rtol=1e-9)


def test_random_rows_do_not_depend_on_the_batch():
    acting = UniformPolicy(1, -1.0, 1.0)
    whole, chunked = run(acting), run(acting, max_rows=3)
    np.testing.assert_array_equal(whole.returns, chunked.returns)
    assert len(set(whole.returns.ravel())) == 4, "every row draws its own actions"


def test_the_cache_builds_once_and_again_for_other_tasks():
    cache, family = SimulatorCache(), get_family("cheetah_dir")
    first = cache.make(family, list(family.tasks), {})
    assert cache.make(family, list(family.tasks), {}) is first
    assert cache.make(family, list(family.tasks)[:1], {}) is not first


def test_a_real_simulator_gives_the_same_numbers_again_and_from_a_cache():
    family = get_family("cheetah_dir")
    action = ConstantPolicy(np.full(6, 0.5, np.float32))
    cache = SimulatorCache()
    results = [
        evaluate(action, family, family.tasks, {}, 5, 2, 0, make=make)
        for make in (cache.make, cache.make)
    ]
    np.testing.assert_array_equal(results[0].returns, results[1].returns)
    assert results[0].successes is None and (results[0].lengths == 5).all()
    assert results[0].returns[0, 0] != results[0].returns[0, 1], "episodes have their own seeds"


@pytest.mark.parametrize("name", ["episodes", "max_rows"])
def test_settings_out_of_range(name):
    with pytest.raises(UsageError, match=f"evaluation.{name}: setting out of range"):
        EvaluationSettings(**{name: 0})
