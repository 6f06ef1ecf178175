"""verify, lock, merge, drop and diff as users type them: words, exit codes, JSON."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import h5py
import pytest

from mpdt.data.cli import main
from mpdt.data.lock.file import read_lock
from mpdt.data.verify import replay

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def simulated(fake_sim: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "make_batch", fake_sim.FakeBatch)


def change_yaml(old: str, new: str) -> None:
    path = Path("datasets.yaml")
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_verify_locked_as_the_manual_shows_it(tiny_file: Path, capsys: Capture) -> None:
    assert main(["collect", "tiny", "-q"]) == 0
    capsys.readouterr()
    assert main(["verify", "tiny.h5", "--locked", "-q"]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0] == "[PASS] format      mpdt/1, complete, contiguous"
    assert lines[1].startswith("[PASS] hash        36 digests, content ")
    assert lines[1].endswith(" = datasets.lock")
    assert lines[11].startswith("[PASS] replay      10 episodes, 50 steps byte-equal (mujoco ")
    assert lines[12] == "12 passed"
    assert err == ""


def test_a_failing_verify_says_so_everywhere(tiny_file: Path, capsys: Capture) -> None:
    with h5py.File("tiny.h5", "r+") as file:
        file["episodes/return"][3] = 0.5
    words = [
        "verify",
        "tiny.h5",
        "--skip",
        "replay,hash,claims",
        "--markdown",
        "v.md",
        "--json",
        "-q",
    ]
    assert main(words) == 1
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["summary"] == "8 passed, 1 failed"
    (failed,) = [one for one in found["checks"] if one["outcome"] == "FAIL"]
    assert (failed["id"], failed["episodes"]) == ("returns", [3])
    assert err.startswith("error: tiny.h5: 1 of 9 checks: returns\nhint:  mpdt-data show tiny.h5")
    page = Path("v.md").read_text()
    assert "| returns | FAIL | return is not the sum of the rewards: episode 3 |" in page
    assert str(Path.cwd()) not in page


def test_warnings_fail_only_if_asked(tiny_file: Path, capsys: Capture) -> None:
    with h5py.File("tiny.h5", "r+") as file:
        file.attrs["version"] = "1.0.0+smoke"
        file["episodes/quality"][12], file["episodes/progress"][12] = 3, 2.0
        del file["tta"]
    only = ["verify", "tiny.h5", "--only", "quality,tta", "-q"]
    assert main(only) == 1  # a progress of 2 is wrong in a smoke version too
    with h5py.File("tiny.h5", "r+") as file:
        file["episodes/progress"][12] = 0.0
        file["episodes/return"][0:4] = 9.0
    assert main(only) == 0
    out = capsys.readouterr().out
    assert "[WARN] quality     forward: random 9.0 is not below medium 2.5: episodes 0, 1" in out
    assert "0 passed, 1 warning, 1 with nothing to check" in out
    assert main([*only, "--fail-on", "warn"]) == 1


def test_verify_of_what_cannot_be_verified(workplace: Path, capsys: Capture) -> None:
    assert main(["verify", "none.h5"]) == 2
    assert "no such file" in capsys.readouterr().err
    assert main(["verify", "datasets.yaml"]) == 1
    out = capsys.readouterr().out
    assert "[FAIL] format      not an HDF5 file" in out
    assert "[SKIP] replay      builds on format" in out
    assert main(["verify", "datasets.yaml", "--only", "hsh"]) == 2
    assert "did you mean 'hash'" in capsys.readouterr().err


def test_lock_shows_and_checks(tiny_file: Path, capsys: Capture) -> None:
    assert main(["lock", "--check"]) == 0
    assert "tiny  -       not locked  -" in capsys.readouterr().out
    assert main(["collect", "tiny", "-q"]) == 0
    assert main(["collect", "tiny", "--smoke", "--update-lock", "-q", "--workers", "0"]) == 0
    capsys.readouterr()
    assert main(["lock", "--check"]) == 0
    out = capsys.readouterr().out
    assert "tiny        1.0.0        same  same" in out
    assert "tiny-smoke  1.0.0+smoke  same  same" in out
    change_yaml("expert: 4", "expert: 5")
    assert main(["lock"]) == 0  # only shows
    assert "changed" in capsys.readouterr().out
    assert main(["lock", "--check"]) == 1
    err = capsys.readouterr().err
    assert "the spec changed (episodes.expert 4 -> 5) but version is still 1.0.0" in err
    assert 'hint:  set version "1.1.0", then run: mpdt-data collect tiny' in err
    change_yaml("1.0.0", "1.1.0")
    assert main(["lock", "--check", "--json"]) == 1
    out, err = capsys.readouterr()
    assert "tiny: raised to 1.1.0, but 1.0.0 is locked" in err
    assert json.loads(out)["rows"][0]["spec"] == "raised to 1.1.0"


def test_lock_looks_at_files(tiny_file: Path, capsys: Capture) -> None:
    assert main(["collect", "tiny", "-q"]) == 0
    Path("tiny.h5").write_bytes(b"no")
    assert main(["lock", "--check"]) == 1
    assert "tiny.h5: not an HDF5 file" in capsys.readouterr().err
    Path("tiny.h5").unlink()
    assert main(["lock", "--check"]) == 0
    change_yaml("seed: 7", "seed: 8")
    assert (
        main(["collect", "tiny", "--spec", "datasets.yaml", "--tasks", "0", "-q", "--workers", "0"])
        == 0
    )
    change_yaml("seed: 8", "seed: 7")
    assert main(["lock", "--check"]) == 1
    assert "made from another spec (seed 7 -> 8; tasks" in capsys.readouterr().err
    change_yaml("  tiny:", "  small:")
    capsys.readouterr()
    assert main(["lock", "--check"]) == 0
    out = capsys.readouterr().out
    assert "small  -       not locked" in out
    assert "not in datasets.yaml" in out
    assert list(read_lock(Path("datasets.lock"))) == ["tiny"]


def test_editing_round(tiny_file: Path, capsys: Capture) -> None:
    for quality in ("random", "medium", "expert", "history"):
        assert main(["split", "tiny.h5", "--quality", quality]) == 0
    parts = [f"tiny-{quality}.h5" for quality in ("expert", "random", "history", "medium")]
    assert main(["merge", *parts, "-o", "all.h5"]) == 0
    capsys.readouterr()
    assert main(["diff", "tiny.h5", "all.h5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["same_content"] and not found["runs"] and not found["slices"]
    assert main(["drop", "tiny.h5", "--episodes", "0,2-3", "-o", "less.h5"]) == 0
    assert "3 dropped from tiny.h5" in capsys.readouterr().out
    assert main(["diff", "tiny.h5", "less.h5"]) == 0
    assert "forward  random      1       3       0        0" in capsys.readouterr().out
    assert main(["diff", "tiny.h5", "tiny.h5"]) == 0
    assert capsys.readouterr().out.startswith("equal: content ")
    assert main(["show", "less.h5"]) == 0
    out = capsys.readouterr().out
    assert "lineage  drop episodes 0 2 3   of " in out
    assert main(["verify", "less.h5", "-q"]) == 0
    assert main(["split", "tiny.h5", "--progress", "0.5:", "--quality", "history"]) == 0
    assert "tiny-history-p0.5-1.h5   4 episodes" in capsys.readouterr().out


def test_mistakes_in_editing(tiny_file: Path, capsys: Capture) -> None:
    assert main(["drop", "tiny.h5", "--episodes", "x", "-o", "o.h5"]) == 2
    assert "ids such as 3,17,40-49" in capsys.readouterr().err
    assert main(["merge", "tiny.h5", "-o", "o.h5"]) == 2
    assert main(["split", "tiny.h5", "--progress", "0.5"]) == 2
    assert not Path("o.h5").exists()
