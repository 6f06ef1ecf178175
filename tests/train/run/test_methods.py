"""Every method of the table runs on the shared parts, and differs where it should."""

import itertools
import json
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from mpdt.data.spec.change import changed_keys
from mpdt.errors import UsageError
from mpdt.model.backbone import from_settings
from mpdt.model.policy import PolicyBatch
from mpdt.model.weights import load_weights
from mpdt.train.adapt import candidates as unseen
from mpdt.train.fit.data import load_material, sample_demonstrations
from mpdt.train.run.build import build
from mpdt.train.run.config import TrainConfig, to_plain
from mpdt.train.run.folder import locate
from mpdt.train.run.methods import METHODS, apply_method, merge
from mpdt.train.run.pipeline import run_pipeline
from mpdt.train.run.prepare import prepare
from mpdt.train.run.presets import base, paper, smoke
from mpdt.train.run.progress import Progress

TINY = {
    "backbone": {"name": "random:tiny"}, "evaluation": {"horizon": 3, "episodes": 1},
    "teacher": {"steps": 2}, "multitask": {"steps": 3}, "inputs": {"time_table": 16},
    "prompts": {"length": 4},
    "few_shot": {"updates": 1, "per_task": 2, "steps": 12},
    "adapt": {"steps": 1, "infer": {"steps": 5}}, "mixing": {"model": {"steps": 5}},
}  # fmt: skip
FEW_SHOT = {"few-shot expert": "labelled steps"}
READS: dict[str, dict[str, str]] = {
    "Soft-Prompt": {}, "Soft-Prompt-TTA": {"from cross, adapted": "X"},
    "Prompt-DT": {"expert demonstration": "demonstration"},
    "Prompt-DT-TTA": {"from cross_one, adapted": "X"}, "Prompt-DT-infer": {"infer": "X+rewards"},
    "MT-BC": {}, "MT-BC-FT": FEW_SHOT, "MT-ORL": {}, "MT-ORL-FT": FEW_SHOT,
    "HDT": {"expert demonstration": "demonstration", "few-shot expert": "demonstration"},
    "LaMo": {}, "Full-FT": {},
}  # fmt: skip
"""What a method's rows read of the test tasks; those that are not listed align on X alone."""


def tiny(method: str) -> TrainConfig:
    """The method at the size of a test, its own backbone replaced by the tiny one."""
    config = apply_method(smoke(), method)
    return msgspec.convert(merge(to_plain(config), TINY), TrainConfig)


def run(config: TrainConfig, file: Path, folder: Path) -> dict:
    return run_pipeline(prepare(config, str(file)), locate(folder, "r"), Progress(quiet=True))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_trains_and_is_judged(method, tiny_file, tmp_path):
    results = run(tiny(method), tiny_file, tmp_path)
    rows = [s for s in results["scores"] if s["task"] == "mean" and s["method"].startswith(method)]
    assert {s["block"] for s in rows} == {"train", "test"}
    assert all(np.isfinite(s["mean"]) for s in rows)
    assert all("reads" not in s for s in rows if s["block"] == "train")
    reads = {(s["method"].removeprefix(f"{method} "), s["reads"]) for s in results["scores"]
             if s["block"] == "test" and s["method"].startswith(method)}  # fmt: skip
    plain = {row for row in reads if row[0].endswith("not adapted")}
    assert [said for _, said in plain] == ["nothing"]
    assert reads - plain == set(READS.get(method, {"from cross, adapted": "X"}).items())
    # Judged again from the stored weights: the same numbers, so all that was trained was kept.
    folder = locate(tmp_path, "r")
    # Pages, studies and trackers read it.
    assert "student" in {record["phase"] for record in folder.log.records()}
    assert "NaN" not in folder.log.path.read_text()
    folder.results.unlink()
    before = folder.weights.read_bytes()
    assert run(tiny(method), tiny_file, tmp_path)["scores"] == results["scores"]
    assert folder.weights.read_bytes() == before


def test_a_method_changes_what_it_says_and_nothing_else():
    plain = to_plain(base())
    assert changed_keys(plain, to_plain(apply_method(base(), "MPDT+sparse"))) == [
        'method "MPDT-E" -> "MPDT+sparse"', "multitask.sparse 0.0 -> 0.2",
    ]  # fmt: skip
    with pytest.raises(UsageError, match=r"unknown method 'Promt-DT' \(did you mean 'Prompt-DT'"):
        apply_method(base(), "Promt-DT")


def test_prompts_are_mixed_where_they_were_made_for_it():
    """The choice of held-out training tasks, decision 0010."""
    tasks = {method: apply_method(base(), method).adapt.infer.tasks for method in METHODS}
    assert {method for method, most in tasks.items() if most == 2} == {"MPDT-ones", "MPDT-mixed"}
    assert set(tasks.values()) == {1, 2}


def test_merge_by_hand():
    assert merge({"a": {"x": 1, "y": 2}, "b": 3}, {"a": {"y": 5}, "c": 4}) == {
        "a": {"x": 1, "y": 5}, "b": 3, "c": 4,
    }  # fmt: skip


def trained_names(method: str, file: Path) -> set[str]:
    config = tiny(method)
    learner = build(prepare(config, str(file)), from_settings(config.backbone))
    policy = {f"policy.{n}" for n, p in learner.policy.named_parameters() if p.requires_grad}
    return policy | {n for n, p in learner.prompts.named_parameters() if p.requires_grad}


