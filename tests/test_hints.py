"""What reaches a terminal: names are shown as text, and commands can be typed as they stand."""

from __future__ import annotations

import ast
import pickle
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import mpdt
from mpdt.errors import DataError, Lines, quoted, unknown_name, visible

PACKAGE = Path(mpdt.__file__).parent
COMMAND = re.compile(r"(\b(mpdt-data|mpdt-train|mkdir|kill|chmod|rm|mv|cp|ssh) |--[a-z-]+[ =]$)")
SAFE = {"quoted", "_quoted", "join", "quote"}
AWAY = re.compile(r"\b(delete|remove|erase|rm|unlink)\b")
OUR_LOCK = Path("disk/hold.py")  # a lock file of ours holds nothing


def unquoted(tree: ast.AST) -> list[tuple[int, str]]:
    """Values that an f-string puts into a command without quoting them for the shell."""
    found = []
    for text in ast.walk(tree):
        if not isinstance(text, ast.JoinedStr):
            continue
        before = ""
        for part in text.values:
            if isinstance(part, ast.Constant):
                before = re.sub(r".*[;\n`](?! ?kill)", "", before + str(part.value), flags=re.S)
                continue
            assert isinstance(part, ast.FormattedValue)
            value = part.value
            is_safe = isinstance(value, ast.Call) and (
                getattr(value.func, "id", getattr(value.func, "attr", "")) in SAFE
            )
            is_number = part.format_spec is not None
            if COMMAND.search(before) and not is_safe and not is_number:
                found.append((part.lineno, ast.unparse(value)))
            before += "x"
    return found


def test_every_value_in_a_command_is_quoted() -> None:
    found = [
        f"{path.relative_to(PACKAGE)}:{line} {value}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, value in unquoted(ast.parse(path.read_text("utf-8")))
    ]
    assert not found, "\n".join(found)


def test_the_test_sees_what_it_looks_for() -> None:
    for text in ('f"mpdt-data show {path}"', 'f"give --family {name}"', '"mkdir -p " f"{path}"'):
        assert unquoted(ast.parse(text)), text
    for text in ('f"mpdt-data show {quoted(path)}"', 'f"{path} is not"', 'f"kill {n:d}"'):
        assert not unquoted(ast.parse(text)), text


def told(tree: ast.AST) -> list[str]:
    """The texts of a module that are no docstrings."""
    said = {id(one.value) for one in ast.walk(tree) if isinstance(one, ast.Expr)}
    return [
        one.value for one in ast.walk(tree)
        if isinstance(one, ast.Constant) and isinstance(one.value, str) and id(one) not in said
    ]  # fmt: skip


def test_nobody_is_told_to_delete_anything() -> None:
    """It may be the only one there is; what is moved away is not lost."""
    found = [
        f"{path.relative_to(PACKAGE)}: {text}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.relative_to(PACKAGE) != OUR_LOCK
        for text in told(ast.parse(path.read_text("utf-8")))
        if AWAY.search(text)
    ]
    assert not found, "\n".join(found)
    assert AWAY.search(told(ast.parse('"""Delete."""\nf(hint=f"or delete {x} first")'))[0])


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("\x1b[2J", "\\x1b[2J"), ("\x9b31m", "\\x9b31m"), ("a\rb", "a\\rb"),
        ("\u202eh5.x", "\\u202eh5.x"),
        ("\u2066", "\\u2066"), ("\x00", "\\x00"), ("é 速", "é 速"), ("\udcff", "\\udcff"),
        ("\U000e0041", "\\U000e0041"),
    ],
)  # fmt: skip
def test_what_a_terminal_would_obey_is_shown_as_text(name: str, shown: str) -> None:
    assert visible(name) == shown
    error = DataError(name, where=name, expected=name, found=name, hint=f"rm {name}")
    assert name == shown or name not in error.render() + str(error)
    assert error.render().count(shown) == 5


def test_a_name_cannot_begin_a_line_of_its_own() -> None:
    mistakes = Lines.of("two mistakes", "a\nhint: c", "b")
    error = pickle.loads(pickle.dumps(DataError(mistakes, where="x.h5\nhint: rm", hint="see\nx")))
    shown = "error: x.h5\\nhint: rm: two mistakes\n  a\\nhint: c\n  b\nhint:  see\\nx"
    assert error.render() == shown
    assert unknown_name("verb", "a\nhint: b", ["c"]).render().count("\n") == 1


def test_the_middle_of_endless_names_is_left_out() -> None:
    shown = DataError("x" * 513, where="a/" * 999, found="y " * 999).render()
    assert "x" * 160 + "[...]" + "x" * 80 in shown and "a/" * 80 + "[...]" in shown
    assert len(shown) < 2600 and "x" * 512 in DataError("x" * 512).render()


def test_quoted() -> None:
    assert quoted("ml10.h5") == "ml10.h5"
    assert quoted("x; touch PWNED #") == "'x; touch PWNED #'"
    assert quoted(Path("-rf")) == "./-rf"
    assert quoted("a\nb") == "$'a\\nb'" and visible(quoted("a\x1b\u202e")) == quoted("a\x1b\u202e")


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_a_quoted_name_is_one_word_of_a_shell() -> None:
    names = ["a\nb", "it's\t\\", "\x1b[2J", "\u202eh5", "\udcff x\x07", "$(x)\r`y`"]
    line = "printf '%s\\0' " + " ".join(map(quoted, names))
    found = subprocess.run(["bash", "-c", line], env={"LC_ALL": "C.UTF-8"}, capture_output=True)
    assert found.stdout.decode("utf-8", "surrogateescape").split("\0")[:-1] == names
