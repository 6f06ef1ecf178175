"""Validation: what is held out is not trained on, what is looked at is the same every time."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from makers import make_trained

from mpdt.data.slices.windows import RewardReturns, gather_windows
from mpdt.data.store.amend import add_slice
from mpdt.data.store.reader import open_dataset
from mpdt.errors import DataError, SpecError
from mpdt.model.demonstrations import DemonstrationPrompts
from mpdt.model.policy import PolicyBatch, action_loss
from mpdt.model.returns import ReturnTable
from mpdt.train.fit import validation
from mpdt.train.fit.data import _without, load_material
from mpdt.train.fit.device import PROCESSOR
from mpdt.train.fit.validation import Validation, best_look
from mpdt.train.run import trainer
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.identity import identify, plain_settings

from ..run.command import QUICK, call

# Experts of the tiny file: 4 to 7 of the first task, 12 to 15 of the second.
SLICES = {
    "validation": [1, 5, 13],
    "mixed": [0, 1, 2, 3, 4, 5, 6, 7, 13],
    "whole": [0, 1, 2, 3, 4, 5, 6, 7],
    "all": list(range(16)),
}


@pytest.fixture(scope="module")
def file(tiny_file, tmp_path_factory):
    path = shutil.copy(tiny_file, tmp_path_factory.mktemp("validation") / "v.h5")
    for name, ids in SLICES.items():
        add_slice(path, name, ids, {})
    return path


def test_what_is_held_out_is_not_trained_on(file):
    material = load_material(str(file), "expert", "validation")
    assert {row: ids.tolist() for row, ids in material.episode_ids.items()} == {
        0: [4, 6, 7], 1: [12, 14, 15],
    }  # fmt: skip
    assert {row: ids.tolist() for row, ids in material.validation_ids.items()} == {0: [5], 1: [13]}
    whole = load_material(str(file), "expert", "whole")
    assert whole.train_rows == (1,) and list(whole.validation_ids) == [0]
    plain = load_material(str(file), "expert")
    assert plain.validation_ids == {}


@pytest.mark.parametrize(
    ("name", "quality", "said"),
    [("all", "expert", "nothing left to train on"), ("few", "expert", "no episode to validate on"),
     ("validaton", "expert", "did you mean 'validation'")],
)  # fmt: skip
def test_refused(file, name, quality, said):
    with pytest.raises(ValueError, match=said):
        load_material(str(file), quality, name)


def test_a_slice_with_test_tasks_is_refused(file):
    dataset = open_dataset(file)
    dataset.tasks.roles[:] = [1, 0]
    with pytest.raises(DataError, match="only tested on; found forward"):
        _without(dataset, {1: np.arange(12, 16)}, "validation")


def test_the_error_is_that_of_every_real_step(tiny_file, file, monkeypatch):
    """One window of each task a batch; slow twin: one window at a time."""
    monkeypatch.setattr(validation, "WINDOWS", 3)
    _, trained = make_trained(tiny_file)
    material = load_material(str(file), "expert", "validation")
    subject = Validation(material, 4, 7)
    found = subject.action_error(trained.policy, trained.prompts, trained.returns, PROCESSOR)
    again = subject.action_error(trained.policy, trained.prompts, trained.returns, PROCESSOR)
    other = Validation(material, 4, 8)._sampler.batch(0)
    assert other.starts.tolist() != subject._sampler.batch(0).starts.tolist()
    total, steps, dataset = 0.0, 0, material.dataset
    for number in range(validation.BATCHES):
        drawn = subject._sampler.batch(number)
        assert drawn.episodes.tolist() == [[5] * 3, [13] * 3] and drawn.starts.any()
        for slot, column in np.ndindex(2, 3):
            one = gather_windows(
                dataset, drawn.episodes[slot : slot + 1, column : column + 1],
                drawn.starts[slot : slot + 1, column : column + 1], 4,
                RewardReturns(dataset, dataset.steps.rewards),
            )  # fmt: skip
            batch, row = PolicyBatch.from_windows(one), torch.tensor([slot])
            output = trained.policy(batch, trained.prompts.task_prompts(row),
                                    trained.returns.select(row))  # fmt: skip
            count = int(batch.mask.sum())
            total += count * float(action_loss(output.actions, batch.actions, batch.mask).detach())
            steps += count
    assert found == again == pytest.approx(total / steps, rel=1e-5)


def test_a_task_held_out_whole_stands_behind_the_mean_of_the_others(tiny_file, file):
    _, trained = make_trained(tiny_file)
    material = load_material(str(file), "expert", "whole")
    seen = []

    def policy(batch, prompts, returns):
        seen.append(prompts)
        return SimpleNamespace(actions=torch.zeros_like(batch.actions))

    subject = Validation(material, 4, 0)
    subject.action_error(
        policy, trained.prompts, trained.returns.select(torch.tensor([1])), PROCESSOR
    )
    mean = trained.prompts.cross * trained.prompts.task_parts().mean(dim=0)
    torch.testing.assert_close(seen[0], mean[None].expand_as(seen[0]))
    with pytest.raises(ValueError, match="demonstrations do not stand"):
        shown = DemonstrationPrompts.__new__(DemonstrationPrompts)
        subject.action_error(policy, shown, trained.returns, PROCESSOR)


def test_each_task_has_its_own_scale_and_one_held_out_whole_the_mean(tiny_file, file):
    """Of the first task all, of the second one episode; as if a third were trained on, too."""
    _, trained = make_trained(tiny_file)
    material = replace(load_material(str(file), "expert", "mixed"), train_rows=(1, 9))
    assert list(material.validation_ids) == [0, 1]
    seen = []

    def policy(batch, prompts, returns):
        seen.append((prompts, returns))
        return SimpleNamespace(actions=torch.zeros_like(batch.actions))

    one, two = torch.tensor([1.0, 2.0]), torch.tensor([3.0, 5.0])
    table = ReturnTable(scale=two, low=-one, high=one, target=one)
    Validation(material, 4, 0).action_error(policy, trained.prompts, table, PROCESSOR)
    prompts, returns = seen[0]
    assert returns.scale.tolist() == [4.0, 3.0]
    assert returns.low.tolist() == [-1.5, -1.0]
    own = trained.prompts.task_prompts(torch.tensor([0]))
    torch.testing.assert_close(prompts[1:], own)


def test_best_look_by_hand():
    log = [{"phase": "validation", "step": 10 * k, "action_error": e}
           for k, e in enumerate((0.5, 0.3, 0.4, 0.3), 1)]  # fmt: skip
    assert best_look([{"phase": "student", "step": 1}, *log]) == (20, 2)


def test_runs_without_it_are_who_they_were_and_patience_is_part_of_one(file):
    assert not {"validation", "patience"} & set(plain_settings(TrainConfig()))
    material = load_material(str(file), "expert", "validation")
    configs = [TrainConfig(validation="validation", patience=n) for n in (0, 2)]
    one, two = (identify(config, plain_settings(config), material) for config in configs)
    assert one.training["data"]["validation"] and one.training["validation"] == "validation"
    assert one.hashes["training"] != two.hashes["training"]
    with pytest.raises(SpecError, match="patience with nothing to look at"):
        TrainConfig(patience=1)


def test_patience_ends_training_with_the_best_look_and_a_kill_changes_nothing(
    file, tmp_path, monkeypatch
):
    """Looks after 2, 4, 6 updates find 0.5, 0.3, 0.4: the weights of four updates."""
    errors = {"2": 0.5, "4": 0.3, "6": 0.4}
    log = tmp_path / "r/metrics.jsonl"
    monkeypatch.setattr(
        Validation, "action_error",
        lambda *_: errors[str(json.loads(log.read_text().splitlines()[-1])["step"])],
    )  # fmt: skip
    saved, dying = [], [True]

    def save(path, tensors, header, plain=trainer.save_weights):
        saved.append(tensors)
        if dying and header.kind == "mpdt":
            dying.pop()
            raise KeyboardInterrupt
        plain(path, tensors, header)

    monkeypatch.setattr(trainer, "save_weights", save)
    command = ["--data", file, *QUICK, "--method", "MPDT-no-distillation", "--validation",
               "validation", "--patience", 1, "--multitask.log-every", 2, "--runs-dir", tmp_path,
               "--multitask.checkpoint-every", 2, "--name", "r", "--evaluation.blocks", "test",
               "--evaluation.episodes", 1, "-q"]  # fmt: skip
    with pytest.raises(KeyboardInterrupt):
        call(*command)
    assert call(*command) == 0
    killed, final = saved
    assert all(torch.equal(killed[name], final[name]) for name in final)
    results = json.loads((tmp_path / "r/results.json").read_text())
    assert (results["updates"]["student"], results["complete"]) == (4, True)
    looks = [json.loads(line) for line in log.read_text().splitlines() if "validation" in line]
    assert [(look["step"], look["action_error"]) for look in looks] == [
        (2, 0.5),
        (4, 0.3),
        (6, 0.4),
    ]
    assert not list((tmp_path / "r").glob("checkpoint-*"))
    assert call(*command, "--adapt.steps", 1) == 0  # judged anew, not trained on
    assert len(saved) == 2
