"""Roll-outs in the formats of others, and back."""

from __future__ import annotations

import pytest

from mpdt.data.cli import main
from mpdt.data.slices.cut import Cut, cut_file
from mpdt.data.store.reader import open_dataset
from mpdt.data.verify.finding import Outcome
from mpdt.data.verify.verify import verify
from mpdt.train.fit.data import load_material

from .conftest import run


@pytest.fixture(scope="module")
def cut(trained, tmp_path_factory):
    """The better half of some roll-outs: a file that nobody has collected or rolled out whole."""
    folder = tmp_path_factory.mktemp("exports")
    words = ["rollout", trained, "-o", folder / "p.h5", "--episodes", 4, "--workers", 0, "-q"]
    assert run(*words) == 0
    return cut_file(open_dataset(folder / "p.h5"), Cut(return_top=0.5), folder / "best.h5")


@pytest.mark.parametrize("name", ["npz", "parquet", "minari"])
def test_nothing_is_lost_on_the_way_and_back(cut, name, tmp_path):
    assert main(["export", str(cut.path), "--to", name, "-o", str(tmp_path / "x"), "-q"]) == 0
    assert main(["import", str(tmp_path / "x"), "--from", name, "-o", str(tmp_path / "b.h5")]) == 0
    back = open_dataset(tmp_path / "b.h5")
    assert back.content_hash == cut.content_hash
    assert back.lineage == cut.lineage and back.tasks.references == cut.tasks.references
    assert back.policies.levels.tobytes() == cut.policies.levels.tobytes()
    assert verify(back.path, replay="all").count(Outcome.FAIL) == 0
    material = load_material(str(back.path), "auto")
    assert [len(ids) for ids in material.episode_ids.values()] == [2, 2], "to be trained on"


@pytest.mark.parametrize("name", ["d4rl", "promptdt"])
def test_what_comes_back_of_others_is_a_policy_s_still(cut, name, tmp_path):
    assert main(["export", str(cut.path), "--to", name, "-o", str(tmp_path / "x"), "-q"]) == 0
    words = ["import", str(tmp_path / "x"), "--from", name, "--family", "cheetah_dir",
             "--horizon", "9"]  # fmt: skip
    assert main([*words, "-o", str(tmp_path / "b.h5"), "-q"]) == 0
    back = open_dataset(tmp_path / "b.h5")
    assert len(back.select(quality="policy")) == back.num_episodes == cut.num_episodes
    assert back.episodes.returns.tolist() == cut.episodes.returns.tolist()
    assert load_material(str(back.path), "auto").quality == "policy"


def test_lerobot_has_every_step(cut, tmp_path):
    import pyarrow.parquet as parquet

    assert main(["export", str(cut.path), "--to", "lerobot", "-o", str(tmp_path / "x"), "-q"]) == 0
    (file,) = (tmp_path / "x" / "data").rglob("*.parquet")
    assert parquet.read_metadata(file).num_rows == cut.num_steps
