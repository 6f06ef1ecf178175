"""Behaviour networks: forward pass by hand, hashes, and which rung acts for which quality."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mpdt.data.sim.actors import Rows, UniformPolicy
from mpdt.data.sim.network import (
    NetworkLadder,
    NetworkPolicy,
    network_actions,
    policy_digest,
)
from mpdt.data.sim.network_file import load_network, network_files
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.tasks import get_family
from mpdt.errors import FormatError, MissingFileError, SpecError, UsageError
from mpdt.seeding import HISTORY_STRIDE, Quality, SeedKey, Stream

FAMILY = get_family("cheetah_dir")


def spec(**behaviour: object):
    entry = load_catalog().get("cheetah_dir")
    return msgspec.structs.replace(
        entry, behaviour=msgspec.structs.replace(entry.behaviour, **behaviour)
    )


def test_forward_pass_by_hand() -> None:
    """One input 3, mean 1, std 2 -> 1; tanh(1 * 2), tanh(that * 1 + 0.5), times 3."""
    one = np.ones((1, 1), dtype=np.float32)
    weights = {
        "mean": np.float32([1.0]),
        "std": np.float32([2.0]),
        "w0": 2 * one,
        "b0": np.zeros(1, np.float32),
        "w1": one,
        "b1": np.full(1, 0.5, np.float32),
        "w2": 3 * one,
        "b2": np.zeros(1, np.float32),
    }
    want = 3 * np.tanh(np.tanh(2.0) + 0.5)
    assert network_actions(weights, np.array([[3.0]]))[0, 0] == pytest.approx(want, abs=1e-6)
    # Inputs are cut at +-10 standard deviations: 3 and 1e9 deviations differ, 11 and 1e9 do not.
    far = network_actions(weights, np.array([[23.0], [2e9]]))
    assert far[0, 0] == far[1, 0]


def test_digest_is_sha256_of_sorted_arrays_and_noise() -> None:
    weights = {"b": np.float32([1.0]), "a": np.float32([[2.0]])}
    text = b"a <f4 (1, 1)\n" + np.float32([[2.0]]).tobytes()
    text += b"b <f4 (1,)\n" + np.float32([1.0]).tobytes() + b"noise 0.1\n"
    assert policy_digest(weights, 0.1) == hashlib.sha256(text).digest()
    assert policy_digest(weights, 0.2) != policy_digest(weights, 0.1)


def test_noise_comes_from_the_row_and_is_a_prefix() -> None:
    ladder = NetworkLadder(spec(noise=0.1))
    policy, progress = ladder.policy(FAMILY.tasks[0], "expert", 0)
    assert progress == 1.0
    keys = [SeedKey(1, 0, 0, Quality.EXPERT, 0, row) for row in range(2)]
    goals = [np.array([1.0])] * 2
    observations = np.zeros((2, 20))
    policy.begin(Rows(keys, goals, 3))
    first = policy.act(0, observations)
    draw = keys[1].generator(Stream.POLICY).standard_normal((3, 6), np.float32)
    policy.begin(Rows(keys, goals, 200))
    assert np.array_equal(policy.act(0, observations), first)
    quiet, _ = NetworkLadder(spec(noise=0.0)).policy(FAMILY.tasks[0], "expert", 0)
    quiet.begin(Rows(keys, goals, 3))
    np.testing.assert_allclose(first[1] - quiet.act(0, observations)[1], 0.1 * draw[0], atol=1e-6)


def test_goal_reaches_the_network() -> None:
    policy, _ = NetworkLadder(spec()).policy(FAMILY.tasks[0], "expert", 0)
    keys = [SeedKey(1, 0, 0, Quality.EXPERT, 0, 0)] * 2
    policy.begin(Rows(keys, [np.array([1.0]), np.array([-1.0])], 1))
    forward, backward = policy.act(0, np.zeros((2, 20)))
    assert np.abs(forward - backward).max() > 0.1


def test_each_quality_has_its_rung() -> None:
    ladder = NetworkLadder(spec())
    for task in FAMILY.tasks:
        uniform, progress = ladder.policy(task, "random", 0)
        assert isinstance(uniform, UniformPolicy) and progress == 0.0
        medium, _ = ladder.policy(task, "medium", 0)
        assert 0.35 <= medium.info.level <= 0.65
        expert, _ = ladder.policy(task, "expert", 0)
        assert expert.info.level == 1.0
        history, progress = ladder.policy(task, "history", 7 * HISTORY_STRIDE + 2)
        assert history.info.rung == 7 and progress == pytest.approx(7 / 19)
        hashes = {info.hash for info in ladder.policies([task])}
        for policy in (uniform, medium, expert, history):
            assert policy.info.task == task.index
            assert policy.info.hash in hashes


def test_shipped_expert_reaches_the_official_data() -> None:
    """Official cheetah_dir experts return 667 forward and 1134 backward over 200 steps."""
    _, record = network_files("cheetah_dir")
    final = json.loads(record.read_text())["rungs"][-1]["returns"]
    assert final["forward"] >= 667
    assert final["backward"] >= 1134


def test_fewer_rungs_keep_first_and_last() -> None:
    all_rungs = load_network("cheetah_dir").rungs
    ladder = NetworkLadder(spec(rungs=3))
    assert ladder.num_rungs == 3
    first, _ = ladder.policy(FAMILY.tasks[0], "history", 0)
    last, _ = ladder.policy(FAMILY.tasks[0], "history", 2 * HISTORY_STRIDE)
    assert isinstance(first, NetworkPolicy) and isinstance(last, NetworkPolicy)
    assert first.info.hash == policy_digest(all_rungs[0], 0.1)
    assert last.info.hash == policy_digest(all_rungs[-1], 0.1)


def test_impossible_ladders_are_refused() -> None:
    with pytest.raises(SpecError, match=r"rungs are not shipped.*found 99"):
        NetworkLadder(spec(rungs=99))
    with pytest.raises(UsageError, match=r"did you mean 'cheetah_dir'"):
        NetworkLadder(spec(network="cheetah_dirr"))
    with pytest.raises(UsageError, match="quality"):
        NetworkLadder(spec()).policy(FAMILY.tasks[0], "good", 0)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A copy of the shipped network as somebody's own, its path without suffix."""
    for path in network_files("cheetah_dir"):
        shutil.copy(path, tmp_path / f"mine{path.suffix}")
    return tmp_path / "mine"


