"""Whatever a reader believes beside the episodes: changed and sealed anew, it is found."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.lock.file import lock_bytes, read_lock
from mpdt.data.lock.fingerprint import fingerprint, table_hashes
from mpdt.data.slices.cut import Cut, choose, cut_file
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts, TtaRule
from mpdt.data.store.amend import add_slice
from mpdt.data.store.digest import content_hash
from mpdt.data.store.reader import open_dataset
from mpdt.data.store.seal import seal
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify

from .damages import finding, outcomes, put


@pytest.fixture(scope="session")
def real(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """By horizon: real episodes; references of 200 steps are shipped, of 6 steps are measured."""
    folder, found = tmp_path_factory.mktemp("real"), {}
    for horizon, history in ((6, 4), (200, 0)):
        spec = DatasetSpec(
            name="tiny", version="1.0.0", family="cheetah_dir", horizon=horizon, seed=5, block=2,
            behaviour=Behaviour(network="cheetah_dir", rungs=5, noise=0.1), reference=2,
            episodes=EpisodeCounts(random=4, medium=2, expert=4, history=history),
            tta={"default": TtaRule(episodes=2)}, license="CC-BY-4.0",
        )  # fmt: skip
        found[horizon] = folder / f"tiny-{horizon}.h5"
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            collect(make_job(spec), found[horizon], workers=0)
    return found


@pytest.fixture
def tiny(real: dict[int, Path], tmp_path: Path) -> Path:
    return Path(shutil.copy(real[6], tmp_path / "tiny.h5"))


Change = Callable[[h5py.File], None]
Apply = Callable[[Change], Path]


@pytest.fixture
def change(tiny: Path) -> Apply:
    """A change of tiny.h5 by a program that seals it anew."""

    def apply(what: Change) -> Path:
        with h5py.File(tiny, "r+") as file:
            what(file)
            seal(file)
        return tiny

    return apply


def test_the_untouched_files_pass(real: dict[int, Path]) -> None:
    texts = [finding(verify(path, only=["claims"]), "claims") for path in real.values()]
    assert [one.outcome for one in texts] == [Outcome.PASS] * 2
    assert "; 2 references were measured when it was collected" in texts[0].text
    assert texts[1].text.endswith("slices, policies and references found again")


def attribute(name: str, value: str) -> Callable[[h5py.File], None]:
    return lambda file: file.attrs.__setitem__(name, value)


def scaled(name: str, factor: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[name][...] *= factor

    return change


def moved(name: str, by: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[name][...] += by

    return change


def sources(file: h5py.File) -> None:
    file["episodes/source"] = np.arange(len(file["episodes/task"]))


EVIL = json.dumps({"entry_point": "os:system", "kwargs": {"command": "touch PWNED"}})
OTHER_KWARGS = json.dumps({
    "entry_point": "mpdt.data.sim.gym:make",
    "kwargs": {"family": "cheetah_dir", "horizon": 9, "task": "forward"},
})  # fmt: skip
CHANGES = {
    "another program's entry point": (put("tasks/env", 0, EVIL), "not our entry point"),
    "another environment": (put("tasks/env", 0, OTHER_KWARGS), "not our entry point"),
    "a role": (put("tasks/role", 0, 0), "task forward has role train, its entry says both"),
    "a licence": (attribute("license", "CC0-1.1"), "licence CC0-1.1, its entry says"),
    "a version": (attribute("version", "9.0.0"), "version 9.0.0, its entry says"),
    "a name": (attribute("name", "other"), "name other, its entry says"),
    "a mean": (moved("stats/observations/mean", 1e-4), "mean of observations column 0"),
    "a median": (scaled("stats/actions/q50", 1.01), "q50 of actions column"),
    "a largest": (moved("stats/rewards/max", 1.0), "max of rewards column 0"),
    "a slice": (put("slices/expert", 0, 0), "slice expert is not what its rule"),
    "a level": (put("policies/level", 3, 0.9), "its ladder says"),
    "a policy's name": (put("policies/name", 3, "x"), "policy x: name x, its ladder says"),
    "a rung": (put("policies/rung", 3, 17), "rung 17, its ladder says"),
    "ids of a source": (sources, "no source is named"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_changed_is_found(change: Apply, name: str) -> None:
    what, text = CHANGES[name]
    report = verify(change(what), skip=["replay"])
    assert outcomes(report) == {"claims"}
    assert text in finding(report, "claims").text


@pytest.mark.parametrize("horizon", [6, 200])
@pytest.mark.parametrize("name", ["ref_expert", "ref_random", "ref_expert_error"])
def test_references_are_those_of_the_record_or_of_the_episodes(
    real: dict[int, Path], tmp_path: Path, horizon: int, name: str
) -> None:
    path = Path(shutil.copy(real[horizon], tmp_path / "tiny.h5"))
    with h5py.File(path, "r+") as file:
        file[f"tasks/{name}"][...] *= 1.2
        seal(file)
    report = verify(path, only=["claims"])
    assert f"reference {name.split('_')[1]}" in finding(report, "claims").text
    assert outcomes(report) == {"claims"}


def test_a_constant_action_is_a_candidate(real: dict[int, Path], tmp_path: Path) -> None:
    path = Path(shutil.copy(real[200], tmp_path / "tiny.h5"))
    with h5py.File(path, "r+") as file:
        file["tasks/ref_constant_action"][0, 0] = 0.3
        seal(file)
    assert "no candidate for a constant action" in finding(verify(path), "claims").text


def test_the_lock_holds_what_cannot_be_found_again(tiny: Path, change: Apply) -> None:
    lock = tiny.parent / "datasets.lock"
    data = open_dataset(tiny)
    lock.write_bytes(lock_bytes({data.name: fingerprint(data)}))
    assert outcomes(verify(tiny, lock=lock, only=["hash", "claims"])) == set()
    for number, what in enumerate((moved("tasks/ref_zero", 1.5), put("tasks/ref_zero_error", 0, 9),
                                   put("tasks/ref_random_source", 0, "local"))):  # fmt: skip
        content = tiny.read_bytes()
        report = verify(change(what), lock=lock, only=["claims"])
        assert outcomes(report) == {"claims"}, number
        assert "are not those of" in finding(report, "claims").text
        tiny.unlink()
        tiny.write_bytes(content)


def test_a_cut_out_keeps_its_tasks_tables(tiny: Path, tmp_path: Path) -> None:
    data = open_dataset(tiny)
    cut = cut_file(data, Cut(tasks=("backward",), quality="expert"), tmp_path / "cut.h5")
    whole, part = table_hashes(data), table_hashes(cut)
    assert part == {"backward": whole["backward"]}
    assert whole["forward"] != whole["backward"]


def test_an_entry_of_an_older_release_keeps_its_bytes(tiny: Path) -> None:
    data = open_dataset(tiny)
    new = lock_bytes({data.name: fingerprint(data)}).decode()
    old = tiny.parent / "old.lock"
    start = new.index("    tables:")
    old.write_text(new[:start] + new[new.index("    version:", start) :])
    assert lock_bytes(read_lock(old)) == old.read_bytes()
    report = verify(tiny, lock=old, only=["hash", "claims"])
    assert outcomes(report) == set()
    assert "the lock of an older release says less" in finding(report, "claims").text


def test_a_forged_cut_out_of_a_locked_file(tiny: Path, tmp_path: Path, change: Apply) -> None:
    """Whoever writes the locked content hash as parent is believed for whole runs only."""
    lock = tiny.parent / "datasets.lock"
    data = open_dataset(tiny)
    lock.write_bytes(lock_bytes({data.name: fingerprint(data)}))
    whole = cut_file(data, Cut(quality="expert"), tmp_path / "expert.h5")
    assert outcomes(verify(whole.path, lock=lock, only=["hash"])) == set()
    part = cut_file(data, Cut(quality="expert", episodes=1), tmp_path / "one.h5")
    report = verify(part.path, lock=lock, only=["hash"])
    assert outcomes(report, Outcome.WARN) == {"hash"}
    assert "can only prove all of them" in finding(report, "hash").text

    def forge(file: h5py.File) -> None:
        """Other digests, and all hashes that fit them."""
        file["episodes/digest"][0] ^= 1
        digests = file["episodes/digest"][:]
        file.attrs["content_hash"] = content_hash(data.content_header(), digests)
        file.attrs["parent"] = data.content_hash

    report = verify(change(forge), lock=lock, only=["hash"])
    assert outcomes(report) == {"hash"}
    assert "other episodes in forward/random" in finding(report, "hash").text


def test_slices_of_ones_own_by_their_rules(tiny: Path, change: Apply) -> None:
    data = open_dataset(tiny)
    rule = Cut(quality="medium", episodes=2).rule()
    add_slice(tiny, "few", choose(data, Cut(quality="medium", episodes=2)), rule)
    add_slice(tiny, "mine", [1, 5], {"made": "by hand"})
    assert outcomes(verify(tiny, only=["claims"])) == set()
    report = verify(change(put("slices/few", 0, 0)), only=["claims"])
    assert "slice few is not what its rule" in finding(report, "claims").text


def test_what_asks_for_two_returns_of_one_task(change: Apply) -> None:
    report = verify(change(put("tta/default/episodes/preset_return", 0, 3.0)), skip=["replay"])
    assert "tta" in outcomes(report)
    assert "asks for several returns of one task" in finding(report, "tta").text
