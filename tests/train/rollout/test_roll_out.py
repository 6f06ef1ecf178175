"""Roll-outs are data: who acted, from which seeds, how well; same bytes whoever did the work."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import mpdt
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.episode import QUALITY_CODES
from mpdt.data.sim.play import run_block
from mpdt.data.sim.simulators import make_batch
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.slices.merge import merge
from mpdt.data.spec.tasks import get_family
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, MissingFileError, UsageError
from mpdt.seeding import HISTORY_STRIDE, Quality, SeedKey
from mpdt.train.evaluate.rollout import evaluate
from mpdt.train.fit.data import load_material
from mpdt.train.rollout.roll_out import plan_roll_outs, roll_out
from mpdt.train.run.load import bundle_folder
from mpdt.train.run.progress import Progress
from mpdt.train.run.stop import Stopped

from .conftest import run

EPISODES = 10  # of two tasks in blocks of 4: six blocks


def rolled(trained, target, tasks="train", start=None, episodes=EPISODES, noise=0.0, series=0,
           progress=None, restart=False):  # fmt: skip
    asked = plan_roll_outs(bundle_folder(str(trained)), tasks, start, episodes, noise, series)
    return roll_out(asked, target, 0, restart, progress or Progress(quiet=True))


@pytest.fixture(scope="module")
def made(trained, tmp_path_factory):
    return rolled(trained, tmp_path_factory.mktemp("made") / "p.h5").dataset


def test_every_check_passes_and_all_of_it_replays(made):
    report = verify(made.path, replay="all")
    rest = [f.text for f in report.findings if f.outcome is not Outcome.PASS]
    assert rest == ["nothing to check: no sets"]


def test_what_the_file_says(made, trained):
    data = open_dataset(trained.parent.parent / "tiny.h5")
    table, policy = made.episodes, mpdt.load_policy(trained / "policy")
    assert (table.quality == QUALITY_CODES["policy"]).all() and made.num_episodes == 2 * EPISODES
    assert (table.seed_key[:, 2] == Quality.POLICY).all() and (table.progress == -1).all()
    assert sorted(set(table.seed_key[:, 3].tolist())) == [HISTORY_STRIDE + n for n in range(3)]
    assert {row.tobytes() for row in made.policies.hashes} == {policy.fingerprint}
    assert made.tasks.references == data.tasks.references
    for row, references in enumerate(made.tasks.references):
        mean = table.returns[table.task == row].mean()
        level = (mean - references["random"].mean) / (
            references["expert"].mean - references["random"].mean
        )
        assert made.policies.levels[row] == np.float32(level)
    (step,) = made.lineage
    config = json.loads((trained / "policy" / "config.json").read_text())
    assert step["from"] == [data.content_hash] and not made.parent
    assert step["rule"]["bundle"] == config["seal"] and made.spec["policy"]["start"] == "own"
    assert made.spec["seed"] == 7 and made.spec["episodes"] == {"policy": EPISODES}
    assert set(made.slices) == {"policy", "train", "test"} and made.stats


def test_a_roll_out_is_what_an_evaluation_would_have_seen(trained):
    """The same keys, goals hidden, rewards told: the same returns, whatever stands beside a row."""
    asked = plan_roll_outs(bundle_folder(str(trained)), "train", None, EPISODES, 0.0, 0)
    family, tasks = get_family("cheetah_dir"), [get_family("cheetah_dir").task("backward")]
    judged = evaluate(asked.actor.policy(tasks[0], "policy", 0)[0], family, tasks, {}, 9, 3, 5)
    keys = [SeedKey(5, family.id, 1, Quality.EVALUATION, 0, row) for row in range(3)]
    made = run_block(
        make_batch(family, tasks * 3), asked.actor.policy(tasks[0], "policy", 0)[0], keys,
        horizon=9, quality=13, progress=-1.0, hidden_columns=family.hidden_columns, width=25,
    )  # fmt: skip
    assert [episode.episode_return for episode in made] == judged.returns[0].tolist()
    told = mpdt.load_policy(trained, task="backward")
    told.reset(3)
    earned = np.zeros(3)
    for step in range(9):
        seen = np.stack([episode.observations[step] for episode in made])
        actions = told.act_batch(seen, earned if step else None)
        assert (actions == np.stack([episode.actions[step] for episode in made])).all()
        earned = np.array([episode.rewards[step] for episode in made])


def test_a_file_without_policy_episodes_keeps_its_bytes(planned_file, tmp_path):
    """The codes stand in an attribute under the seal; old files do not know the new one."""
    import h5py

    with h5py.File(planned_file) as file:
        codes = json.loads(file["episodes/quality"].attrs["codes"])
    assert codes == {"random": 0, "medium": 1, "expert": 2, "history": 3, "unknown": -1}


def test_the_best_ones_beside_their_data_can_be_trained_on(made, trained, tmp_path):
    data = open_dataset(trained.parent.parent / "tiny.h5")
    best = cut_file(made, Cut(return_top=0.3), tmp_path / "best.h5")
    for row in (0, 1):
        own = np.sort(made.episodes.returns[made.episodes.task == row])[::-1]
        assert set(best.episodes.returns[best.episodes.task == row]) == set(own[:3])
    joined = merge([data, best], tmp_path / "joined.h5").dataset
    assert joined.num_episodes == data.num_episodes + 6
    material = load_material(str(joined.path), "policy")
    assert [len(ids) for ids in material.episode_ids.values()] == [3, 3]
    assert load_material(str(joined.path), "auto").quality == "expert"


def test_series_begin_elsewhere_and_stand_beside_each_other(made, trained, tmp_path):
    other = rolled(trained, tmp_path / "1.h5", series=1).dataset
    assert not (other.steps.observations[0] == made.steps.observations[0]).all()
    assert merge([made, other], tmp_path / "both.h5").dataset.num_episodes == 4 * EPISODES
    adapted = rolled(trained, tmp_path / "cross.h5", "test", "cross").dataset
    assert (adapted.steps.observations[0] == made.steps.observations[0]).all(), "same series"
    assert adapted.policies.hashes[0].tobytes() != made.policies.hashes[0].tobytes()
    with pytest.raises(DataError, match="different episodes of one place"):
        merge([made, adapted], tmp_path / "no.h5")


def test_more_episodes_and_fewer_tasks_change_none(made, trained, tmp_path):
    more = rolled(trained, tmp_path / "more.h5", "backward", episodes=EPISODES + 1).dataset
    assert more.tasks.names == ("backward",)
    old = made.episodes.digest[made.episodes.task == 1].tolist()
    assert more.episodes.digest[:EPISODES].tolist() == old


def test_noise_is_another_policy_that_knows_what_it_did(trained, tmp_path, made, monkeypatch):
    from mpdt.model.closed_loop import ClosedLoop

    told, acted = [], ClosedLoop.acted
    monkeypatch.setattr(
        ClosedLoop, "acted", lambda self, actions: (told.append(actions), acted(self, actions))
    )
    noisy = rolled(trained, tmp_path / "n.h5", "forward", episodes=4, noise=0.5).dataset
    assert noisy.policies.hashes[0].tobytes() != made.policies.hashes[0].tobytes()
    assert noisy.policies.names == ("r own + noise 0.5",)
    stored = noisy.steps.actions.reshape(4, -1, 6)
    assert (np.stack(told, 1)[:4].clip(-1, 1) == stored).all()
    assert verify(noisy.path, replay="all").count(Outcome.FAIL) == 0


class Tired(Progress):
    """Stops after so many blocks."""

    def __init__(self, blocks):
        super().__init__(quiet=True)
        self._left = blocks + 1

    def update(self, *_, **__):
        self._left -= 1
        if not self._left:
            raise Stopped(signal.SIGINT)


def test_an_interrupted_call_goes_on(trained, made, tmp_path):
    target = tmp_path / "p.h5"
    with pytest.raises(Stopped):
        rolled(trained, target, progress=Tired(2))
    assert not target.exists()
    parts = sorted((PartsFolder(target).path / "blocks").iterdir())
    assert len(parts) == 2
    parts[0].write_bytes(parts[0].read_bytes()[:-7])
    done = rolled(trained, target)
    assert done.resumed_blocks == 1 and done.is_new
    assert target.read_bytes() == made.path.read_bytes() and [*tmp_path.iterdir()] == [target]
    (PartsFolder(target).path / "blocks").mkdir(parents=True)  # killed just before it went
    again = rolled(trained, target)
    assert not again.is_new and again.reached == done.reached
    assert [*tmp_path.iterdir()] == [target]


def test_parts_of_another_call_are_refused(trained, tmp_path):
    target = tmp_path / "p.h5"
    with pytest.raises(Stopped):
        rolled(trained, target, progress=Tired(1))
    with pytest.raises(DataError, match="another plan"):
        rolled(trained, target, noise=0.1)
    assert rolled(trained, target, noise=0.1, restart=True).is_new


def test_a_restart_replaces_roll_outs_and_nothing_else(trained, made, tiny_file, tmp_path):
    target = tmp_path / "p.h5"
    shutil.copy(tiny_file, target)
    before = target.read_bytes()
    with pytest.raises(DataError, match="something else is there"):
        rolled(trained, target, restart=True)
    assert target.read_bytes() == before
    shutil.copy(made.path, target)
    assert rolled(trained, target, noise=0.1, restart=True).is_new


@pytest.mark.long
def test_workers_and_a_kill_give_the_same_bytes(trained, made, tmp_path):
    """0 in this process, 2 that are killed, 1 for the rest."""
    target = tmp_path / "p.h5"
    words = ["rollout", str(trained), "--episodes", str(EPISODES), "-o", str(target)]
    command = [sys.executable, "-m", "mpdt.train.cli", *words]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    blocks = PartsFolder(target).path / "blocks"
    first = subprocess.Popen([*command, "--workers", "2"], env=environment, start_new_session=True)
    deadline = time.monotonic() + 60
    while first.poll() is None and not [*blocks.glob("*.npz")]:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    first.kill()
    first.wait()
    rest = subprocess.run([*command, "--workers", "1", "--json"], env=environment, text=True,
                          capture_output=True)  # fmt: skip
    assert rest.returncode == 0, rest.stderr
    assert json.loads(rest.stdout)["content_hash"] == made.content_hash
    assert target.read_bytes() == made.path.read_bytes()


@pytest.mark.parametrize(("change", "error", "text"), [
    ({"tasks": "sideways"}, UsageError, "unknown task 'sideways'"),
    ({"tasks": " , "}, UsageError, "no task named"),
    ({"start": "crosss"}, UsageError, "did you mean 'cross'"),
    ({"episodes": 0}, UsageError, "--episodes: out of range"),
    ({"series": -1}, UsageError, "--seed: out of range"),
    ({"noise": float("nan")}, UsageError, "--noise: out of range"),
    ({"noise": -0.1}, UsageError, "--noise: out of range"),
])  # fmt: skip
def test_what_cannot_be_is_said_before_anything_is_made(trained, tmp_path, change, error, text):
    with pytest.raises(error, match=text):
        rolled(trained, tmp_path / "p.h5", **change)
    assert [*tmp_path.iterdir()] == []


def test_what_is_there_is_not_replaced(trained, tmp_path):
    target = tmp_path / "p.h5"
    shutil.copy(trained.parent.parent / "tiny.h5", target)
    before = target.read_bytes()
    with pytest.raises(DataError, match="something else is there"):
        rolled(trained, target)
    assert target.read_bytes() == before
    with pytest.raises(MissingFileError, match="no bundle here"):
        bundle_folder(str(tmp_path))


def test_the_command_prints_what_was_reached(trained, made, tmp_path, capsys):
    words = ["rollout", trained, "-o", tmp_path / "p.h5", "--episodes", EPISODES, "--workers", 0]
    assert run(*words, "-q") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["task", "episodes", "return", "level", "success"]
    assert lines[-1].endswith(f"content {made.content_hash[:8]}")
    assert run("rollout", tmp_path / "nowhere", "-o", tmp_path / "q.h5") == 2
