"""Trials end to end, tiny: the two tasks of cheetah_dir in the simulator, 8 steps an episode."""

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from mpdt.data.spec.tasks import get_family
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, SpecError
from mpdt.model.backbone import from_settings
from mpdt.seeding import Quality, SeedKey
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.adapt.infer import InferSettings, explain
from mpdt.train.adapt.trials import protocol, schedule
from mpdt.train.adapt.trials.live import trial_key
from mpdt.train.adapt.trials.settings import TrialSettings
from mpdt.train.fit.reward import Transitions
from mpdt.train.run.build import build
from mpdt.train.run.config import from_plain, to_plain
from mpdt.train.run.identity import from_record, plain_settings
from mpdt.train.run.judge import Judge
from mpdt.train.run.keep import Keeper
from mpdt.train.run.methods import apply_method, merge
from mpdt.train.run.prepare import prepare
from mpdt.train.run.presets import smoke
from mpdt.train.run.progress import Progress

TINY = {
    "world": {"members": 1, "hidden": 8, "episodes": 2, "pretraining": 3, "refitting": 2,
              "refreshing": 1, "every": 4, "batch": 8, "echo": 10},
    "planner": {"horizon": 4, "knot": 2, "samples": 6, "elites": 2, "echoes": 1},
    "updates": 2, "opening": 4, "tail": 1,
}  # fmt: skip


def config_with(**trials):
    plain = to_plain(apply_method(smoke(), "MPDT-ones"))
    changes = {
        "adapt": {"starts": ["trials"], "trials": merge(TINY, trials), "infer": {"steps": 2}},
        "evaluation": {"horizon": 8, "blocks": ["test"], "episodes": 2, "constants": False},
        "multitask": {"steps": 1},
    }
    return from_plain(merge(plain, changes))


def trained_with(tiny_file, config):
    prepared = prepare(config, str(tiny_file))
    learner = build(prepared, from_settings(config.backbone))
    return learner.trained(learner.asked)


def rows(tiny_file, kept=None, stop_after=None, told=False, **trials):
    """The candidates by name; `stop_after`: trials until a signal; `told`: what each trial is."""
    config = config_with(**trials)
    begun = []

    def on_step(phase, done, total, text):
        if phase.startswith("trials") and "learning" not in text:
            if len(begun) == stop_after:
                raise KeyboardInterrupt
            begun.append((phase, done, text) if told else (phase, done))

    candidates = Candidates(trained_with(tiny_file, config), config, on_step, kept=kept)
    return {one.name: one for one in candidates}, begun


def test_three_trials_begin_as_ten_do_and_a_stopped_run_goes_on_where_it_was(tiny_file, tmp_path):
    """K = 1 and 3 of one run; the same again, stopped before the third of the second task."""
    whole, begun = rows(tiny_file, tmp_path / "a", episodes=(3, 1), rows=("alone",))
    assert list(whole) == ["trials-alone-1", "trials-alone-3", "none"]
    assert [done for _, done in begun] == [0, 1, 2] * 2
    few, many = whole["trials-alone-1"], whole["trials-alone-3"]
    assert (few.reads, few.own_steps, many.own_steps) == ("trials", (8, 8), (24, 24))
    first = [many.tried[0], many.tried[3]]
    assert all(map(same_episode, few.tried, first))
    with pytest.raises(KeyboardInterrupt):
        rows(tiny_file, tmp_path / "b", stop_after=5, episodes=(3,), rows=("alone",))
    again, begun = rows(tiny_file, tmp_path / "b", episodes=(3,), rows=("alone",))
    assert begun == [("trials alone backward", 2)]
    assert all(map(same_episode, again["trials-alone-3"].tried, many.tried))
    assert again["trials-alone-3"].controller.fingerprint == many.controller.fingerprint
    alone, begun = rows(tiny_file, tmp_path / "b", episodes=(3,), rows=("alone",), seed=1)
    assert len(begun) == 6, "other seeds are other trials"
    assert not same_episode(alone["trials-alone-3"].tried[0], many.tried[0])


def same_episode(one, other):
    return one.seed_key == other.seed_key and np.array_equal(one.actions, other.actions)


def test_only_the_row_with_x_reads_x(tiny_file, other_rewards_file):
    """Two files that differ in what X was paid: the row without it is the same, byte for byte."""
    found = [rows(file, episodes=(2,), rows=("alone", "with_x", "race"))[0]
             for file in (tiny_file, other_rewards_file)]  # fmt: skip
    for name, same in (("alone", True), ("race", True), ("with_x", False)):
        one, other = (each[f"trials-{name}-2"] for each in found)
        assert all(map(same_episode, one.tried, other.tried)) == same
        assert one.reads == ("X+rewards, trials" if name == "with_x" else "trials")


