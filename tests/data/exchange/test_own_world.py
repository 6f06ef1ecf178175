"""Minari sets that record an environment: it simulates the family made of them, or is refused."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import mpdt
from mpdt.data.cli import main
from mpdt.data.sim.actors import ZeroPolicy
from mpdt.data.spec.family import definition, stored_family
from mpdt.data.spec.recorded import Recorded, problem
from mpdt.data.store.dataset import Dataset
from mpdt.data.verify.finding import Finding, Outcome
from mpdt.data.verify.verify import verify
from mpdt.errors import SimulatorError
from mpdt.seeding import UNKNOWN_SEED_KEY, Quality
from mpdt.train.evaluate.rollout import evaluate

Make = Callable[..., Any]
STEPS = 12
SEEDS = {"light": (0, 7), "heavy": (3, 2**63 + 1)}
HEAVY = "swing/heavy-random-v0"
GRAVITY = {"light": 2.0, "heavy": 9.0}


class Unsteady(gymnasium.Env[Any, Any]):
    """Pendulum's spaces; observations that no seed decides, or a global generator decides.

    The reward is minus the size of the action.
    """

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,))
    action_space = gymnasium.spaces.Box(-2, 2, (1,))

    def __init__(self, shared: bool = False) -> None:
        self._shared = shared

    def _seen(self) -> Any:
        draw = np.random.random(3) if self._shared else np.frombuffer(os.urandom(3), np.uint8)  # noqa: NPY002
        return draw.astype(np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        return self._seen(), -abs(float(action[0])), False, False, {}


class Strong(Unsteady):
    """With other bounds."""

    def __init__(self, endless: bool = False) -> None:
        super().__init__()
        self.action_space = gymnasium.spaces.Box(-np.inf if endless else -3, 3, (1,))


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    gymnasium.register("MpdtUnsteady-v0", Unsteady)
    gymnasium.register("MpdtStrong-v0", Strong)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mpdt.data.verify.family.SECONDS", 0.01)  # nobody reads the speed
        yield
    del gymnasium.registry["MpdtUnsteady-v0"], gymnasium.registry["MpdtStrong-v0"]


@pytest.fixture(scope="session")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two real sets of Pendulum-v1, of gravity 2 and 9, by minari itself."""
    import minari
    from minari.data_collector import EpisodeBuffer

    folder = tmp_path_factory.mktemp("pendulum")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        patch.setattr("warnings.warn", lambda *args, **more: None)  # about an eval_env
        for name, seeds in SEEDS.items():
            env = gymnasium.make("Pendulum-v1", g=GRAVITY[name], max_episode_steps=STEPS)
            env.action_space.seed(5)
            buffers = []
            for seed in seeds:
                seen, actions, rewards = [env.reset(seed=seed)[0]], [], []
                for _ in range(STEPS):
                    actions.append(env.action_space.sample())
                    found = env.step(actions[-1])
                    seen.append(found[0])
                    rewards.append(found[1])
                last = np.arange(1, STEPS + 1) == STEPS
                buffers.append(EpisodeBuffer(
                    seed=seed, observations=np.array(seen), actions=np.array(actions),
                    rewards=rewards, terminations=list(~last & False), truncations=list(last),
                ))  # fmt: skip
            minari.create_dataset_from_buffers(
                f"swing/{name}-random-v0", buffers, env=env, algorithm_name="uniform",
                author="x", author_email="x", code_permalink="x", description="x",
            )  # fmt: skip
    return folder


WORDS = ("--from", "minari", "--family-of", "swing", "--env")


def outcomes(data: Dataset, replay: str | None = "all") -> dict[str, Finding]:
    return {one.id: one for one in verify(data.path, replay=replay).findings}


