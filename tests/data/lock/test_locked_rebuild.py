"""The repository's own lock: its smoke entries are made again and have the locked hashes.

Runs are locked per task, so one task of a slow family says as much about it as all of them.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.lock.claim import Claim
from mpdt.data.lock.file import LockEntry, decisive_packages, read_lock
from mpdt.data.lock.fingerprint import lost_runs, other_versions
from mpdt.data.lock.keeper import MACHINE, spec_claim
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.smoke import smoke
from mpdt.data.store.dataset import Dataset

ROOT = Path(__file__).parents[3]
CATALOG = load_catalog(ROOT / "datasets.yaml")
LOCK = read_lock(ROOT / "datasets.lock")
FAMILIES = ("cheetah_dir", "cheetah_vel", "ant_dir", "ml10", "ml45", "mt10", "mt50")


def rebuild(name: str, folder: Path, tasks: tuple[str, ...] | None = None) -> Dataset:
    """The smoke version of an entry, or of some of its tasks."""
    spec = smoke(CATALOG.get(name))
    if tasks is not None:
        spec = msgspec.structs.replace(spec, tasks=tasks)
    return collect(make_job(spec), folder / "x.h5", workers=1).dataset


def comparable(lost: list[str], entry: LockEntry, data: Dataset) -> list[str]:
    """On another machine a network may act differently in a last bit; random actions may not."""
    names = decisive_packages(data.family)
    if other := other_versions(entry.packages, data.packages, names):
        pytest.skip(f"locked with other versions: {other}")
    lost = [run for run in lost if run.partition("/")[0] in data.tasks.names]
    if other_versions(entry.platform, data.platform, MACHINE) and data.family in FAMILIES[:3]:
        lost = [run for run in lost if run.partition("/")[2].startswith(("random", "tta-"))]
    return lost


def locked(name: str) -> LockEntry:
    assert f"{name}-smoke" in LOCK, "every family keeps a small version in datasets.lock"
    return LOCK[f"{name}-smoke"]


@pytest.mark.parametrize(("name", "tasks"), [("cheetah_dir", None), ("ml10", ("reach",))])
def test_a_small_version_has_its_locked_hashes(
    tmp_path: Path, name: str, tasks: tuple[str, ...] | None
) -> None:
    entry = locked(name)
    data = rebuild(name, tmp_path, tasks)
    assert comparable(lost_runs(data, entry), entry, data) == []
    if tasks is None and not other_versions(entry.platform, data.platform, MACHINE):
        assert data.content_hash == entry.hashes.content


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_has_its_locked_hashes(tmp_path: Path, name: str) -> None:
    entry = locked(name)
    data = rebuild(name, tmp_path)
    assert comparable(lost_runs(data, entry), entry, data) == []


@pytest.mark.parametrize("name", sorted(LOCK))
def test_no_locked_spec_changed_under_its_version(name: str) -> None:
    origin = name.removesuffix("-smoke")
    spec = CATALOG.get(origin) if name == origin else smoke(CATALOG.get(origin))
    assert spec_claim(LOCK[name], spec) is Claim.SAME
