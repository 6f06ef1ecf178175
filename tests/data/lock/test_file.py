"""datasets.lock: one byte form, strict reading, where it lies."""

import hashlib

import msgspec
import pytest

from mpdt.data.lock import file as lock
from mpdt.data.lock.file import (
    Hashes,
    LockEntry,
    Size,
    lock_bytes,
    lock_path,
    parse_lock,
    read_lock,
    run_text,
)
from mpdt.data.spec.entry import canonical_json
from mpdt.errors import FormatError, SpecError

# 12e34... is a number in YAML 1.2 and would lose its digits without quotes.
NUMBER_LIKE = "12e3456789012345" + "0" * 48


def entry(name="tiny", version="1.0.0"):
    spec = {"name": name, "version": version, "seed": 7, "noise": 0.1, "tasks": ["a", 3],
            "goals": None, "low": 1e-05}  # fmt: skip
    return LockEntry(
        version=version,
        hashes=Hashes(
            spec=hashlib.sha256(canonical_json(spec)).hexdigest(),
            content=NUMBER_LIKE,
            file="f" * 64,
            tta={"default": "1" * 64},
        ),
        size=Size(bytes=10, episodes=2, steps=5),
        spec=spec,
        runs={"forward": {"random": "2 " + "9" * 16, "history-07": "1 " + "0" * 16}},
        policies={"forward": {"ppo-3.2M": "1234567890123456"}},
        returns={"forward": {"random": -36.1}},
        packages={"numpy": "2.4.6"},
        platform={"arch": "x86_64"},
    )


def test_a_lock_reads_back_as_it_was_written():
    entries = {"b": entry("b"), "a": entry("a")}
    text = lock_bytes(entries).decode()
    assert parse_lock(text, "x") == entries
    assert lock_bytes(parse_lock(text, "x")) == text.encode()


def test_the_bytes_do_not_depend_on_the_order_and_are_pinned():
    one, two = entry("a"), entry("b")
    assert lock_bytes({"a": one, "b": two}) == lock_bytes({"b": two, "a": one})
    lines = lock_bytes({"a": one}).decode().splitlines()
    assert lines[2:6] == ["datasets:", "  a:", "    hashes:", f"      content: '{NUMBER_LIKE}'"]
    assert "      forward: {history-07: 1 0000000000000000, random: 2 9999999999999999}" in lines
    assert lines[-2:] == ["    version: 1.0.0", "schema: 1"]


def test_a_run_is_its_number_and_a_hash():
    digests = bytes(range(64))
    assert run_text(digests) == "2 " + hashlib.sha256(digests).hexdigest()[:16]


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("schema: 1", "schema: 2", "expected 1, found 2"),
        ("schema: 1", "", "expected the keys schema and datasets"),
        ("schema: 1", "schema: 1\nextra: 2", "expected the keys schema and datasets"),
        ("version: 1.0.0\nschema", "version: 1.0.1\nschema", "a.spec: does not have its hash"),
        ("seed: 7", "seed: 8", "a.spec: does not have its hash: edited by hand"),
        ("seed: 7", "1: 7", "a.spec: does not have its hash: edited by hand"),
        ("bytes: 10", "bites: 10", "unknown key 'bites' (did you mean 'bytes'?)"),
        ("bytes: 10", "bytes: ten", "a.size.bytes: expected a whole number, found text 'ten'"),
        ("f" * 64, "f" * 63, "a.hashes.file: not 64 hex digits"),
        ("1" * 64, "1" * 64 + "0", "a.hashes.tta.default: not 64 hex digits"),
        ("2 9999999999999999", "0 9999999999999999", "is not a number and 16 hex digits"),
        ("2 9999999999999999", "[1]", "a.runs.forward.random: expected text"),
        ("packages:", "packages: 3\n    more:", "a.packages: expected a block of keys"),
        ("seed: 7", "seed: !!python/name:os.system", "not valid YAML"),
        ("schema: 1", "<<<<<<< HEAD\nschema: 1", "not valid YAML"),
    ],
)
def test_what_was_not_written_by_us_is_refused(tmp_path, old, new, what):
    text = lock_bytes({"a": entry("a")}).decode()
    assert old in text
    path = tmp_path / "datasets.lock"
    path.write_text(text.replace(old, new))
    with pytest.raises(FormatError) as caught:
        read_lock(path)
    assert what in str(caught.value)
    assert str(caught.value).startswith(f"{path}")
    assert "version control" in caught.value.hint
    assert caught.value.exit_code == 1


def test_other_ways_to_fail(tmp_path):
    assert read_lock(tmp_path / "none.lock") == {}
    (tmp_path / "x.lock").write_bytes(b"\xff\xfe")
    with pytest.raises(FormatError, match="not UTF-8"):
        read_lock(tmp_path / "x.lock")
    with pytest.raises(FormatError, match="a folder, not a file"):
        read_lock(tmp_path)
    with pytest.raises(SpecError, match="block of entries"):
        parse_lock("schema: 1\ndatasets: [1]", "x")


def test_the_lock_lies_beside_its_catalog_unless_that_is_installed(tmp_path, monkeypatch):
    catalog = tmp_path / "datasets.yaml"
    assert lock_path(catalog) == tmp_path / "datasets.lock"
    monkeypatch.setattr(lock, "__file__", str(tmp_path / "data" / "lock" / "file.py"))
    assert str(lock_path(catalog)) == "datasets.lock"


def test_a_folder_that_cannot_be_written_has_its_lock_here(tmp_path, monkeypatch):
    monkeypatch.setattr(lock.os, "access", lambda path, mode: path != tmp_path)
    assert str(lock_path(tmp_path / "datasets.yaml")) == "datasets.lock"


def test_entries_are_frozen_and_strict():
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(msgspec.to_builtins(entry()) | {"more": 1}, LockEntry)
