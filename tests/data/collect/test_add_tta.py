"""A TTA set added later is the set collected at once; the fake simulator of two tasks."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import h5py
import msgspec
import pytest

from mpdt.data.cli import main
from mpdt.data.collect import add_tta as tta
from mpdt.data.collect.add_tta import Added, add_set, set_job
from mpdt.data.collect.collect import collect
from mpdt.data.collect.job import make_job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.runner import BlockRunner
from mpdt.data.sim.play import Acted, run_blocks
from mpdt.data.spec import entry
from mpdt.data.spec.entry import DatasetSpec, TtaRule
from mpdt.data.spec.goals import GoalSet
from mpdt.data.store.reader import open_dataset, open_tta_rewards
from mpdt.data.store.writer import check_digests
from mpdt.data.verify.verify import verify
from mpdt.errors import DataError, SpecError, StorageError, UsageError

Fakes = Callable[..., None]
WIDE = TtaRule(episodes=5, action_scale=3.0, horizon=4, preset_return=7.1, tasks="all")


def added(path: Path, name: str, rule: TtaRule, tasks: Sequence[str] = ()) -> Added:
    """The set in the file, made in this process."""
    dataset = open_dataset(path)
    return add_set(dataset, set_job(dataset, name, rule, tasks), workers=0)


def test_a_set_added_later_equals_one_collected_at_once(
    tiny_file: Path, tiny_spec: DatasetSpec, tmp_path: Path
) -> None:
    """Five episodes in blocks of three: two blocks per task."""
    both = msgspec.structs.replace(tiny_spec, tta=tiny_spec.tta | {"wide": WIDE})
    at_once = collect(make_job(both), tmp_path / "both.h5", workers=0).dataset
    before = open_dataset(tiny_file)
    later = added(tiny_file, "wide", WIDE).dataset
    assert later.tta["wide"].content_hash == at_once.tta["wide"].content_hash
    assert later.tta["default"].content_hash == before.tta["default"].content_hash
    assert later.content_hash == before.content_hash == at_once.content_hash
    rewards, _ = open_tta_rewards(tiny_file, "wide")
    assert rewards.tobytes() == open_tta_rewards(at_once.path, "wide")[0].tobytes()
    assert later.tta["wide"].seed_key.tolist()[:5] == [
        [0, 0, 4, 0, 0], [0, 0, 4, 0, 1], [0, 0, 4, 0, 2], [0, 0, 4, 1, 0], [0, 0, 4, 1, 1],
    ]  # fmt: skip
    check_digests(later)
    assert sorted(p.name for p in tiny_file.parent.iterdir() if p.is_dir()) == []
    assert not collect(make_job(tiny_spec), tiny_file, workers=0).is_new, (
        "the file is still complete"
    )


@pytest.mark.parametrize("tasks", ["test", "train"])
def test_goals_are_those_of_a_collection(
    fakes: Fakes, tiny_spec: DatasetSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    tasks: Literal["test", "train"],
) -> None:  # fmt: skip
    """Of six goals two are held out: rows of a test set draw from goals 4 and 5 in turn."""
    asked: list[int] = []

    def spy(env: Any, blocks: list[Acted], **options: Any) -> Any:
        for block in blocks:
            if block.quality == 4:
                asked.extend(key.row for key in block.goal_keys or ())
        return run_blocks(env, blocks, **options)

    monkeypatch.setattr("mpdt.data.collect.runner.run_blocks", spy)
    monkeypatch.setattr(entry, "find_problems", lambda spec: [])  # the cheetah has no goal sets
    rule = msgspec.structs.replace(WIDE, tasks=tasks)
    spec = msgspec.structs.replace(tiny_spec, goals=GoalSet(count=6, held_out=2), tta={})
    made = tmp_path / "x.h5"
    collect(
        make_job(msgspec.structs.replace(spec, tta={"wide": rule})), tmp_path / "y.h5", workers=0
    )
    at_once, asked[:] = list(asked), []
    collect(make_job(spec), made, workers=0)
    added(made, "wide", rule)
    assert asked == at_once == {"test": [4, 5, 4, 5, 4], "train": [0, 1, 2, 3, 0]}[tasks] * 2


def test_a_role_that_no_task_has(tiny_file: Path, tiny_spec: DatasetSpec) -> None:
    dataset = open_dataset(tiny_file)
    spec = msgspec.to_builtins(msgspec.structs.replace(tiny_spec, test=("backward",)))
    split = replace(dataset, spec=spec)
    assert {b.task.name for b in set_job(split, "x", TtaRule(episodes=1)).plan.blocks} == {
        "backward"
    }
    with pytest.raises(UsageError, match="no test task in this file"):
        set_job(split, "x", TtaRule(episodes=1), ["forward"])


def test_an_interrupted_addition_goes_on(tiny_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, blocks = tiny_file.read_bytes(), []
    call = BlockRunner.__call__

    def stop_at_third(self: BlockRunner, block: object) -> object:
        blocks.append(block)
        if len(blocks) == 3:
            raise KeyboardInterrupt
        return call(self, block)  # type: ignore[arg-type]

    monkeypatch.setattr(BlockRunner, "__call__", stop_at_third)
    with pytest.raises(KeyboardInterrupt):
        added(tiny_file, "wide", WIDE)
    assert tiny_file.read_bytes() == before
    other = msgspec.structs.replace(WIDE, horizon=3)
    with pytest.raises(DataError, match="horizon 4 -> 3") as caught:
        added(tiny_file, "wide", other)
    assert "--restart" in caught.value.hint
    added(tiny_file, "wide", WIDE)
    assert len(blocks) == 3 + 2, "two of four blocks were done"


def test_the_same_set_may_be_made_again_another_one_needs_a_word(tiny_file: Path) -> None:
    before = open_dataset(tiny_file).tta["default"].content_hash
    assert main(["tta", str(tiny_file), "--workers", "0", "-q"]) == 0
    assert open_dataset(tiny_file).tta["default"].content_hash == before
    for words in (["--episodes", "3"], ["--preset-return", "3.25"], ["--tasks", "forward"],
                  ["--action-scale", "2"]):  # fmt: skip
        assert main(["tta", str(tiny_file), "--workers", "0", "-q", *words]) == 2
    assert open_dataset(tiny_file).tta["default"].content_hash == before
    words = ["--workers", "0", "-q", "--episodes", "3", "--overwrite"]
    assert main(["tta", str(tiny_file), *words]) == 0
    assert len(open_dataset(tiny_file).tta["default"]) == 6


def test_single_tasks_and_what_is_printed(
    tiny_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["tta", str(tiny_file), "--name", "one", "--tasks", "backward", "--episodes", "2",
             "--preset-return", "0.1", "--workers", "0", "--json"]  # fmt: skip
    assert main([*words, "--dry-run"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 2
    assert "one" not in open_dataset(tiny_file).tta
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    added = open_dataset(tiny_file).tta["one"]
    assert found["content_hash"] == added.content_hash and found["steps"] == 10
    assert added.task.tolist() == [1, 1]
    assert main(words) == 0, "0.1 is stored as float32"


def test_too_little_room_is_told_without_an_option_that_is_none(
    tiny_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = tiny_file.read_bytes()
    usage = shutil.disk_usage(tiny_file)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1000))
    with pytest.raises(StorageError, match="not enough room") as caught:
        added(tiny_file, "wide", WIDE)
    assert caught.value.hint == "free some space"
    assert tiny_file.read_bytes() == before


def test_mistakes(tiny_file: Path) -> None:
    with pytest.raises(SpecError, match=r"episodes: 0 is too small"):
        added(tiny_file, "x", msgspec.structs.replace(WIDE, episodes=0))
    with pytest.raises(UsageError, match="did you mean 'forward'"):
        added(tiny_file, "x", WIDE, ["forwart"])
    assert main(["tta", str(tiny_file), "--preset-return", "much"]) == 2
    foreign = replace(open_dataset(tiny_file), spec={})
    with pytest.raises(DataError, match="does not say how it was made"):
        set_job(foreign, "x", WIDE)


def test_other_packages_are_mentioned(tiny_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = tta.provenance.packages()
    monkeypatch.setattr(tta.provenance, "packages", lambda: real | {"mujoco": "9.9.9"})
    done = added(tiny_file, "x", WIDE)
    assert [w.split(",")[0] for w in done.warnings] == ["made with mujoco 9.9.9"]


def test_the_lock_does_not_mind_a_set_beside_its_own(
    tiny_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unless it is one of its own that was replaced."""
    assert main(["collect", "tiny", "--workers", "0", "-q"]) == 0  # adds the lock
    locked = Path("datasets.lock").read_bytes()
    words = ["tta", "tiny.h5", "--workers", "0", "-q", "--episodes", "3"]
    assert main([*words, "--name", "more"]) == 0
    assert main(["collect", "tiny", "--locked", "--workers", "0", "-q"]) == 0
    assert main(["verify", "tiny.h5", "--locked", "--only", "hash,tta", "-q"]) == 0
    assert main(["lock", "--check", "-q"]) == 0
    assert main(["collect", "tiny", "--update-lock", "--workers", "0", "-q"]) == 0
    assert b"more" not in Path("datasets.lock").read_bytes()
    Path("datasets.lock").write_bytes(locked)
    assert main([*words, "--overwrite"]) == 0
    assert main(["lock", "--check", "-q"]) == 1
    assert main(["verify", "tiny.h5", "--locked", "--only", "hash", "-q"]) == 1


