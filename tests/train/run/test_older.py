"""Folders that call the shipped language model `auto`, and such that call it by its name."""

import json

import pytest
import torch

import mpdt
from mpdt.model import language
from mpdt.train.evaluate.sealed import sealed
from mpdt.train.run.folder import RunFolder, stored_settings
from mpdt.train.run.older import as_stored, called_once
from mpdt.train.run.prepare import prepare

from .command import QUICK, call

WORDS = ("auto", "smollm2-135m")
FEW = ["--teacher.steps", "1", "--multitask.steps", "1", "--adapt.starts", "none"]


@pytest.fixture
def small(monkeypatch):
    """A model of a few thousand numbers in the place of the shipped one."""

    def tiny(depth, dtype):
        return language.read_language_model("random:tiny-llama", depth, torch.float32, 0)[1]

    monkeypatch.setattr(language, "_smollm2", tiny)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(("word", "other"), [WORDS, WORDS[::-1]])
def test_a_folder_keeps_its_word_and_serves_both(word, other, tiny_file, tmp_path, capsys):
    arguments = ["--data", tiny_file, *QUICK, *FEW, "--runs-dir", tmp_path, "--name", "r"]
    assert call(*arguments, "--backbone.name", word) == 0
    folder, before = tmp_path / "r", (tmp_path / "r" / "config.json").read_bytes()
    assert json.loads(before)["training"]["backbone"]["name"] == word
    assert call(*arguments, "--backbone.name", other) == 0
    assert "this run is done" in capsys.readouterr().err
    assert call(*arguments, "--backbone.name", other, "--evaluation.episodes", "1") == 0
    assert "trained already" in capsys.readouterr().err
    stored = json.loads((folder / "config.json").read_bytes())
    assert stored["training"] == json.loads(before)["training"]
    assert json.loads((folder / "results.json").read_text())["backbone"]["name"] == WORDS[1]
    policy = mpdt.load_policy(folder, "forward", data=tiny_file)
    assert policy.act([0.0] * 20).shape == (6,)


@pytest.mark.usefixtures("small")
def test_a_run_whose_auto_was_gpt2_still_means_it(tiny_file, tmp_path):
    arguments = ["--data", tiny_file, *QUICK, *FEW, "--runs-dir", tmp_path, "--name", "r", "-q"]
    assert call(*arguments, "--backbone.name", "auto") == 0
    results = tmp_path / "r" / "results.json"
    content = json.loads(results.read_text())
    content["backbone"]["name"] = "gpt2"
    results.write_text(json.dumps(sealed(content)))
    folder = RunFolder(tmp_path / "r")
    prepared = prepare(stored_settings(folder.path), str(tiny_file))
    found = as_stored(prepared, folder)
    assert (found.config.backbone.name, found.identity) == ("gpt2", prepared.identity)


def test_studies_call_the_shipped_model_as_their_results_do():
    for name, called in ((WORDS[1], "auto"), ("gpt2", "gpt2"), ("auto", "auto")):
        plain = {"backbone": {"name": name, "depth": 1}, "seed": 3}
        assert called_once(plain) == {"backbone": {"name": called, "depth": 1}, "seed": 3}
