"""collect with the fake simulator: content by hand, quality check, refusals, cleanliness.

tiny: 2 tasks, horizon 5, block 3, 4 episodes of each quality, 3 rungs, 2 TTA, 2 of zero action.
Blocks per task: random 3+1, medium 3+1, expert 3+1, history rungs 2+1+1, tta 2, ref_zero 2 = 11.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mpdt.data.collect import levels
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.collect.plan import make_plan
from mpdt.data.reference import Reference, References
from mpdt.data.sim.record import (
    LOCAL_FILE,
    Entry,
    Score,
    constant_names,
    expert_name,
    place_of,
    save_entries,
)
from mpdt.data.spec.entry import Behaviour, DatasetSpec, EpisodeCounts
from mpdt.data.spec.smoke import smoke as smoke_of
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.errors import DataError, StorageError, UsageError
from mpdt.seeding import SeedKey

Fakes = Callable[..., None]


def test_the_file_holds_what_the_spec_asked_for(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    assert (data.name, data.version, data.family) == ("tiny", "1.0.0", "cheetah_dir")
    assert data.num_episodes == 2 * 4 * 4
    assert data.num_steps == 32 * 5
    # Canonical order: task, quality, block, row.
    assert data.episodes.task.tolist() == [0] * 16 + [1] * 16
    assert data.episodes.quality.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3] * 2
    assert data.episodes.seed_key[4:8].tolist() == [
        [0, 0, 1, 0, 0], [0, 0, 1, 0, 1], [0, 0, 1, 0, 2], [0, 0, 1, 1, 0],
    ]  # fmt: skip
    # expert acts goal and is paid goal * action: 5 steps of 1; medium half of it
    assert data.episodes.returns[8:12].tolist() == [5.0] * 4
    assert data.episodes.returns[20:24].tolist() == [2.5] * 4
    # history: two episodes of rung 0, one of rung 1 and 2
    assert data.episodes.progress[12:16].tolist() == [0.0, 0.0, 0.5, 1.0]
    assert data.episodes.returns[12:16].tolist() == [0.0, 0.0, 2.5, 5.0]


def test_observations_come_from_the_seed_key(tiny_file: Path) -> None:
    episode = open_dataset(tiny_file).episode(21)
    assert episode.seed_key == (0, 1, 1, 0, 1)
    seed = SeedKey(7, 0, 1, 1, 0, 1).env_seed()
    first = np.random.default_rng(seed).normal(size=20).astype(np.float32)
    assert episode.observations[0].tobytes() == first.tobytes()


def test_references_are_means_of_their_policies(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    assert data.tasks.ref_zero.tolist() == [0.0, 0.0]
    assert data.tasks.ref_expert.tolist() == [5.0, 5.0]
    random = data.episodes.returns[0:4].mean()
    assert data.tasks.ref_random[0] == random
    assert abs(random) < 1


def test_references_that_are_not_stored_are_run(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    spec = msgspec.structs.replace(tiny_spec, episodes=EpisodeCounts(medium=2))
    data = collect(make_job(spec), tmp_path / "x.h5", workers=0).dataset
    assert data.num_episodes == 4
    assert data.tasks.ref_expert.tolist() == [5.0, 5.0]
    assert np.isfinite(data.tasks.ref_random).all()
    assert data.tasks.ref_random[0] != 0


@pytest.mark.parametrize("same_expert", [True, False])
def test_references_on_record_are_stored_and_change_no_content(
    fakes: Fakes, tiny_spec: DatasetSpec, tiny_file: Path, tmp_path: Path, same_expert: bool
) -> None:
    """Of `forward` all is on record, maybe of an expert that does not act here.

    A constant action cannot be chosen: `backward` is a training task too and not on record.
    """
    job = make_job(tiny_spec)
    task = job.plan.tasks[0]
    place = place_of(tiny_spec, task, tiny_spec.horizon)
    expert = expert_name(job.ladder, task) if same_expert else "expert:0"
    scores = {name: Score(20, 0.25, 1.0) for name in constant_names(6)}
    scores |= {"random": Score(40, 0.125, 2.0), expert: Score(80, 4.5, 4.0, 0.5)}
    entry = Entry(scene=place[0], horizon=place[1], env={}, scores=scores, seed=1, versions={})
    save_entries(Path(LOCAL_FILE), [entry], "")  # the working folder
    data = collect(make_job(tiny_spec), tmp_path / "again.h5", workers=0).dataset
    before = open_dataset(tiny_file)
    assert data.content_hash == before.content_hash
    forward, backward = data.tasks.references
    assert forward["random"] == Reference(0.125, 2 / 40**0.5, 40, None, "local")
    wanted = Reference(4.5, 4 / 80**0.5, 80, 0.5, "local")
    assert forward["expert"] == (wanted if same_expert else before.tasks.references[0]["expert"])
    assert backward == before.tasks.references[1] and backward["expert"].source == "collected"
    assert not forward["constant"].is_known and forward.constant_action == ()


def test_tta_set_is_apart_and_unlabelled(tiny_file: Path) -> None:
    tta = open_dataset(tiny_file).tta["default"]
    assert tta.task.tolist() == [0, 0, 1, 1]
    assert tta.seed_key[:, 2].tolist() == [4] * 4
    assert tta.preset_return.tolist() == [1500.0] * 4  # the family's fixed target
    assert tta.rule == {"low": -1.0, "high": 1.0, "action_scale": 1.0, "horizon": 5}
    rewards, successes = open_tta_rewards(tiny_file, "default")
    assert successes is None
    paid = tta.actions[:5].astype(np.float64).mean(axis=1)  # goal +1 pays the mean action
    assert rewards[:5].tobytes() == paid.astype(np.float32).tobytes()


def test_wide_tta_actions_are_stored_as_drawn(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    rule = msgspec.structs.replace(tiny_spec.tta["default"], action_scale=3.0, horizon=4)
    spec = msgspec.structs.replace(tiny_spec, tta={"wide": rule})
    tta = collect(make_job(spec), tmp_path / "x.h5", workers=0).dataset.tta["wide"]
    assert 1.5 < np.abs(tta.actions).max() <= 3.0
    assert tta.length.tolist() == [4] * 4


def test_standard_slices_and_stats(tiny_file: Path) -> None:
    data = open_dataset(tiny_file)
    assert data.slices["expert"].tolist() == [8, 9, 10, 11, 24, 25, 26, 27]
    assert data.slices["train"].tolist() == data.slices["test"].tolist() == list(range(32))
    assert data.stats_info is not None and data.stats_info.tasks_seen == (0, 1)
    assert data.stats["actions"]["count"].tolist() == [160.0] * 6


def test_test_tasks_alone_are_kept_without_statistics(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in `collect ml10 --tasks drawer-open`. It was refused after everything was simulated."""
    monkeypatch.setattr("mpdt.data.spec.entry.find_problems", lambda spec: [])
    spec = msgspec.structs.replace(tiny_spec, tasks=("backward",), test=("backward",))
    data = collect(make_job(spec), tmp_path / "x.h5", workers=0).dataset
    assert (data.num_episodes, data.stats_info) == (16, None)
    assert "train" not in data.slices and len(data.slices["test"]) == 16


