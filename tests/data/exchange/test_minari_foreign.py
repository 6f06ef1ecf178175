"""Minari sets that others wrote: what is read of them, and what is wrong with them by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mpdt.data.store.dataset import Dataset

Make = Callable[..., Any]


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A set of reach as minari's own functions write it: float64, chunked."""
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "foreign"))
        buffers = []
        for first in (0.0, 100.0):
            rows = first + np.arange(4 * 39, dtype=np.float64).reshape(4, 39)
            rows[:, 36:] = 0
            buffers.append(
                EpisodeBuffer(
                    observations=rows, actions=np.full((3, 4), 0.5), rewards=[1.0, 2.0, 3.0],
                    terminations=[False] * 3, truncations=[False, False, True],
                    infos={"success": np.array([False, False, True, False])},
                )
            )  # fmt: skip
        patch.setattr("warnings.warn", lambda *args: None)  # about an eval_env
        minari.create_dataset_from_buffers(
            "other/reach-v0", buffers, action_space=spaces.Box(-1, 1, (4,)),
            observation_space=spaces.Box(-np.inf, np.inf, (39,)), algorithm_name="x",
            author="x", author_email="x", code_permalink="x", description="x",
        )  # fmt: skip
    return tmp_path / "foreign"


FOREIGN = ("--from", "minari", "--family", "ml10", "--task", "reach", "--horizon", 3)


def test_a_set_of_others(foreign: Path, imported: Make) -> None:
    data: Dataset = imported(foreign, *FOREIGN, "--quality", "medium")
    assert data.tasks.names == ("reach",) and data.episodes.quality.tolist() == [1, 1]
    assert data.episode(0).observations[1, :3].tolist() == [39, 40, 41]
    assert data.steps.successes is not None
    assert data.steps.successes.tolist() == [False, True, False] * 2
    assert data.steps.truncations.tolist() == [False, False, True] * 2
    assert data.spec["import"]["sources"][0]["name"] == "other/reach-v0"
    assert (data.episodes.progress == -1).all()


def changed(name: str, value: Any) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        del group[name]
        group[name] = value

    return change


def in_parts(group: h5py.Group) -> None:
    del group["observations"]
    group["observations/achieved_goal"] = np.zeros((4, 39))


def linked_away(group: h5py.Group) -> None:
    del group["rewards"]
    group["rewards"] = h5py.ExternalLink("secret.h5", "/x")


def stored_away(group: h5py.Group) -> None:
    del group["rewards"]
    Path("secret").write_bytes(bytes(12))
    group.create_dataset("rewards", (3,), "<f4", external=[("secret", 0, 12)])


def source_gone(group: h5py.Group) -> None:
    del group["rewards"]
    layout = h5py.VirtualLayout((3,), "<f4")
    layout[:] = h5py.VirtualSource("gone.h5", "x", (3,), "<f4")
    group.create_virtual_dataset("rewards", layout)


def soft_link(group: h5py.Group) -> None:
    """As a path that looks like our own, through a group that is another file."""
    del group["rewards"]
    group["rewards"] = h5py.SoftLink("/far/rewards")


def second_name(group: h5py.Group) -> None:
    del group["rewards"]
    group["rewards"] = group["truncations"]


def unread_link(group: h5py.Group) -> None:
    group["notes/here"] = h5py.ExternalLink("secret.h5", "/x")


def nothing_stored(group: h5py.Group) -> None:
    del group["rewards"]
    group.create_dataset("rewards", (10_000_000_000,), "<f8", chunks=(1000,))


def own_filter(group: h5py.Group) -> None:
    """As a file says that was written with a plugin; this machine has none."""
    del group["rewards"]
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_chunk((3,))
    plan.set_filter(305, h5py.h5z.FLAG_OPTIONAL)
    group.create_dataset("rewards", (3,), "<f4", dcpl=plan)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (changed("rewards", np.full(3, np.nan)), "3 numbers in rewards are NaN"),
        (changed("rewards", np.zeros(2)), "wrong observations"),
        (changed("rewards", np.zeros(3, int)), "an array of floats"),
        (changed("rewards", np.array([b"x"] * 3)), "rewards is no array of numbers"),
        (changed("actions", np.full((3, 4), 2.0)), "12 numbers in actions outside the bounds"),
        (changed("observations", np.zeros((3, 39))), "expected shape (4, 39)"),
        (changed("observations", np.ones((4, 39))), "show the goal"),
        (changed("truncations", np.zeros(3, bool)), "found rows []"),
        (changed("terminations", np.array([0, 1, 0], bool)), "found rows [1, 2]"),
        (in_parts, "observations is no array of numbers; found a group"),
        (lambda group: group.__delitem__("actions"), "no actions"),
        (linked_away, "/episode_1/rewards is in another file; found secret.h5"),
        (stored_away, "rewards is in another file"),
        (source_gone, "rewards is in another file"),
        (soft_link, "/episode_1/rewards is a link"),
        (second_name, "/episode_1/truncations is a second name"),
        (unread_link, "/episode_1/notes/here is in another file; found secret.h5"),
        (nothing_stored, "rewards is larger than its file can hold; expected 80,000,000,000"),
        (own_filter, "rewards is behind a filter that is not HDF5's own; found filter 305"),
    ],
)
def test_wrong_sets_of_others(
    foreign: Path, run: Make, capsys: pytest.CaptureFixture[str],
    change: Callable[[h5py.Group], None], text: str,
) -> None:  # fmt: skip
    file = foreign / "other/reach-v0/data/main_data.hdf5"
    with h5py.File(file, "r+") as opened:
        change(opened["episode_1"])
    assert run("import", foreign, *FOREIGN, "-o", "x.h5") == 1
    error = capsys.readouterr().err
    assert text in error and "main_data.hdf5: " in error and "episode" in error


def test_metadata_that_is_none(
    foreign: Path, run: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = foreign / "other/reach-v0/data/metadata.json"
    metadata = json.loads(file.read_text())
    cases: list[tuple[object, str]] = [
        (metadata | {"total_episodes": 3}, "expected 3, found 2"),
        (metadata | {"total_episodes": 1}, "expected 1, found 2"),
        (metadata | {"data_format": "zarr"}, "expected data_format hdf5 or arrow, found zarr"),
        (metadata | {"data_format": "arrow"}, "expected 2, found 0"),
        (metadata | {"mpdt": {}}, "another storage format"),
        ([], "not the metadata of a Minari dataset"),
    ]
    for content, text in cases:
        file.write_text(json.dumps(content))
        assert run("import", foreign, *FOREIGN, "-o", "x.h5") == 1
        assert text in capsys.readouterr().err
    file.write_text(json.dumps(metadata))
    (tmp_path / "empty").mkdir()
    assert run("import", "empty", *FOREIGN, "-o", "x.h5") == 2
    assert run("import", foreign, *FOREIGN[:4], "-o", "x.h5") == 2
    assert "of which task?" in capsys.readouterr().err
    assert run("import", foreign, "--from", "minari", "-o", "x.h5") == 2
