"""Sixty modules that are no family, or not always: one clear error each, and nothing half-written.

Each is a file beside a datasets.yaml, and `mpdt-data collect mine` is typed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from own_families import forgotten

from mpdt.data.cli import main

MODULE = """
import numpy as np
import gymnasium
from gymnasium.spaces import Box
import mpdt
from own_families import Line, line, there

class Bad(Line):
    def __init__(self, task):
        super().__init__(task.goal[0])
{made}
    def reset(self, *, seed=None, options=None):
        seen, info = super().reset(seed=seed)
{reset}
        return seen, info
    def step(self, action):
        seen, reward, over, cut, info = super().step(action)
        if self.steps == 6:
            pass
{step}
        return seen, reward, over, cut, info

def act(seen, goals):
{act}
    return there(seen, goals)

family = line(name="mine", env=Bad, scripts={{"there": act}}, ends_early=False, {fields})
{after}
"""
YAML = """
schema: 1
families: {{mine: {family}}}
datasets:
  mine:
    {{version: "1.0.0", family: mine, horizon: {horizon}, seed: 1, block: 2, license: CC0-1.0,
     behaviour: {{script: there}}, reference: 2, episodes: {{random: 2, expert: 2}}, {more}}}
"""

STEP = "theirs:family, task left, step 5: "
RESET = "theirs:family, task left, reset: "
MAKING = "theirs:family, task left, making it: "
ACT = "theirs:family, script there, step "
FAMILY = "mine (theirs:family): "


def text(where: str, line: str, told: str) -> tuple[dict[str, str], str]:
    return {where: line}, told


CASES: dict[str, tuple[dict[str, str], str]] = {
    # The module.
    "does not import": text("after", "import nowhere", "theirs: cannot be imported: ModuleNotFo"),
    "divides by zero": text("after", "1 / 0", "theirs: cannot be imported: ZeroDivisionError"),
    "leaves": text("after", "raise SystemExit(3)", "theirs: cannot be imported: SystemExit: 3"),
    "is no Python": text("after", "def", "theirs: cannot be imported: SyntaxError"),
    "is not text": text("after", "x = '\0'", "theirs: cannot be imported: SyntaxError"),
    "wants a display": text("after", "raise OSError('no display :0')", "imported: OSError: no di"),
    "has no family": text("after", "del family", "theirs:family: no 'family' in it"),
    "has a number": text("after", "family = 3", "theirs:family: no family; expected a mpdt.Family"),
    "has a list": text("after", "family = [family]", "theirs:family: no family"),
    "has a maker that fails": text(
        "after", "def family(): raise KeyError('x')", "theirs:family: it raised KeyError: 'x'"
    ),
    "has a maker that gives none": text(
        "after", "def family(): pass", "theirs:family: no family"
    ),
    "recurses": text("after", "f = lambda: f()\nf()", "theirs: cannot be imported: RecursionError"),
    # What the family says of itself.
    "no unit": text("fields", 'columns=("x", "steps [1]")', FAMILY + "columns: 'x' is not"),
    "one column twice": text("fields", 'columns=("x [m]", "x [m]")', FAMILY + "columns: two of"),
    "no task": text("fields", "tasks=()", FAMILY + "tasks: 1 to 10,000"),
    "no training task": text(
        "fields", 'tasks=(mpdt.Task("a", 0, "test", (1.0,)),)', FAMILY + "tasks: none to train on"
    ),
    "goals of two lengths": text(
        "fields",
        'tasks=(mpdt.Task("a", 0, "train", (1.0,)), mpdt.Task("b", 1, "train", ()))',
        FAMILY + "tasks: goals of different lengths",
    ),
    "bounds that cross": text("fields", "action_low=2.0", FAMILY + "action_low: below action_high"),
    "a horizon of none": text("fields", "horizon=None", FAMILY + "horizon: a whole number"),
    "a scale of zero": text("fields", "return_scale=0.0", FAMILY + "return_scale: above 0"),
    "a target of infinity": text(
        "fields", 'return_target=float("inf")', FAMILY + "return_target: a finite number"
    ),
    "two simulators": text("fields", "batch=Bad", FAMILY + "env, vector, batch: exactly one"),
    "a hidden column too many": text(
        "fields", "hidden_columns=(9,)", FAMILY + "hidden_columns: a tuple of positions"
    ),
    "a version that is none": text("fields", 'version="1"', FAMILY + 'version: SemVer such as'),
    "options that are a list": text("fields", 'options=["a"]', FAMILY + "options: a frozenset"),
    "training that is none": text(
        "fields", "pretrain={'stepps': 3}", FAMILY + "pretrain: unknown key 'stepps'"
    ),
    # Its entries.
    "an unknown key": text("family", "{module: 'theirs:family', modul: 3}", "unknown key 'modul'"),
    "no module": text("family", "{}", "families.mine: module: expected module:name"),
    "a path for a module": text("family", "{module: theirs.py}", "module: expected module:name"),
    "an entry that is text": text("family", "theirs", "families.mine: expected a block of keys"),
    "an option that it has not": text("more", "env: {wind: 2}", "env.wind: unknown key 'wind'"),
    "a task that it has not": text("more", "tasks: [middle]", "tasks: unknown task 'middle'"),
    "a script that it has not": text(
        "after",
        "import dataclasses\nfamily = dataclasses.replace(family, scripts={'other': act})",
        "no such script for this family; expected other"
    ),
    # Making it.
    "made of nothing": text("made", "        1 / 0", MAKING + "the environment raised; found Ze"),
    "another observation space": text(
        "made", "        self.observation_space = Box(-1, 1, (5,))", MAKING + "another observation"
    ),
    "another action space": text(
        "made", "        self.action_space = Box(-1, 1, (2,))", MAKING + "another action space"
    ),
    "other bounds": text(
        "made", "        self.action_space = Box(-3, 3, (1,))", MAKING + "other action bounds"
    ),
    "no environment": text("after", "vars(family)['env'] = lambda task: 3", MAKING + "no gymnas"),
    "a name of nothing": text(
        "after", "vars(family)['env'] = 'theirs:nothing'", MAKING + "the environment raised"
    ),
    # Its reset.
    "reset raises": text("reset", "        raise OSError('a b')", RESET + "the environment raised"),
    "reset gives a list": text("reset", "        seen = [0.0, 0.0]", RESET + "the observation"),
    "reset gives NaN": text("reset", "        seen = seen * np.nan", RESET + "a number of the obs"),
    "reset gives three": text("reset", "        seen = np.zeros(3)", RESET + "an observation of"),
    "reset gives text": text("reset", "        seen = np.array(['a', 'b'])", RESET + "the observ"),
    "reset gives no info": text("reset", "        return seen", RESET + "the observation"),
    # Its step.
    "step raises": text("step", "            raise ValueError('x')", STEP + "the env"),
    "step leaves": text("step", "            raise SystemExit(0)", STEP + "the env"),
    "another shape": text("step", "            seen = np.zeros(3)", STEP + "an observation"),
    "another type": text("step", "            seen = seen.astype('f4')", STEP + "an observation"),
    "NaN": text("step", "            seen = seen * np.nan", STEP + "a number of the observation"),
    "a reward of infinity": text("step", "            reward = np.inf", STEP + "a number of the"),
    "a reward of none": text("step", "            reward = None", STEP + "the reward is no number"),
    "a reward in an array": text("step", "            reward = np.ones(2)", STEP + "the reward is"),
    "four values": text("step", "            return seen, reward, over, info", STEP + "the env"),
    "a limit of its own": text("step", "            cut = True", "a time limit of its own"),
    "an end where none is": text("step", "            over = True", STEP + "the episode ends here"),
    "no success": (
        {"step": "            info.clear()", "fields": "has_success=True"},
        STEP + "the environment raised; found KeyError: 'success'",
    ),
    # Its script.
    "a script that raises": text("act", "    1 / 0", ACT + "0: the script raised; found ZeroDiv"),
    "a script of two": text("act", "    return np.zeros((len(seen), 2))", ACT + "0: the script"),
    "a script of NaN": text("act", "    return seen[:, :1] * np.nan", ACT + "0: the script"),
    "a script of none": text("act", "    return None", ACT + "0: the script"),
    "a script that tires": text(
        "act", "    if seen[0, 1] == 3:\n        return 1", ACT + "3: the script's actions are none"
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


def collect(folder: Path, parts: dict[str, str]) -> int:
    empty = dict.fromkeys(("made", "reset", "step", "act", "fields", "after"), "")
    (folder / "theirs.py").write_text(MODULE.format(**empty | parts))
    yaml = {"family": "{module: 'theirs:family'}", "more": "", "horizon": "8"} | parts
    (folder / "datasets.yaml").write_text(YAML.format(**yaml))
    return main(["collect", "mine", "--workers", "0", "--quiet"])


def test_the_module_behind_all_of_them_is_sound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert collect(tmp_path, {}) == 0 and (tmp_path / "mine.h5").exists()
    assert len(CASES) >= 60


@pytest.mark.parametrize("what", CASES)
def test_a_bad_module_is_one_error_and_nothing_is_written(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    parts, told = CASES[what]
    code = collect(tmp_path, parts)
    printed = capsys.readouterr()
    assert code in (2, 3), printed.err
    assert told in printed.err and "Traceback" not in printed.err and not printed.out
    assert printed.err.count("rror: ") - told.count("rror: ") <= 2, printed.err
    left = [path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    finished = {"theirs.py", "datasets.yaml"}
    if "script" in what and parts.get(
        "act"
    ):  # random episodes came before: whole blocks wait to go on from
        finished |= {"plan.json", *(path.name for path in left if path.suffix == ".npz")}
    assert {path.name for path in left} == finished
