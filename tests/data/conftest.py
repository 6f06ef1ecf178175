"""Fixtures for everything above store and sim: the fake simulator and a small finished file."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec

SCRIPT = Path(__file__).with_name("fake_sim.py")


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fake_sim", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fake_sim"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def fake_sim() -> ModuleType:
    return _load()


@pytest.fixture
def fakes(fake_sim: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Put the fakes in place; call it again with another level of `medium`."""

    monkeypatch.setattr(os, "fsync", lambda handle: None)  # no test pulls the plug

    def install(medium: float = 0.5) -> None:
        fake_sim.install(monkeypatch.setattr, medium)

    install()
    return install


@pytest.fixture
def workplace(fake_sim: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder with a datasets.yaml that has the entry `tiny`."""
    (tmp_path / "datasets.yaml").write_text(fake_sim.DATASETS_YAML)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def tiny_spec(workplace: Path) -> DatasetSpec:
    return load_catalog().get("tiny")


@pytest.fixture(scope="session")
def collected(fake_sim: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`tiny.h5`, made once; nobody writes to it."""
    folder = tmp_path_factory.mktemp("collected")
    (folder / "datasets.yaml").write_text(fake_sim.DATASETS_YAML)
    with pytest.MonkeyPatch.context() as patch:
        fake_sim.install(patch.setattr)
        spec = load_catalog(folder / "datasets.yaml").get("tiny")
        collect(make_job(spec), folder / "tiny.h5", workers=0)
    return folder / "tiny.h5"


@pytest.fixture
def tiny_file(collected: Path, fakes: Callable[..., None], workplace: Path) -> Path:
    """A copy of `tiny.h5` in the working folder."""
    return shutil.copy(collected, workplace / "tiny.h5")