def test_own_weights_act_and_are_told_of(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shipped, mine = NetworkLadder(spec()), NetworkLadder(spec(network=str(own)))
    assert mine.policies(FAMILY.tasks) == shipped.policies(FAMILY.tasks)
    assert (shipped.notice, shipped.weights) == ("", "")
    digest = hashlib.sha256(own.with_suffix(".safetensors").read_bytes()).hexdigest()
    assert mine.weights == digest
    assert mine.notice == (
        f"behaviour: weights of your own, {own}.safetensors, SHA-256 {digest[:16]}"
    )
    monkeypatch.chdir(own.parent)
    assert NetworkLadder(spec(network="./mine")).notice == mine.notice
    with pytest.raises(MissingFileError, match=r"yours\.safetensors: behaviour weights are not"):
        NetworkLadder(spec(network="./yours"))


def test_own_weights_that_are_none_are_one_clear_error(own: Path) -> None:
    from safetensors.numpy import load_file, save_file

    arrays, record = own.with_suffix(".safetensors"), own.with_suffix(".json")
    good, told = load_file(arrays), json.loads(record.read_text())

    def refused(match: str) -> None:
        with pytest.raises(FormatError, match=match):
            NetworkLadder(spec(network=str(own)))

    for broken in (b"", b"\x80\x04.", b"\xff" * 64, arrays.read_bytes()[:-9]):
        arrays.write_bytes(broken)
        refused("not a file of weights")
    for changed in (
        {"rung-00/w0": good["rung-00/w0"][:, :3]},
        {"rung-00/w0": np.full_like(good["rung-00/w0"], np.nan)},
        {"rung-00/w0": good["rung-00/w0"].astype(np.float64)},
        {"rung-00/b9": np.zeros(1, np.float32)},
        {"x": np.zeros((), np.float32)},
    ):
        save_file(good | changed, arrays)
        refused("not a behaviour network")
    save_file(good, arrays)
    rungs = told["rungs"]
    for text, match in (
        ("[]", "not the record"),
        ("{", "not the record"),
        (json.dumps(told | {"rungs": [{"train_step": "0", "levels": {}}]}), "not the record"),
        (json.dumps(told | {"rungs": rungs[:-1]}), "weights and their record disagree"),
        (json.dumps(told | {"weights_sha256": "0" * 64}), "are of two trainings"),
        (json.dumps(told | {"rungs": [rung | {"levels": {}} for rung in rungs]}), "levels of a"),
    ):
        record.write_text(text)
        refused(match)
