"""One clear error: what, where, expected, found, what to do next."""

from __future__ import annotations

import pickle

import pytest

from mpdt.errors import (
    BackboneError,
    BusyError,
    DataError,
    FormatError,
    Lines,
    MissingFileError,
    MpdtError,
    ShapeError,
    SimulatorError,
    SpecError,
    StorageError,
    TrainingError,
    UsageError,
    unknown_name,
)


def test_text_has_every_part_in_order() -> None:
    error = DataError("too short", where="a.h5", expected="3", found="2", hint="collect again")
    assert error.render() == ("error: a.h5: too short; expected 3, found 2\nhint:  collect again")
    assert MpdtError("no").render() == "error: no"


@pytest.mark.parametrize(
    ("kind", "code", "builtin"),
    [
        (UsageError, 2, ValueError),
        (SpecError, 2, ValueError),
        (BackboneError, 2, ValueError),
        (MissingFileError, 2, FileNotFoundError),
        (DataError, 1, ValueError),
        (FormatError, 1, ValueError),
        (ShapeError, 1, ValueError),
        (StorageError, 1, OSError),
        (TrainingError, 1, RuntimeError),
        (SimulatorError, 3, RuntimeError),
        (BusyError, 4, RuntimeError),
    ],
)
def test_exit_codes_and_builtins(kind: type[MpdtError], code: int, builtin: type) -> None:
    error = kind("what", where="where", hint="next")
    assert error.exit_code == code
    assert isinstance(error, builtin)
    assert str(error) == "where: what"
    copy = pickle.loads(pickle.dumps(error))  # errors come back from worker processes
    assert type(copy) is kind and copy.render() == error.render()


def test_several_lines_are_one_where_only_a_line_is_shown() -> None:
    error = DataError(Lines.of("2 mistakes", "a", "b"), where="x.yaml")
    assert str(error) == "x.yaml: 2 mistakes\n  a\n  b" and str(error) in error.render()
    assert error.message() == "x.yaml: 2 mistakes: a; b"
    assert DataError(Lines.of("not so:", "a", "", "b")).message() == "not so: a; b"


def test_unknown_name_offers_the_nearest() -> None:
    error = unknown_name("quality", "mediun", ["random", "medium", "expert"])
    assert error.render() == (
        "error: unknown quality 'mediun' (did you mean 'medium'?)\n"
        "hint:  known: expert, medium, random"
    )
    assert "did you mean" not in unknown_name("quality", "xyzzy", ["random"]).render()
