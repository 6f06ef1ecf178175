"""mpdt-data as users type it: exit codes, one clear error, results on stdout, talk on stderr."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from mpdt.data.cli import VERBS, main
from mpdt.data.spec.entry import DatasetSpec
from mpdt.data.store.reader import open_dataset

Capture = pytest.CaptureFixture[str]


def code_of(*words: str) -> int:
    """Exit code of main, whether it returns it or tyro raises it."""
    try:
        return main(words)
    except SystemExit as stop:
        return int(stop.code or 0)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("colect", "tiny"), 2, "unknown verb 'colect' (did you mean 'collect'?)"),
        (("collect", "tinny"), 2, "unknown dataset 'tinny' (did you mean 'tiny'?)"),
        (("collect", "tiny", "--tasks", "forwrd"), 2, "did you mean 'forward'"),
        (("collect", "tiny", "-o", "no/x.h5"), 1, "the folder does not exist"),
        (("collect",), 2, "NAME"),
        (("collect", "tiny", "--worker", "1"), 2, "--workers"),
        (("show", "nope.h5"), 2, "hint:  mpdt-data list"),
        (("show", "data/tiny.h5"), 2, "hint:  mpdt-data collect tiny -o data/tiny.h5\n"),
        (("collect", "tiny", "--spec", "."), 1, "a folder, not a file"),
        (("show", "datasets.yaml"), 1, "not an HDF5 file"),
        (("split", "--quality", "medium"), 2, "no dataset file here"),
        (("split", "--tasks", "forward", "tiny.h5"), 2, "put FILE before --tasks"),
        (("split", "--train", "--test"), 2, "--train and --test together"),
        (("list", "--dir", "nowhere"), 2, "no such folder"),
        ((), 2, "no verb; expected mpdt-data VERB"),
        (("--json", "list"), 2, "'--json' comes before the verb"),
        (("collect", "tiny", "--smok"), 2, "Perhaps you meant:"),
    ],
)
def test_mistakes_are_one_clear_error(
    fakes: Callable[..., None], workplace: Path, capsys: Capture, words: tuple[str, ...],
    code: int, text: str,
) -> None:  # fmt: skip
    assert code_of(*words) == code
    captured = capsys.readouterr()
    assert text in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""
    assert [path.name for path in workplace.iterdir()] == ["datasets.yaml"]


def test_verbose_shows_the_traceback(workplace: Path, capsys: Capture) -> None:
    assert code_of("show", "nope.h5", "-v") == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("verb", [None, *VERBS])
def test_help_has_three_examples(verb: str | None, capsys: Capture) -> None:
    words = ["-h"] if verb is None else [verb, "-h"]
    assert code_of(*words) == 0
    examples = re.findall(r"^  (mpdt-data \S.*)$", capsys.readouterr().out, re.MULTILINE)
    assert len(examples) >= 3
    assert verb is None or all(line.split()[1] == verb for line in examples)


def test_help_imports_no_numbers() -> None:
    code = (
        "import sys\nfrom mpdt.data.cli import main\n"
        "try:\n    main(['collect', '-h'])\nexcept SystemExit:\n    pass\n"
        "print({'numpy', 'h5py', 'mujoco', 'msgspec', 'rich'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_version(capsys: Capture) -> None:
    assert code_of("--version") == 0
    assert re.fullmatch(r"mpdt \d+\.\d+\.\d+\S*\n", capsys.readouterr().out)


def test_collect_prints_result_and_nothing_to_do(
    fakes: Callable[..., None], workplace: Path, capsys: Capture
) -> None:
    assert code_of("collect", "tiny", "--workers", "0") == 0
    out, err = capsys.readouterr()
    assert out.startswith("packed  tiny.h5   32 episodes   ")
    assert re.search(r"forward +both +16 +0\.0 ", out)
    assert "22/22 blocks  200 steps" in err
    assert code_of("collect", "tiny", "--workers", "0", "-q") == 0
    out, err = capsys.readouterr()
    assert out.startswith("nothing to do: complete  tiny.h5")
    assert err == ""


def test_collect_as_json(fakes: Callable[..., None], workplace: Path, capsys: Capture) -> None:
    assert code_of("collect", "tiny", "--workers", "0", "--json", "--tasks", "1") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["is_new"] is True
    assert [task["name"] for task in found["tasks"]] == ["backward"]
    assert found["tasks"][0]["returns"]["expert"] == 5.0
    assert found["content_hash"] == open_dataset("tiny.h5").content_hash


def test_plan_refuses_what_collect_refuses(workplace: Path, capsys: Capture) -> None:
    """Without the fakes: nobody can act by a network `fake`, or by 99 of 20 rungs."""
    text = (workplace / "datasets.yaml").read_text()
    many = text.replace("network: fake, rungs: 3", "network: cheetah_dir, rungs: 99")
    for yaml, what in ((text, "unknown behaviour network 'fake'"), (many, "found 99")):
        (workplace / "datasets.yaml").write_text(yaml)
        for words in (("plan", "tiny"), ("collect", "tiny", "--dry-run"), ("collect", "tiny")):
            assert code_of(*words) == 2
            captured = capsys.readouterr()
            assert what in captured.err and captured.out == ""


def test_plan_and_collect_tell_whose_rates_they_use(
    fakes: Callable[..., None], fake_sim: ModuleType, workplace: Path, capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(fake_sim.FakeLadder, "notice", "mixing rates of 2 tasks from ./x.json")
    for words in (("plan", "tiny"), ("collect", "tiny", "--workers", "0")):
        assert code_of(*words) == 0
        assert "mixing rates of 2 tasks from ./x.json\n" in capsys.readouterr().err


def test_dry_run_and_plan_write_nothing(
    fakes: Callable[..., None], workplace: Path, capsys: Capture
) -> None:
    for words in (("plan", "tiny"), ("collect", "tiny", "--dry-run")):
        assert code_of(*words, "--json", "--workers", "2") == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["blocks"], found["episodes"], found["tta_episodes"]) == (22, 32, 4)
        assert (found["steps"], found["target"]) == (200, "tiny.h5")
    assert code_of("plan", "tiny", "--smoke") == 0
    assert "tiny-smoke 1.0.0+smoke" in capsys.readouterr().out
    assert [path.name for path in workplace.iterdir()] == ["datasets.yaml"]


def test_another_spec_tells_what_changed(tiny_file: Path, workplace: Path, capsys: Capture) -> None:
    text = (workplace / "datasets.yaml").read_text()
    (workplace / "datasets.yaml").write_text(text.replace("expert: 4", "expert: 5"))
    assert code_of("collect", "tiny") == 1
    err = capsys.readouterr().err
    assert "episodes.expert 4 -> 5" in err
    assert "--restart" in err


def test_list_show_split_and_info(tiny_file: Path, workplace: Path, capsys: Capture) -> None:
    def run(*words: str) -> str:
        assert code_of(*words) == 0
        return capsys.readouterr().out

    assert run("split", "--quality", "medium").startswith("tiny-medium.h5   8 episodes   40 steps")
    (workplace / "bad.h5").write_text("x")
    rows = {row["file"]: row for row in json.loads(run("list", "--json"))["rows"]}
    assert {name: row["state"] for name, row in rows.items()} == {
        "tiny.h5": "ok", "tiny-medium.h5": "cut-out", "bad.h5": "damaged: not an HDF5 file",
    }  # fmt: skip
    assert "tiny-medium.h5" in run("list")
    shown = json.loads(run("show", "tiny.h5:expert", "--json", "--episodes", "2"))
    assert (shown["episodes"], [one["id"] for one in shown["listed"]]) == (8, [8, 9])
    assert shown["listed"][0]["return"] == 5.0
    text = run("show", "tiny.h5", "--tasks", "backward", "--episodes", "1")
    assert "backward" in text and not re.search(r"^forward ", text, re.MULTILINE)
    assert "0/1/0/0/0" in text
    assert "/steps/observations" in run("show", "tiny.h5", "--schema")
    assert run("split", "tiny.h5", "--quality", "expert", "--name", "best").startswith(
        "tiny.h5:best"
    )
    assert json.loads(run("info", "--json"))["packages"]["mujoco"]


def test_pretrain_and_calibrate_are_the_library_with_dashes(
    workplace: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[object, ...]] = []

    def pretrain(name: str, **options: object) -> Path:
        options.pop("on_progress")
        calls.append((name, options))
        return Path("weights/x.safetensors")

    def calibrate(spec: DatasetSpec, target: Path | None, **options: object) -> Path:
        calls.append((spec.name, target, options["seed"]))
        return Path("rates.json")

    # Stubs of whole modules: the real ones import torch and Meta-World.
    monkeypatch.setitem(sys.modules, "mpdt.data.sim.pretrain", stub(pretrain=pretrain))
    monkeypatch.setitem(sys.modules, "mpdt.data.sim.calibrate", stub(calibrate=calibrate))
    assert code_of("pretrain", "cheetah_dir", "--no-resume", "--steps", "9", "-o", "w") == 0
    assert code_of("calibrate", "tiny", "--seed", "4") == 0
    assert calls == [
        ("cheetah_dir", {"seed": 0, "steps": 9, "output": Path("w"), "resume": False}),
        ("tiny", None, 4),
    ]
    assert capsys.readouterr().out == "wrote  weights/x.safetensors\nwrote  rates.json\n"


def stub(**members: object) -> ModuleType:
    module = ModuleType("stub")
    vars(module).update(members)
    return module


def test_what_goes_on_does_not_begin_anew(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*words: object, **options: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("mpdt.data.sim.pretrain.pretrain", interrupted)
    assert code_of("pretrain", "cheetah_dir", "--no-resume", "--seed", "3") == 130
    assert "go on with: mpdt-data pretrain cheetah_dir --seed 3\n" in capsys.readouterr().err