def test_the_recorded_environment_simulates(
    sets: Path, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    data: Dataset = imported(sets, *WORDS)
    family = data.contract()
    assert family.simulates and family.exact and data.spec["horizon"] == family.horizon == STEPS
    assert (family.action_low, family.action_high) == (-2.0, 2.0)
    assert data.definition["environments"]["swing-heavy"] == {
        "id": "Pendulum-v1", "arguments": {"g": 9.0}
    }  # fmt: skip
    # Canonical order: heavy before light; the seeds stand in the spec, as text.
    assert data.spec["import"]["seeds"] == [["3", "9223372036854775809"], ["0", "7"]]
    assert data.episodes.seed_key[:, 2:].tolist() == [
        [Quality.RECORDED, 0, 0], [Quality.RECORDED, 0, 1],
        [Quality.RECORDED, 1, 0], [Quality.RECORDED, 1, 1],
    ]  # fmt: skip
    found = outcomes(data)
    assert found["replay"].outcome is Outcome.PASS
    assert found["replay"].text.startswith("4 episodes, 48 steps byte-equal")
    assert all(one.outcome is not Outcome.FAIL for one in found.values())
    references = data.tasks.references[0]
    assert references["zero"].episodes == references["random"].episodes == 100
    light = data.tasks.references[1]["zero"]  # of another gravity
    assert light.episodes == 100 and light.mean != references["zero"].mean
    assert references["zero"].source == "local" and not references["expert"].is_known
    # As training judges: what zero earns with other seeds is what it earned at the import.
    judged = evaluate(ZeroPolicy(1), family, [family.task("swing-heavy")], {}, STEPS, 40, 3, 40)
    error = references["zero"].error * np.sqrt(1 + 100 / 40)
    assert abs(judged.returns.mean() - references["zero"].mean) < 4 * error
    assert main(["tta", str(data.path)]) == 1
    assert "nothing more is made of a family that an import made" in capsys.readouterr().err
    # Cut-outs and lossless exports keep the seeds of their episodes.
    assert main(["export", str(data.path), "--to", "npz", "-o", "out"]) == 0
    assert main(["import", "out", "--from", "npz", "-o", "back.h5"]) == 0
    assert outcomes(mpdt.open("back.h5"))["replay"].text.startswith("4 episodes, 48 steps byte")
    assert main(["split", str(data.path), "--tasks", "swing-light", "-o", "one.h5"]) == 0
    assert outcomes(mpdt.open("one.h5"))["replay"].text.startswith("2 episodes, 24 steps byte")


def test_sets_of_arrow_files_too(sets: Path, tmp_path: Path, imported: Make) -> None:
    """With a seed of all 64 bits, which no other whole number in JSON may have."""
    import minari
    from minari.data_collector import EpisodeBuffer

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *args, **more: None)
        patch.setenv("MINARI_DATASETS_PATH", str(sets))
        known = minari.load_dataset("swing/heavy-random-v0")
        buffers = [
            EpisodeBuffer(
                seed=seed, observations=one.observations, actions=one.actions,
                rewards=list(one.rewards), terminations=list(one.terminations),
                truncations=list(one.truncations),
            )
            for seed, one in zip(SEEDS["heavy"], known.iterate_episodes(), strict=True)
        ]  # fmt: skip
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "arrow"))
        env = gymnasium.make("Pendulum-v1", g=9.0, max_episode_steps=STEPS)
        minari.create_dataset_from_buffers(
            "swing/heavy-random-v0", buffers, env=env, algorithm_name="uniform", author="x",
            author_email="x", code_permalink="x", description="x", data_format="arrow",
        )  # fmt: skip
    data: Dataset = imported(tmp_path / "arrow", *WORDS)
    assert outcomes(data)["replay"].text.startswith("2 episodes, 24 steps byte-equal")


def test_a_horizon_that_is_said_comes_before_the_recorded_limit(sets: Path, imported: Make) -> None:
    assert imported(sets, *WORDS, "--horizon", STEPS + 1).contract().horizon == STEPS + 1


def test_without_asking_all_stays_as_it_was(sets: Path, imported: Make) -> None:
    data: Dataset = imported(sets, *WORDS[:-1])
    assert not data.contract().simulates and "environments" not in data.definition
    assert (data.episodes.seed_key == UNKNOWN_SEED_KEY[0]).all()
    assert "seeds" not in data.spec["import"]
    assert outcomes(data, None)["replay"].outcome is Outcome.NONE


def altered(sets: Path, folder: Path, what: str = HEAVY, **changes: Any) -> Path:
    """A copy of `what`, in which the set of heavy records another environment."""
    import shutil

    shutil.copytree(sets / what, folder / "sets" / what)
    path = folder / "sets" / HEAVY / "data/metadata.json"
    metadata = json.loads(path.read_text())
    spec = json.loads(metadata["env_spec"]) | changes
    metadata["env_spec"] = json.dumps(spec) if changes.get("id", "") is not None else None
    path.write_text(json.dumps(metadata))
    return folder / "sets"


