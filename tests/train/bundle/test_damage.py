"""What was changed in a bundle is one clear error; the script behind `make trust` changes more."""

from __future__ import annotations

import importlib.util
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import mpdt
from mpdt.data.spec.tasks import FAMILIES, get_family
from mpdt.errors import BackboneError, FormatError, MissingFileError, MpdtError, UsageError
from mpdt.train.bundle.build import built
from mpdt.train.bundle.format import seal
from mpdt.train.bundle.read import read_bundle, read_contents

SCRIPT = Path(__file__).parents[3] / "benchmarks" / "trust" / "bundles.py"


def test_sixty_changes(bundle):
    spec = importlib.util.spec_from_file_location("trust_bundles", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    found = script.run(bundle, 60, seed=1)
    assert found["bad"] == []
    for outcomes in found["outcomes"].values():
        assert outcomes["error"] >= 10


def changed(bundle, tmp_path, change):
    """A copy whose config.json says something else, under a right seal."""
    folder = shutil.copytree(bundle, tmp_path / "changed")
    plain = json.loads((folder / "config.json").read_text())
    plain.pop("seal")
    change(plain)
    plain["seal"] = seal(plain)
    (folder / "config.json").write_text(json.dumps(plain))
    return folder


def test_a_changed_byte_is_told_once(bundle, tmp_path):
    folder = shutil.copytree(bundle, tmp_path / "changed")
    written = bytearray((folder / "model.safetensors").read_bytes())
    written[-1] ^= 1
    (folder / "model.safetensors").write_bytes(written)
    with pytest.raises(FormatError, match="not what was written") as caught:
        read_contents(folder)
    assert str(caught.value).count("model.safetensors") == 1


@pytest.mark.parametrize(("change", "kind", "text"), [
    (lambda c: c.update(format="mpdt-policy/2"), FormatError, "another version"),
    (lambda c: c["family"].update(name="cheetah_dire"), UsageError, "not known here.*cheetah_dir"),
    (lambda c: c["family"].update(hidden_columns=[1]), FormatError, "another family of that name"),
    (lambda c: c["files"].update({"../x": c["files"].pop("README.md")}), FormatError, "files"),
    (lambda c: c["files"]["model.safetensors"].update(size=1 << 50), FormatError, "not the size"),
    (lambda c: c.update(window=1 << 40), FormatError, "window"),
    (lambda c: c["inputs"].update(time_table=10**6), FormatError, "time"),
    (lambda c: c["head"].update(hidden=10**9), FormatError, "do not fit"),
    (lambda c: c["backbone"]["shape"].update(num_hidden_layers=10**6), FormatError, "blocks"),
    (lambda c: c["backbone"]["shape"].update(hidden_size=10**6), FormatError, "do not fit"),
    (lambda c: c["backbone"]["shape"].update(activation="exec"), BackboneError, "exec"),
    (lambda c: c["prompts"][0].update(tasks=["forward", "forward"]), FormatError, "not there"),
    (lambda c: c["prompts"][0]["returns"].update(scale=[0.0, 1.0]), FormatError, "positive"),
    (lambda c: c["statistics"].update(mean=[0.0]), FormatError, "statistics"),
])  # fmt: skip
def test_what_somebody_seals_again(bundle, tmp_path, change, kind, text):
    with pytest.raises(kind, match=text) as caught:
        mpdt.load_policy(changed(bundle, tmp_path, change))
    assert "\n" not in str(caught.value)


def test_missing_files_and_families(bundle, tmp_path, monkeypatch):
    for name in ("config.json", "model.safetensors", "README.md"):
        folder = shutil.copytree(bundle, tmp_path / name)
        (folder / name).unlink()
        with pytest.raises(MissingFileError):
            mpdt.load_policy(folder)
    with pytest.raises(MissingFileError):
        mpdt.load_policy(tmp_path / "nowhere")
    monkeypatch.delitem(FAMILIES, "cheetah_dir")
    with pytest.raises(MpdtError, match="for a family that is not known here"):
        mpdt.load_policy(bundle)


def test_blocks_by_name_are_compared(finished, tmp_path, monkeypatch):
    """Another language model under that name is refused."""
    from .conftest import run

    small = tmp_path / "small"
    assert run("bundle", finished, "-o", small, "--without-backbone") == 0
    with pytest.raises(BackboneError, match="is another one"):
        mpdt.load_policy(changed(small, tmp_path, lambda c: c["backbone"].update(seed=99)))


@pytest.mark.parametrize(("name", "tensor"), [
    ("cross", torch.zeros(1, 64)), ("task_u", torch.zeros(1, 1, 64)), ("cross", torch.zeros(9)),
    ("task_v", torch.zeros(2, 30, 1, dtype=torch.float64)), ("more", torch.zeros(2)),
])  # fmt: skip
def test_prompts_that_training_left_fit_each_other(bundle, name, tensor):
    """Who begins from a policy copies them task by task."""
    contents = read_contents(bundle)
    read_bundle(bundle)
    tensors = {**contents.tensors, f"prompts.trained.{name}": tensor}
    with pytest.raises(MpdtError, match=f"tensor '{name}'"):
        built(replace(contents, tensors=tensors), get_family(contents.config.family.name))