def test_who_trains_what(tiny_file):
    """A word table never trains; LoRA adds two factors to both blocks and frees nothing else."""
    frozen = trained_names("MPDT", tiny_file)
    assert not any("backbone" in name or "maps" in name for name in frozen)
    lora = [name for name in trained_names("LaMo", tiny_file) if "backbone" in name]
    assert len(lora) == 4 and all(name.endswith((".up", ".down")) for name in lora)
    whole = trained_names("Full-FT", tiny_file)
    assert any("mlp" in name for name in whole) and not any("wte" in name for name in whole)
    assert not any(name.startswith(("cross", "task")) for name in whole), "no prompt"
    shown = trained_names("Prompt-DT", tiny_file)
    assert any(name.startswith("inputs.maps") for name in shown), "an input map of its own"


def test_returns_are_shown_in_training_and_evaluation_or_in_neither():
    """MT-BC's inputs have no column for them at all: nothing can be fed by mistake."""
    assert apply_method(base(), "MT-BC").inputs.return_to_go == "none"
    assert apply_method(base(), "MT-BC-FT").inputs.return_to_go == "none"
    assert apply_method(base(), "MT-ORL").inputs.return_to_go == "family"


def test_prompted_language_models_are_not_shown_their_own_actions():
    """Decision 0018; what is copied from Decision Transformer keeps its three tokens."""
    for method in METHODS:
        inputs = apply_method(base(), method).inputs
        assert inputs.previous_action is (inputs.tokens_per_step == 3), method
    assert apply_method(paper(), "MPDT").inputs.previous_action, "as published"


def test_demonstrations_are_whole_and_of_the_task_asked_for(tiny_file):
    """Three steps each, no pads, of expert episodes 4 to 7 of task 0 and of 12 to 15 of task 1."""
    material = load_material(str(tiny_file), "expert")
    shown = sample_demonstrations(material, 3, seed=0)
    assert shown.mask.all() and shown.observations.shape == (2, 64, 3, 20)
    for row in (0, 1):
        assert set(shown.episodes[row].tolist()) == set(material.episode_ids[row].tolist())
    other = sample_demonstrations(material, 3, seed=0, rows=[1], each=2)
    assert set(other.episodes.ravel().tolist()) <= set(material.episode_ids[1].tolist())


def test_a_stored_configuration_of_a_method_is_json():
    for method in METHODS:
        plain = to_plain(apply_method(base(), method))
        assert json.loads(json.dumps(plain))["method"] == method
    assert torch.get_num_threads() == 1


def test_parts_of_a_teacher_are_its_prompts_until_the_end(tiny_file, tmp_path):
    run(tiny("MPDT-teacher-parts"), tiny_file, tmp_path)
    folder = locate(tmp_path, "r")
    _, teacher = load_weights(folder.teacher, kind="teacher")
    _, student = load_weights(folder.weights, kind="mpdt")
    torch.testing.assert_close(student["prompts.parts"], teacher["prompts.prompts"])
    with pytest.raises(UsageError, match=r"mixing\.share: .*not trained"):
        run(
            merged(tiny("MPDT-teacher-parts"), {"mixing": {"share": 0.5}}),
            tiny_file,
            tmp_path / "m",
        )


def merged(config: TrainConfig, changes: dict) -> TrainConfig:
    return msgspec.convert(merge(to_plain(config), changes), TrainConfig)


def test_a_donor_is_chosen_by_all_training_tasks(tiny_file, tmp_path, monkeypatch):
    """An update takes one task of the two; the choice of whose demonstration to show takes both."""
    drawn = []

    def watched(windows):
        drawn.append(sorted(set(windows.tasks.tolist())))
        return PolicyBatch.from_windows(windows)

    monkeypatch.setattr(unseen, "PolicyBatch", SimpleNamespace(from_windows=watched))
    run(merged(tiny("Prompt-DT"), {"sampler": {"tasks_per_update": 1}}), tiny_file, tmp_path)
    both = sorted(load_material(str(tiny_file), "expert").train_rows)
    assert len(both) == 2 and drawn.count(both) >= unseen.DONOR_BATCHES


def test_the_donor_is_the_task_whose_demonstration_imitates_best(tiny_file, tmp_path, monkeypatch):
    """Of the two tasks' demonstrations the second one's loss is half the first one's."""
    losses, chosen, real = itertools.cycle([2.0, 1.0]), [], unseen.AdaptedPrompts

    def watched(trained, start, n, weights=None, seed=0):
        chosen.append(weights)
        return real(trained, start, n, weights, seed)

    monkeypatch.setattr(unseen, "action_loss", lambda *_: torch.tensor(next(losses)))
    monkeypatch.setattr(unseen, "AdaptedPrompts", watched)
    run(merged(tiny("Prompt-DT"), {"few_shot": {"demonstration": False}}), tiny_file, tmp_path)
    assert [weights.tolist() for weights in chosen] == [[[0, 1], [0, 1]]]


def test_demonstrations_are_not_mixed_whatever_is_asked(tiny_file, tmp_path, monkeypatch):
    asked, real = [], unseen.explain_all

    def watched(known, xs, settings, most, *rest):
        asked.append((settings.by, len(xs), most))
        return real(known, xs, settings, most, *rest)

    monkeypatch.setattr(unseen, "explain_all", watched)
    for method, by in (("Prompt-DT-infer", "rewards"), ("MPDT-mixed", "steps")):
        changes = {"adapt": {"starts": ["infer"], "infer": {"tasks": 2, "by": by}}}
        run(merged(tiny(method), changes), tiny_file, tmp_path / method)
    assert asked == [("rewards", 2, 1), ("steps", 2, 2)]


def test_a_teacher_of_no_updates_still_teaches(tiny_file, tmp_path):
    config = merged(tiny("MPDT"), {"teacher": {"steps": 0}, "multitask": {"log_every": 1}})
    run(config, tiny_file, tmp_path)
    log = [json.loads(line) for line in (tmp_path / "r/metrics.jsonl").read_text().splitlines()]
    assert all("distillation_loss" in line for line in log if line["phase"] == "student")
