"""A policy's bundle goes to another place and comes back to the byte, by way of mpdt-train."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from makers import make_bundle, make_trained

import mpdt
from mpdt.errors import FormatError, UsageError
from mpdt.train.bundle.travel import cache_folder, pull_bundle

from .conftest import Loop, Wire
from .test_hub import Hub, hub
from .test_objects import bucket, s3
from .test_webdav import wire

__all__ = ["bucket", "hub", "s3", "wire"]  # fixtures
FILES = ("README.md", "config.json", "model.safetensors")
Train = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def bundle(collected: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("bundle") / "policy"
    return make_bundle(target, *make_trained(collected))


@pytest.fixture
def train(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Train:
    """`mpdt-train` in an empty folder: exit code, stdout, stderr."""
    from mpdt.train.cli import main

    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr("os.fsync", lambda handle: None)  # no test pulls the plug
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def call(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stopped:
            main([str(word) for word in words])
        captured = capsys.readouterr()
        return int(stopped.value.code or 0), captured.out, captured.err

    return call


def goes_and_comes_back(train: Train, bundle: Path, url: str) -> None:
    code, out, err = train("push", bundle, url)
    assert (code, err) == (0, ""), err
    assert out.startswith("pushed ")
    code, _, err = train("pull", url, "-o", "back")
    assert (code, err) == (0, ""), err
    for name in FILES:
        assert (Path("back") / name).read_bytes() == (bundle / name).read_bytes()
    assert train("push", "back", url)[1].startswith("nothing to do"), "what came back is the same"
    one, other = (mpdt.load_policy(where).act(np.zeros(20)) for where in (bundle, url))
    assert (one == other).all()


def test_a_folder(train: Train, bundle: Path, tmp_path: Path) -> None:
    goes_and_comes_back(train, bundle, str(tmp_path / "there"))


def test_sftp(train: Train, bundle: Path, sftp: Wire, tmp_path: Path) -> None:
    url = f"sftp://127.0.0.1:{sftp.port}{tmp_path}/there"
    goes_and_comes_back(train, bundle, url)
    code, _, err = train("pull", f"sftp://ann:pw1@127.0.0.1:{sftp.port}{tmp_path}/none")
    assert code != 0 and "pw1" not in err


def test_webdav(train: Train, bundle: Path, wire: Wire) -> None:
    goes_and_comes_back(train, bundle, f"webdav://127.0.0.1:{wire.port}/there")


def test_s3(train: Train, bundle: Path, s3: Wire) -> None:
    goes_and_comes_back(train, bundle, "s3://bucket/there")


@pytest.fixture
def model_hub(hub: Hub, loop: Loop, monkeypatch: pytest.MonkeyPatch) -> Hub:
    return hub


def test_a_model_repository(train: Train, bundle: Path, model_hub: Hub) -> None:
    """One commit, with the card where the hub looks for it; data does not go there."""
    goes_and_comes_back(train, bundle, "hf://me/policy")
    assert set(model_hub.files) == {*FILES, "SHA256SUMS"} and len(model_hub.commits) == 1
    code, _, err = train("push", bundle, "hf://datasets/me/set/policy")
    assert code == 2 and "not a model repository" in err


def test_the_card_is_one_of_the_hub(bundle: Path) -> None:
    from huggingface_hub import ModelCard

    data = ModelCard((bundle / "README.md").read_text()).data
    assert data.license == "mit" and data.library_name == "mpdt"
    assert data.datasets == [json.loads((bundle / "config.json").read_text())["data"]["name"]]
    assert {"reinforcement-learning", "cheetah_dir"} <= set(data.tags)


def test_loading_an_address_twice_asks_once(
    train: Train, bundle: Path, tmp_path: Path
) -> None:  # fmt: skip
    url = f"file://{tmp_path}/there"
    assert train("push", bundle, url)[0] == 0
    mpdt.load_policy(url)
    (tmp_path / "there").rename(tmp_path / "gone")
    assert mpdt.load_policy(url).act(np.zeros(20)).shape == (6,)
    assert len(list(cache_folder().iterdir())) == 1


def test_what_is_no_bundle_is_said(train: Train, bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other/a.txt").write_text("x")
    assert train("push", tmp_path / "other", tmp_path / "there")[0] != 0
    from mpdt.data.remote.push import push

    push(tmp_path / "other", str(tmp_path / "there"))
    code, _, err = train("pull", tmp_path / "there", "-o", "x")
    assert code == 2 and "no bundle here" in err
    with pytest.raises((FormatError, UsageError, FileNotFoundError)):
        pull_bundle(str(tmp_path / "there"), tmp_path / "y", lambda *_: None)