@pytest.mark.parametrize(("row", "opening"), [("with_x", 8), ("alone", 8), ("alone", 4)])
def test_the_mean_prompt_is_tried_whole_only_where_it_is_asked_for(tiny_file, row, opening):
    """In episodes of 8 steps: also where base only opens them."""
    for asked in (False, True):
        _, begun = rows(tiny_file, told=True, episodes=(5,), rows=(row,), mean=asked,
                        opening=opening, search="plan")  # fmt: skip
        forward = [text for phase, _, text in begun if phase.endswith("forward")]
        assert forward[0] == ("open base" if row == "with_x" else "open mean")
        assert ("try mean" in forward[1:]) == asked


def test_the_first_trial_alone_is_asked_which_tasks_explain_it(tiny_file, tmp_path, monkeypatch):
    """Every step of it, against a loop; also by a run that goes on after several trials."""
    seen = []

    def spy(model, steps, tasks):
        seen.append(steps)
        return explain(model, steps, tasks)

    monkeypatch.setattr(schedule, "explain", spy)
    found, _ = rows(tiny_file, episodes=(3,), rows=("alone",))
    episodes = found["trials-alone-3"].tried
    assert len(seen) == 2
    for task, steps in enumerate(seen):
        wished = transitions([episodes[3 * task]])
        assert np.array_equal(steps.inputs, wished.inputs)
        assert np.array_equal(steps.rewards, wished.rewards)
    seen.clear()
    with pytest.raises(KeyboardInterrupt):
        rows(tiny_file, tmp_path, stop_after=3, episodes=(5,), rows=("alone",))
    seen.clear()
    rows(tiny_file, tmp_path, episodes=(5,), rows=("alone",))
    assert np.array_equal(seen[0].inputs, transitions([episodes[0]]).inputs)
    seen.clear()
    rows(tiny_file, episodes=(3,), rows=("alone",), infer="world", search="plan")
    assert not seen


@pytest.mark.parametrize("row", ["alone", "with_x"])
def test_where_there_is_no_success_mixtures_near_the_best_are_tried(tiny_file, tmp_path, row):
    """Prompts against the sum of their parts, from what is kept of a run."""
    found, begun = rows(tiny_file, tmp_path, told=True, episodes=(5,), rows=(row,))
    forward = [text for phase, _, text in begun if phase.endswith("forward")]
    assert forward[: 2 if row == "alone" else 1][-1].endswith("base")
    moves = [text.split()[1:] for text in forward if "moved" in text]
    assert len(moves) == (3 if row == "alone" else 4) and "plan" not in forward
    (path,) = tmp_path.glob(f"forward-{row}-*.safetensors")
    kept = load_file(path)
    trained = trained_with(tiny_file, config_with()).prompts.task_prompts().detach()
    earned = [e.episode_return for e in found[f"trials-{row}-5"].tried[:5]]
    earned = earned[1:] if row == "alone" else earned
    one = found[f"trials-{row}-5"]
    assert any(torch.equal(one.prompts[:1], kept[f"contender.{i}.prompt"]) for i in range(6)
               if f"contender.{i}.prompt" in kept), "a bundle can hold it"  # fmt: skip
    numbers = [i for i in range(6) if f"contender.{i}.prompt" in kept]
    tried = [kept[f"contender.{i}.prompt"] for i in numbers[-len(earned) :]]
    for n, (_, share, _, name) in enumerate(moves, start=1):
        leader = tried[max(range(n), key=lambda i: (earned[i], i))]
        task = {"forward": 0, "backward": 1}[name]
        wished = (1 - float(share)) * leader + float(share) * trained[task]
        assert torch.allclose(tried[n], wished, atol=1e-5)


def transitions(episodes):
    """Step by step."""
    steps = [(e.observations[t], e.actions[t], e.observations[t + 1] - e.observations[t])
             for e in episodes for t in range(e.length)]  # fmt: skip
    return Transitions(np.float32([np.concatenate(step) for step in steps]),
                       np.concatenate([e.rewards for e in episodes]))  # fmt: skip


@pytest.mark.parametrize("name", ["ml10", "mt10", "cheetah_vel"])
def test_a_trial_never_has_the_key_of_an_evaluation(name):
    """Any seeds: other keys, other beginnings, and where goals are drawn by key other goals."""
    family = get_family(name)
    trials = {trial_key(seed, family, task.index, number)
              for seed in range(3) for task in family.tasks for number in range(30)}  # fmt: skip
    judged = {SeedKey(seed, family.id, task.index, Quality.EVALUATION, 0, e)
              for seed in range(3) for task in family.tasks for e in range(100)}  # fmt: skip
    assert not {key.spawn_key for key in trials} & {key.spawn_key for key in judged}
    some, others = (sorted(keys, key=repr)[:200] for keys in (trials, judged))
    assert not {key.env_seed() for key in some} & {key.env_seed() for key in others}