def test_parts_are_gone_and_nothing_else_is_left(tiny_file: Path, workplace: Path) -> None:
    assert sorted(path.name for path in workplace.iterdir()) == ["datasets.yaml", "tiny.h5"]


def test_another_seed_gives_another_hash(
    fakes: Fakes, tiny_file: Path, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    spec = msgspec.structs.replace(tiny_spec, seed=8)
    other = collect(make_job(spec), tmp_path / "other.h5", workers=0).dataset
    assert other.content_hash != open_dataset(tiny_file).content_hash


@pytest.mark.parametrize(("medium", "text"), [(0.9, "level 0.9"), (1.2, "not between")])
def test_qualities_out_of_order_write_nothing_and_keep_the_parts(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, medium: float, text: str
) -> None:
    fakes(medium)
    # rung 1 of history is the same policy, so only `medium` is at fault
    with pytest.raises(DataError, match=text) as caught:
        collect(make_job(tiny_spec), tmp_path / "x.h5", workers=0)
    assert "forward" in str(caught.value) and "backward" in str(caught.value)
    assert caught.value.exit_code == 1
    assert "behaviour.rungs (now 3;" in caught.value.hint and ".parts" in caught.value.hint
    assert not (tmp_path / "x.h5").exists()
    assert len(list((tmp_path / "x.h5.parts" / "blocks").iterdir())) == 22


def test_a_level_within_its_error_is_written_with_a_warning(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(levels, "level_error", lambda *returns: 0.15)
    fakes(0.9)  # 0.25 outside, less than twice 0.15
    done = collect(make_job(tiny_spec), tmp_path / "x.h5", workers=0)
    assert done.is_new and len(done.warnings) == 2
    assert "level 0.8" in done.warnings[0] and "+- 0.150" in done.warnings[0]


def test_scripts_are_sent_to_calibrate(tiny_spec: DatasetSpec) -> None:
    behaviour = Behaviour(script="metaworld")
    spec = msgspec.structs.replace(tiny_spec, family="ml10", behaviour=behaviour, tasks=("reach",))
    ends = References({"random": Reference(10.0, 0.0), "expert": Reference(110.0, 0.0)})
    bad = levels.TaskLevels("reach", ends, Reference(100.0, 1.0))
    with pytest.raises(DataError, match=r"level 0\.900 \+- 0\.010") as caught:
        levels.check_levels(make_plan(spec), {"reach": bad}, "x.h5.parts")
    assert caught.value.hint.startswith("mpdt-data calibrate tiny ")
    # An expert below random is no matter of rates, and least where no medium is asked for.
    ends = References({"random": Reference(10.0, 2.0), "expert": Reference(9.0, 2.0)})
    short = levels.TaskLevels("reach", ends, Reference())
    with pytest.raises(DataError, match=r"expert 9.0 is not above random 10.0") as caught:
        levels.check_levels(make_plan(spec), {"reach": short}, "x.h5.parts")
    assert caught.value.hint.startswith("more episodes ")
    assert "random 4, expert 4" in caught.value.hint and "calibrate" not in caught.value.hint


def test_a_smoke_version_only_warns(fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path) -> None:
    fakes(0.9)
    done = collect(make_job(smoke_of(tiny_spec)), tmp_path / "x.h5", workers=0)
    (warning,) = done.warnings
    assert warning.startswith("qualities of 2 of 2 tasks are not in order")
    assert "first forward: medium" in warning


def test_too_little_room_stops_before_anything_is_written(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.raises(StorageError, match="not enough room"):
        collect(make_job(tiny_spec), tmp_path / "x.h5", workers=0)
    assert not (tmp_path / "x.h5.parts").exists()


def test_a_missing_folder_is_an_error_not_a_new_folder(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    with pytest.raises(StorageError, match="does not exist"):
        collect(make_job(tiny_spec), tmp_path / "no" / "x.h5", workers=0)
    assert not (tmp_path / "no").exists()


def test_negative_workers(fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="negative"):
        collect(make_job(tiny_spec), tmp_path / "x.h5", workers=-1)


def test_no_global_generator_is_touched(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    import random

    def state() -> Any:
        return random.getstate(), np.random.get_state()[1].tobytes()  # noqa: NPY002

    before = state()
    collect(make_job(tiny_spec), tmp_path / "x.h5", workers=0)
    assert state() == before
