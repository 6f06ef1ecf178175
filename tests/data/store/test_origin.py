"""Which command a hint names for a missing file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mpdt.data.store.origin import again_hint, damaged_hint, missing_hint
from mpdt.data.store.reader import open_dataset


@pytest.mark.parametrize(
    ("path", "hint"),
    [
        ("ml10.h5", "mpdt-data collect ml10"),
        ("data/ml10.h5", "mpdt-data collect ml10 -o data/ml10.h5"),
        ("my data/ml10.h5", "mpdt-data collect ml10 -o 'my data/ml10.h5'"),
        ("ml10.hdf5", "mpdt-data collect ml10 -o ml10.hdf5"),
        ("cheetah_dir-smoke.h5", "mpdt-data collect cheetah_dir --smoke"),
        ("d/ml10-smoke.h5", "mpdt-data collect ml10 --smoke -o d/ml10-smoke.h5"),
        ("d/ml10-medium.h5", "mpdt-data split d/ml10.h5 --quality medium"),
        ("own-expert.h5", "mpdt-data split own.h5 --quality expert"),
        ("d/ml01.h5", "did you mean d/ml10.h5? It is made by: mpdt-data collect ml10 -o d/ml10.h5"),
        ("walker.h5", "mpdt-data list shows what can be made"),
        ("walker-expert.h5", "mpdt-data list shows what can be made"),
    ],
)
def test_hints_by_name(
    path: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.h5").touch()
    assert missing_hint(Path(path)) == hint


def test_a_faulty_catalog_does_not_hide_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("datasets.yaml").write_text("{")
    assert missing_hint(Path("ml10.h5")) == "mpdt-data list shows what can be made"
    assert damaged_hint(Path("ml10.h5")) == "copy it again, or ask whoever made it"


def test_again_is_under_its_own_name(
    tiny_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What could be read of a file says how it was made, its name does not."""
    monkeypatch.chdir(tmp_path)
    data = replace(open_dataset(tiny_file), name="tiny-smoke", path=Path("rot.h5"))
    again = "collect it again: mpdt-data collect tiny --smoke -o rot.h5"
    assert damaged_hint(data.path, data) == f"copy it again, or move it away and {again}"
    assert again_hint(replace(data, path=Path("tiny-smoke.h5"))).endswith("collect tiny --smoke")
    told = damaged_hint(data.path, replace(data, name="theirs"))
    assert told == "copy it again, or move it away and ask whoever made it for another copy"
