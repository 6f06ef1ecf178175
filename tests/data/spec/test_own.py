"""One's own families: what is refused, in which words, and that nothing a file says is imported."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import pytest
from own_families import LINE, TASKS, forgotten, line, make

import mpdt
from mpdt.data.spec.catalog import parse_catalog
from mpdt.data.spec.family import OWN_IDS, definition, stored_family
from mpdt.data.spec.own import family_of, load_family
from mpdt.data.spec.tasks import FAMILIES, get_family
from mpdt.errors import SpecError, UsageError

TASK = mpdt.Task("left", 0, "train", (1.0,))


@pytest.fixture(autouse=True)
def forget() -> Any:
    with forgotten():
        yield


BROKEN: list[tuple[dict[str, Any], str]] = [
    ({"name": ""}, "name '': letters"),
    ({"name": "a/b"}, "name 'a/b': letters"),
    ({"name": "ml10"}, "mpdt has a family of that name"),
    ({"tasks": ()}, "tasks: 1 to 10,000, found 0"),
    ({"tasks": [TASK]}, "tasks: a tuple of mpdt.Task"),
    ({"tasks": (TASK, TASK)}, "tasks: two of the name 'left'"),
    ({"tasks": (mpdt.Task("left", 1, "train", ()),)}, "'left' has index 1 at position 0"),
    ({"tasks": (mpdt.Task("a b", 0, "train", ()),)}, "'a b' cannot name a task"),
    ({"tasks": (mpdt.Task("a", 0, "training", ()),)}, "role 'training': train, test or both"),
    ({"tasks": (mpdt.Task("a", 0, "test", ()),)}, "tasks: none to train on"),
    ({"tasks": (mpdt.Task("a", 0, "both", (float("nan"),)),)}, "no tuple of finite numbers"),
    ({"tasks": (TASK, mpdt.Task("b", 1, "both", ()))}, "goals of different lengths"),
    ({"columns": ()}, "columns: a tuple of 1 to"),
    ({"columns": ("x",)}, r"columns: 'x' is not `name \[unit\]`"),
    ({"columns": ("x [m]", "x [m]")}, "columns: two of one name"),
    ({"hidden_columns": (2,)}, "hidden_columns: a tuple of positions from 0 to 1"),
    ({"action_size": 0}, "action_size: a whole number from 1"),
    ({"action_size": 1.0}, "action_size: a whole number from 1"),
    ({"horizon": 0}, "horizon: a whole number from 1 to 100,000"),
    ({"action_low": float("-inf")}, "action_low: a finite number, found -inf"),
    ({"action_low": 1.0}, "action_low: below action_high, found 1.0 and 1.0"),
    ({"step_s": 0.0}, "step_s: above 0"),
    ({"return_scale": -1.0}, "return_scale: above 0"),
    ({"return_target": None}, "return_target: a finite number, found None"),
    ({"version": "1"}, 'version: SemVer such as "1.0.0"'),
    ({"env": None}, "exactly one of them, found none"),
    ({"batch": make}, "exactly one of them, found env, batch"),
    ({"env": "nowhere"}, "env: a function or `module:name`, found 'nowhere'"),
    ({"inputs": 3}, "inputs: a function or `module:name`, found 3"),
    ({"scripts": {"a b": make}}, "scripts: 'a b' cannot name a script"),
    ({"options": {"ends"}}, "options: a frozenset of names"),
    ({"policy_rows": 0}, "policy_rows: 1 or more"),
]


@pytest.mark.parametrize(("changes", "what"), BROKEN, ids=[what[:40] for _, what in BROKEN])
def test_what_the_contract_does_not_allow(changes: dict[str, Any], what: str) -> None:
    before = dict(FAMILIES)
    with pytest.raises(SpecError, match=what):
        mpdt.register_family(line(**changes))
    assert before == FAMILIES


def test_a_registered_family_is_known_and_travels_by_name() -> None:
    known = mpdt.register_family(line())
    assert get_family("line") is known and known.module == __name__
    assert OWN_IDS <= known.id < 2**32 - 1 and known.id == line().id != line(name="other").id
    assert pickle.loads(pickle.dumps(known)) is known
    assert mpdt.register_family(line(horizon=9)).horizon == 9  # the same module says it anew
    with pytest.raises(SpecError, match="two families of one name"):
        load_family("line", {"module": "own_families:line"}, "")


MODULE = "from own_families import line\nfamily = line\nnumber = 3\n"
YAML = "schema: 1\nfamilies:\n  {}\ndatasets: {{}}\n"


@pytest.mark.parametrize(
    ("entry", "what"),
    [
        ("mine: 3", "families.mine: expected a block of keys"),
        ("mine: {}", "module: expected module:name, found None"),
        ("mine: {module: theirs}", "module: expected module:name, found 'theirs'"),
        ("mine: {modul: 'theirs:family'}", r"unknown key 'modul' \(did you mean 'module'\?\)"),
        ("mine: {module: 'theirs:family', scripts: {a: b}}", "a: expected module:name, found 'b'"),
        ("mine: {module: 'theirs:family', scripts: 3}", "scripts: expected a block of names"),
        ("mine: {module: 'absent:family'}", "cannot be imported: ModuleNotFoundError"),
        ("mine: {module: 'raises:family'}", "cannot be imported: ZeroDivisionError"),
        ("mine: {module: 'leaves:family'}", "cannot be imported: SystemExit: 7"),
        ("mine: {module: 'typo:family'}", "cannot be imported: SyntaxError"),
        ("mine: {module: 'theirs:familie'}", r"no 'familie' in it \(did you mean 'family'\?\)"),
        ("mine: {module: 'random:family'}", r"what was imported is .*random\.py"),
        ("mine: {module: './theirs.py:family'}", "not a file's: theirs:family"),
        ("mine: {module: 'theirs:number'}", "no family; expected a mpdt.Family"),
        ("mine: {module: 'fails:family'}", "it raised OSError: no display"),
        ("mine: {module: 'wrong:family'}", "a finite number, found nan"),
        ("ml10: {module: 'theirs:family'}", "mpdt has a family of that name"),
        ("'a/b': {module: 'theirs:family'}", "name 'a/b': letters"),
        (
            "mine: {module: 'theirs:family'}\n  mine: {module: 'theirs:family'}",
            "repeated key; found .mine.",
        ),
    ],
)
def test_an_entry_that_gives_no_family(entry: str, what: str, tmp_path: Path) -> None:
    files = {
        "theirs": MODULE, "raises": "1 / 0", "leaves": "raise SystemExit(7)", "typo": "def",
        "fails": "def family():\n    raise OSError('no display')\n",
        "wrong": "from own_families import line\nfamily = line(step_s=float('nan'))\n",
    }  # fmt: skip
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text)
    before = dict(FAMILIES)
    with pytest.raises(SpecError) as error:
        parse_catalog(YAML.format(entry), str(tmp_path / "datasets.yaml"))
    assert re.search(what, f"{error.value}\n{error.value.hint}")
    assert before == FAMILIES


def test_a_broken_family_is_told_once_and_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text(
        "from own_families import line\nfamily = line(action_size=0, columns=())\n"
    )
    entry = """{version: "1.0.0", family: mine, horizon: 5, seed: 1, block: 5, license: CC0-1.0,
      behaviour: {script: there}, episodes: {random: 5}}"""
    text = YAML.format("mine: {module: 'wrong:family'}").replace(
        "{}", f"\n  a: {entry}\n  b: {entry}"
    )
    with pytest.raises(SpecError) as error:
        parse_catalog(text, str(tmp_path / "datasets.yaml"))
    (shown,) = error.value.render().split("\nhint:")[:1]
    assert shown.count("\n") == shown.count("\\n") == 0
    assert re.search("families.mine: mine .*: 2 things .*: columns: .*; action_size:", shown)


def test_a_module_beside_the_yaml_is_a_family_wherever_the_command_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "theirs.py").write_text(MODULE)
    text = YAML.format("mine: {module: 'theirs:family', scripts: {also: 'own_families:there'}}")
    (tmp_path / "datasets.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    found = get_family("mine")  # no catalog was read
    assert (found.name, found.module, found.horizon) == ("mine", "theirs:family", 8)
    assert set(found.scripts) == {"there", "also"}
    with pytest.raises(UsageError, match="unknown family 'yours'"):
        get_family("yours")


def test_a_file_tells_of_a_family_that_is_not_here() -> None:
    known = mpdt.register_family(line())
    told = definition(known)
    assert family_of("line", told) is known
    FAMILIES.pop("line")
    stored = family_of("line", told)
    assert not stored.simulates and stored.tasks == TASKS and stored.id == known.id
    assert definition(stored) == told and stored.columns == LINE["columns"]
    assert definition(line(horizon=9))["fingerprint"] != told["fingerprint"]
    for damage in ({"tasks": [3]}, {"columns": None}, {"options": 3}):
        with pytest.raises(ValueError, match="no definition of a family"):
            stored_family(told | damage)
