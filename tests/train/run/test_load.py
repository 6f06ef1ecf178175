"""A run from before there were bundles acts as it was judged: the loop against `evaluate`."""

from __future__ import annotations

import shutil

import gymnasium
import numpy as np
import pytest

import mpdt
import mpdt.envs
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.amend import add_slice
from mpdt.errors import FormatError, MissingFileError, ShapeError, UsageError
from mpdt.seeding import Quality, SeedKey
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.cli import main
from mpdt.train.evaluate.rollout import evaluate

QUICK = [
    *("--preset", "smoke", "--threads", "1", "--inputs.return-to-go", "task"),
    *("--teacher.steps", "2", "--multitask.steps", "4", "--statistics.batches", "1"),
    *("--adapt.starts", "none", "--evaluation.horizon", "2", "--evaluation.no-constants"),
]
HORIZON = 4


@pytest.fixture(scope="module")
def finished(tiny_file, tmp_path_factory):
    """Folder of a run, and a file of that name beside it as `load_policy` looks for it."""
    work = tmp_path_factory.mktemp("work")
    file = shutil.copy(tiny_file, work / tiny_file.name)
    expert = mpdt.open(file).select(quality="expert")
    add_slice(file, "half", expert[::2], {})
    words = ["--data", work / tiny_file.name, *QUICK, "--runs-dir", work / "runs", "--name", "r"]
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in [*words, "-q"]])
    assert stopped.value.code == 0
    shutil.rmtree(work / "runs" / "r" / "policy")
    return work / "runs" / "r"


def play(policy: ActingPolicy, task: str, seed: int) -> float:
    """Five lines of a plain loop."""
    env = gymnasium.make("mpdt/CheetahDir-v0", task=task, horizon=HORIZON)
    observation, reward, over, total = env.reset(seed=seed)[0], None, False, 0.0
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy.act(observation, reward))
        over, total = terminated or truncated, total + float(np.float32(reward))
    return total


@pytest.mark.parametrize(("task", "start"), [("forward", None), ("backward", "none"),
                                             ("backward", "cross")])  # fmt: skip
def test_the_plain_loop_is_the_evaluation(finished, task, start):
    before = {path.name: path.read_bytes() for path in finished.iterdir() if path.is_file()}
    policy = mpdt.load_policy(finished, task, start=start)
    family = get_family("cheetah_dir")
    row = family.task(task)

    class OneRow:
        """Its task's prompt among all."""

        def begin(self, rows):
            policy.reset([task])

        def act(self, step, observations, rewards=None):
            return policy.act_batch(observations, rewards)

    judged = evaluate(OneRow(), family, [row], {}, HORIZON, 1, seed=5)
    key = SeedKey(5, family.id, row.index, Quality.EVALUATION, 0, 0)
    for _ in range(2):  # a second episode of the same policy begins anew
        assert play(policy, task, key.env_seed()) == judged.returns[0, 0]
    after = {path.name: path.read_bytes() for path in finished.iterdir() if path.is_file()}
    assert after == before, "loading writes nothing"


def test_prompts_of_tasks_and_starts_differ(finished):
    observation = np.linspace(-1, 1, 20)
    asked = [("forward", None), ("backward", None), ("forward", "none"), ("forward", "cross")]
    actions = [mpdt.load_policy(finished, t, start=s).act(observation).tolist() for t, s in asked]
    assert all(len(action) == 6 for action in actions)
    assert len({tuple(action) for action in actions}) == 4


def test_rewards_lower_the_return_that_is_asked_for(finished):
    def second(reward):
        policy = mpdt.load_policy(finished, "forward")
        policy.act(np.zeros(20))
        return policy.act(np.zeros(20), reward).tolist()

    assert second(0.0) != second(5.0)


def test_mistakes(finished, tmp_path, medium_file):
    with pytest.raises(MissingFileError, match="no run here"):
        mpdt.load_policy(tmp_path, "forward")
    with pytest.raises(UsageError, match="did you mean 'forward'"):
        mpdt.load_policy(finished, "forwards")
    moved = shutil.copytree(finished, tmp_path / "far" / "away" / "r")
    with pytest.raises(MissingFileError, match="not here") as caught:
        mpdt.load_policy(moved, "forward")
    assert "data=FILE" in caught.value.hint
    file = finished.parent.parent / "tiny.h5"
    assert mpdt.load_policy(moved, "forward", data=file).act(np.zeros(20)).shape == (6,)
    with pytest.raises(FormatError, match="trained on another run"):
        mpdt.load_policy(moved, "forward", data=f"{file}:half")


def test_an_adaptation_of_ones_own(finished):
    """The mean of all P_k by hand is the start "none"; X holds what zero-shot may see."""
    seen = []

    def by_hand(policy, trained, x, returns):
        seen.append((x.batch(0).actions.shape[0], len(returns)))
        mean = trained.task_parts().mean(dim=0)
        return (trained.cross * mean).repeat(len(returns), 1, 1)

    observation = np.linspace(-1, 1, 20)
    mine = mpdt.load_policy(finished, "backward", start=by_hand).act(observation)
    theirs = mpdt.load_policy(finished, "backward", start="none").act(observation)
    assert seen == [(2, 2)] and (mine == theirs).all()
    with pytest.raises(ShapeError, match="one prompt"):
        mpdt.load_policy(finished, "backward", start=lambda p, trained, x, r: trained.cross)