def test_evaluation_uses_none_of_the_keys_that_trials_used(tiny_file, monkeypatch):
    """What the simulator is really reset with, in trials and in judging."""
    from mpdt.data.sim.locomotion import LocomotionBatch

    seen, reset = [], LocomotionBatch.reset
    monkeypatch.setattr(LocomotionBatch, "reset", lambda env, keys, goals: (
        seen.append([key.spawn_key for key in keys]), reset(env, keys, goals))[1])  # fmt: skip
    config = config_with(episodes=(2,), rows=("alone",))
    Judge(trained_with(tiny_file, config), config, Progress(quiet=True)).scores()
    tried = {key for keys in seen for key in keys if key[2] == Quality.TRIAL}
    judged = {key for keys in seen for key in keys} - tried
    assert len(tried) == 2 * 2 and {key[2] for key in judged} == {Quality.EVALUATION}


def test_kept_trials_are_data_from_which_they_are_counted_again(tiny_file, tmp_path):
    """The file replays in the simulator; its steps are those that the table tells."""
    config = config_with(episodes=(2,), rows=("alone",))
    keeper = Keeper(tmp_path / "k.h5", "r", {"run": "0" * 64}, lambda text: None)
    scores = Judge(trained_with(tiny_file, config), config, Progress(quiet=True),
                   keeper=keeper).scores()  # fmt: skip
    path = tmp_path / "k-trials-alone-2-own.h5"
    report = verify(path, replay="all")
    found = {one.id: one.outcome for one in report.findings}
    assert set(found.values()) <= {Outcome.PASS, Outcome.NONE} and found["replay"] is Outcome.PASS
    kept = open_dataset(path)
    told = {s.task: s.own_steps for s in scores if s.method == "MPDT-ones 2 own episodes"}
    for row, name in enumerate(kept.tasks.names):
        own = kept.episodes.length[kept.episodes.task == row]
        assert (len(own), own.sum()) == (2, told[name])
    assert told["mean"] == 16
    assert (tmp_path / "k-trials-alone-2.h5").exists()


def test_how_x_is_told_is_nothing_to_trials_without_it():
    by_steps = InferSettings(by="steps")
    assert protocol._told(by_steps, "with_x") == by_steps.facts
    for row in ("alone", "race"):
        assert protocol._told(by_steps, row) == InferSettings().facts


def test_settings_of_trials_count_only_where_trials_are_asked_for():
    """Runs from before there were trials keep their identity."""
    with_trials = config_with()
    without = from_plain(merge(to_plain(with_trials), {"adapt": {"starts": ["infer"]}}))
    assert "trials" not in plain_settings(without)["adapt"]
    assert plain_settings(with_trials)["adapt"]["trials"]["opening"] == 4


def test_without_random_episodes_what_would_ask_a_reward_model_is_refused_before_training(
    medium_file,
):
    """A race asks nobody, and the world model is not made of random episodes alone."""
    with pytest.raises(DataError, match="no random episodes"):
        prepare(config_with(rows=("alone",)), str(medium_file))
    for asked in ({"rows": ("race",)}, {"rows": ("alone",), "infer": "world"}):
        assert len(rows(medium_file, episodes=(2,), **asked)[0]) == 2


@pytest.mark.parametrize("of_before", [True, False])
def test_settings_on_record_are_read_as_what_was_run(of_before):
    """What was left out for being as before is not filled in with what is the default now."""
    before = {"infer": "world", "search": "plan", "mean": False}
    config = config_with(**(before if of_before else {"mean": True}))
    plain = plain_settings(config)
    assert before.keys().isdisjoint(plain["adapt"]["trials"]) == of_before
    assert from_record(plain).adapt == config.adapt
    without = merge(to_plain(config), {"adapt": {"starts": ["infer"]}})
    assert from_record(plain_settings(from_plain(without))).adapt.trials == TrialSettings()


@pytest.mark.parametrize("method", ["Prompt-DT", "HDT", "MT-BC"])
def test_a_policy_without_soft_prompts_is_refused(method):
    with pytest.raises(SpecError, match="need trained soft prompts"):
        from_plain(
            merge(to_plain(apply_method(smoke(), method)), {"adapt": {"starts": ["trials"]}})
        )


@pytest.mark.parametrize(
    ("trials", "where"),
    [({"episodes": (-1,)}, "adapt.trials.episodes"), ({"episodes": ()}, "adapt.trials.episodes"),
     ({"rows": ()}, "adapt.trials.rows"), ({"world": {"batch": 0}}, "adapt.trials.world.batch"),
     ({"planner": {"spread": 0.0}}, "adapt.trials.planner.spread")],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(trials, where):
    with pytest.raises(SpecError, match=where):
        config_with(**trials)