def test_another_gravity_than_the_data_is_found(sets: Path, tmp_path: Path, imported: Make) -> None:
    data = imported(altered(sets, tmp_path, kwargs={"g": 9.5}), *WORDS)
    found = outcomes(data)["replay"]
    assert found.outcome is Outcome.WARN and "other observations and rewards" in found.text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"id": "mpdt_never:Pendulum-v1"}, "would import the module 'mpdt_never'"),
        ({"id": "../Pendulum-v1"}, "is no id"),
        ({"id": "MpdtNowhere-v0"}, "no environment MpdtNowhere-v0 here"),
        ({"id": None}, "the set records no environment"),
        ({"kwargs": {"xml_file": "/etc/passwd"}}, "argument xml_file is"),
        ({"kwargs": {"g": {"a": 1}}}, "argument g is"),
        ({"kwargs": {"g": 1e7}}, "numbers up to 1,000,000"),
        ({"kwargs": {"max_episode_steps": 3}}, "is none of an environment"),
        ({"kwargs": {"weight": 3}}, "the environment cannot be made"),
        ({"additional_wrappers": [{"name": "x", "entry_point": "os:system", "kwargs": {}}]},
         "the code of wrappers"),
        ({"id": "MountainCarContinuous-v0", "kwargs": {}}, "other observations than the data"),
        ({"id": "CartPole-v1", "kwargs": {}}, "other observations than the data"),
        ({"max_episode_steps": 11}, "no time limit that holds for all"),
        ({"id": "MpdtStrong-v0", "kwargs": {"endless": True}}, "one pair of bounds"),
        ({"id": "MpdtUnsteady-v0", "kwargs": {"shared": True}}, "breaks the rule `globals`"),
    ],
)  # fmt: skip
def test_what_is_refused(
    sets: Path,
    tmp_path: Path,
    run: Make,
    capsys: pytest.CaptureFixture[str],
    changes: dict[str, Any],
    said: str,
) -> None:
    assert run("import", altered(sets, tmp_path, **changes), *WORDS, "-o", "x.h5") in (1, 2, 3)
    error = " ".join(capsys.readouterr().err.split())
    assert said in error and error.count("error:") == 1
    assert not Path("x.h5").exists() and "mpdt_never" not in sys.modules


@pytest.mark.parametrize(
    ("changes", "words", "said"),
    [
        ({"max_episode_steps": 13}, (), "no time limit that holds for all"),
        ({"id": "MpdtStrong-v0", "kwargs": {}}, (), "tasks with different bounds of actions"),
        ({}, ("--task", "all"), "two environments of task all"),
    ],
)
def test_sets_that_disagree(
    sets: Path,
    tmp_path: Path,
    run: Make,
    capsys: pytest.CaptureFixture[str],
    changes: dict[str, Any],
    words: tuple[str, ...],
    said: str,
) -> None:
    both = altered(sets, tmp_path, "swing", **changes)
    assert run("import", both, *WORDS, *words, "-o", "x.h5") == 1
    assert said in " ".join(capsys.readouterr().err.split())


def test_what_no_seed_decides_is_not_replayed(
    sets: Path, tmp_path: Path, imported: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    data = imported(altered(sets, tmp_path, id="MpdtUnsteady-v0", kwargs={}), *WORDS)
    assert "swing is not exact, so nothing is replayed" in capsys.readouterr().err
    assert data.contract().simulates and not data.contract().exact
    # Actions between the environment's own bounds -2 and 2 are of size 1 in the mean.
    means = {name: data.tasks.references[0][name].mean for name in ("zero", "random")}
    assert means == {"zero": 0, "random": pytest.approx(-STEPS, rel=0.1)}
    found = outcomes(data, None)["replay"]
    assert found.outcome is Outcome.NONE and "swing says exact: false" in found.text


def test_a_file_chooses_among_what_is_registered(
    sets: Path, imported: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    data: Dataset = imported(sets, *WORDS)
    monkeypatch.delitem(gymnasium.registry, "Pendulum-v1")
    assert not data.contract().simulates
    found = outcomes(data, None)["replay"]
    assert found.outcome is Outcome.WARN and "no environment Pendulum-v1 here" in found.text
    told = definition(data.contract())
    assert stored_family(told).env == Recorded.of(told["environments"])
    for id in ("os:system", "Pendulum-v1/../..", 3):
        told["environments"]["swing-heavy"]["id"] = id
        with pytest.raises(ValueError, match="task swing-heavy"):
            stored_family(told)
    assert problem("Pendulum-v1", {"g": [1.0, True, None]}) and not problem("A/B-v1", {"g": [1, 2]})


def test_packages_are_named_by_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPDT_GYMNASIUM", "json, mpdt_never")
    with pytest.raises(SimulatorError, match="MPDT_GYMNASIUM=mpdt_never"):
        Recorded.of({"a": {"id": "Pendulum-v1", "arguments": {}}}).missing()


def test_words_that_do_not_go_together(run: Make, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("import", "a", "--from", "npz", "--family-of", "a", "--env", "-o", "x.h5") == 2
    assert "npz names no environment" in capsys.readouterr().err
    assert run("import", "a", "--from", "minari", "--env", "-o", "x.h5") == 2
    assert "add --family-of NAME" in capsys.readouterr().err