def test_the_same_set_again_leaves_every_byte_and_simulates_nothing(
    tiny_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert added(tiny_file, "wide", WIDE).is_new
    before = tiny_file.read_bytes()
    left = PartsFolder(tiny_file.with_name("tiny.h5.tta-wide")).path
    (left / "blocks").mkdir(parents=True)  # killed just before it went
    monkeypatch.setattr(tta, "run_missing", None)
    assert not added(tiny_file, "wide", WIDE).is_new
    assert tiny_file.read_bytes() == before and not left.exists()


def test_a_damaged_set_is_made_again_and_blocks_of_another_stay(tiny_file: Path) -> None:
    added(tiny_file, "wide", WIDE)
    left = PartsFolder(tiny_file.with_name("tiny.h5.tta-wide"))
    with left.locked():
        left.agree({"another": "plan"})  # of a set with --overwrite that was interrupted
    assert not added(tiny_file, "wide", WIDE).is_new and left.path.is_dir()
    shutil.rmtree(left.path)
    with h5py.File(tiny_file, "r+") as file:
        file["tta/wide/steps/actions"][0] = 5
    (found,) = (one for one in verify(tiny_file, only=("tta",)).findings if one.id == "tta")
    assert "--name wide --overwrite" in found.hint
    assert added(tiny_file, "wide", WIDE).is_new
    check_digests(open_dataset(tiny_file), sets=["wide"])
