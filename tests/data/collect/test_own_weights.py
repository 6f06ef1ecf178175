"""Weights of one's own: read where datasets.yaml names them, told of, never for a data file."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from mpdt.data.cli import main
from mpdt.data.collect.add_tta import add_set, set_job
from mpdt.data.sim import network_file
from mpdt.data.spec.entry import TtaRule
from mpdt.data.store import provenance
from mpdt.data.store.reader import open_dataset

ENTRY = """
schema: 1
datasets:
  mine:
    family: cheetah_dir
    tasks: all
    block: 50
    version: "1.0.0"
    license: CC0-1.0
    horizon: 4
    seed: 5
    episodes: {expert: 1}
    behaviour: {network: %s, rungs: 20, noise: 0.1}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for path in network_file.network_files("cheetah_dir"):
        shutil.copy(path, tmp_path / f"weights{path.suffix}")
    (tmp_path / "datasets.yaml").write_text(ENTRY % (tmp_path / "weights"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    code = main(list(words))
    said = capsys.readouterr()
    assert not code, said.err
    return said.out + said.err


def test_own_weights_are_told_of_and_their_hash_is_stored(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = hashlib.sha256((folder / "weights.safetensors").read_bytes()).hexdigest()
    told = f"weights of your own, {folder}/weights.safetensors, SHA-256 {digest[:16]}"
    assert told in run(capsys, "plan", "mine")
    assert told in json.loads(run(capsys, "plan", "mine", "--json", "--quiet"))["notices"][0]
    listed = f"mine acts with weights that mpdt does not ship: {folder}/weights"
    assert listed in run(capsys, "list")
    assert told in run(capsys, "collect", "mine", "--workers", "0")
    shown = run(capsys, "show", "mine.h5")
    assert f"weights  not of mpdt: {folder}/weights   SHA-256 {digest[:16]}" in shown
    found = json.loads(run(capsys, "show", "mine.h5", "--json"))
    assert found["own_weights"] == {"network": f"{folder}/weights", "sha256": digest}

    def never(*_: Any) -> Any:
        raise AssertionError("a data file made us read weights")

    monkeypatch.setattr(network_file, "load_network", never)
    monkeypatch.setattr(network_file, "load", never)
    monkeypatch.setattr("mpdt.data.sim.network.load_network", never)
    data = open_dataset(folder / "mine.h5")
    assert data.packages[provenance.WEIGHTS] == digest
    added = add_set(data, set_job(data, "x", TtaRule(episodes=1)), workers=0)
    assert "x" in added.dataset.tta
    run(capsys, "verify", "mine.h5")


def test_shipped_weights_are_not_told_of(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "datasets.yaml").write_text(ENTRY % "cheetah_dir")
    assert "weights" not in run(capsys, "plan", "mine") + run(capsys, "list")
