from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file

from mpdt.errors import FormatError, MissingFileError, ShapeError, StorageError
from mpdt.model.weights import WeightsHeader, check_shapes, load_weights, save_weights

TENSORS = {"cross": torch.arange(6.0).reshape(2, 3), "table": torch.ones(4)}
HEADER_OF_OURS = WeightsHeader(kind="mpdt", hashes={"backbone": "aa"}, settings={"rank": 1})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    target = tmp_path / "run" / "weights.safetensors"
    save_weights(target, TENSORS, HEADER_OF_OURS)
    return target


def test_round_trip(path: Path) -> None:
    header, tensors = load_weights(path, kind="mpdt", hashes={"backbone": "aa"})
    assert header == HEADER_OF_OURS
    assert tensors.keys() == TENSORS.keys()
    assert all(torch.equal(tensors[name], TENSORS[name]) for name in TENSORS)
    assert [file.name for file in path.parent.iterdir()] == ["weights.safetensors"]


def test_shared_and_transposed_memory_can_be_saved(tmp_path: Path) -> None:
    base = torch.arange(6.0).reshape(2, 3)
    save_weights(tmp_path / "w", {"a": base, "b": base, "c": base.T}, HEADER_OF_OURS)
    assert torch.equal(load_weights(tmp_path / "w")[1]["c"], base.T)


def test_another_hash_and_kind_are_refused(path: Path) -> None:
    with pytest.raises(FormatError, match="trained on another backbone; expected bb, found aa"):
        load_weights(path, hashes={"backbone": "bb"})
    with pytest.raises(FormatError, match="found nothing recorded"):
        load_weights(path, hashes={"data": "cc"})
    with pytest.raises(FormatError, match="expected teacher, found mpdt"):
        load_weights(path, kind="teacher")


def test_shapes_that_do_not_fit() -> None:
    check_shapes({"cross": (2, 3), "table": (4,)}, TENSORS, "here")
    for expected, message in (
        ({"cross": (2, 4), "table": (4,)}, r"'cross' .*; expected \(2, 4\), found \(2, 3\)"),
        ({"cross": (2, 3)}, r"'table' does not fit; expected no such tensor"),
        ({"cross": (2, 3), "table": (4,), "u": (1,)}, r"'u' does not fit.*found no such tensor"),
    ):
        with pytest.raises(ShapeError, match=message):
            check_shapes(expected, TENSORS, "here")


def test_files_that_are_not_ours(path: Path, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no such file of weights") as caught:
        load_weights(tmp_path / "nothing")
    assert "`mpdt-train --data FILE`" in caught.value.hint
    cut = tmp_path / "cut"
    cut.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(FormatError, match="not a whole safetensors file"):
        load_weights(cut)
    foreign = tmp_path / "foreign"
    save_file(TENSORS, foreign)
    with pytest.raises(FormatError, match="not written by mpdt"):
        load_weights(foreign)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"format": "mpdt-weights/2", "kind": "mpdt"}', "expected mpdt-weights/1, found mpdt-w"),
        ('{"format": "mpdt-weights/1", "kind": 3}', "unreadable header"),
        ("not json", "unreadable header"),
    ],
)
def test_headers_that_cannot_be_read(tmp_path: Path, text: str, message: str) -> None:
    save_file(TENSORS, tmp_path / "w", metadata={"mpdt": text})
    with pytest.raises(FormatError, match=message):
        load_weights(tmp_path / "w")


def test_header_text_is_plain_json() -> None:
    assert msgspec.json.decode(msgspec.json.encode(HEADER_OF_OURS)) == {
        "kind": "mpdt",
        "hashes": {"backbone": "aa"},
        "settings": {"rank": 1},
        "format": "mpdt-weights/1",
    }


def test_disk_that_refuses(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way of a folder")
    with pytest.raises(StorageError, match="cannot be written"):
        save_weights(tmp_path / "file" / "w", TENSORS, HEADER_OF_OURS)


def test_a_flipped_bit_of_a_number_is_found(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-1] ^= 1  # the numbers stand at the end
    path.write_bytes(content)
    with pytest.raises(FormatError, match="not those that were written"):
        load_weights(path)


def test_a_changed_word_of_the_header_is_found(path: Path) -> None:
    """Another kind of the same length would be believed otherwise."""
    content = path.read_bytes()
    assert content.count(b"mpdt-weights/1") == 1 and b'\\"mpdt\\"' in content
    path.write_bytes(content.replace(b'\\"mpdt\\"', b'\\"mpdu\\"'))
    with pytest.raises(FormatError, match="not those that were written"):
        load_weights(path)


def framed(header: bytes, data: bytes = b"", length: int | None = None) -> bytes:
    """A safetensors file with that header, and the length it says."""
    return (len(header) if length is None else length).to_bytes(8, "little") + header + data


def told(said: str) -> bytes:
    return framed(json.dumps({"__metadata__": {"mpdt": said}}).encode())


NESTED = "[" * 2000 + "]" * 2000
BAD = {
    "nothing": b"",
    "seven bytes": b"\0" * 7,
    "a header longer than the file": framed(b"{}", length=2**40),
    "the longest header": framed(b"{}", length=2**64 - 1),
    "a header past all of ours": framed(b"{}".ljust(2**24 + 1)),
    "a nested header": framed(NESTED.encode()),
    "nested metadata": framed(f'{{"__metadata__": {NESTED}}}'.encode()),
    "a nested header of ours": told(f'x\n{{"format": {NESTED}}}'),
    "nested settings": told(f'x\n{{"format": "mpdt-weights/1", "settings": {{"a": {NESTED}}}}}'),
    "no object": framed(b"[]"),
    "a number too many": told('x\n{"format": 1e999}'),
    "metadata that is no text": framed(b'{"__metadata__": {"mpdt": 3}}'),
    "a tensor without bytes": framed(
        b'{"a": {"dtype": "F32", "shape": [1000000000000], "data_offsets": [0, 4000000000000]}}'
    ),
    "a size past all numbers": framed(
        b'{"a": {"dtype": "F32", "shape": [4294967296, 4294967296], "data_offsets": [0, 0]}}'
    ),
    "a shape below nothing": framed(
        b'{"a": {"dtype": "F32", "shape": [-1], "data_offsets": [0, 4]}}', bytes(4)
    ),
    "no such kind of numbers": framed(
        b'{"a": {"dtype": "X9", "shape": [1], "data_offsets": [0, 4]}}', bytes(4)
    ),
    "numbers of half a byte": framed(
        b'{"a": {"dtype": "F4", "shape": [2], "data_offsets": [0, 1]}}', bytes(1)
    ),
    "tensors over each other": framed(
        b'{"a": {"dtype": "U8", "shape": [4], "data_offsets": [0, 4]},'
        b' "b": {"dtype": "U8", "shape": [4], "data_offsets": [2, 6]}}', bytes(6)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_malformed_files(tmp_path: Path, name: str) -> None:
    (tmp_path / "w").write_bytes(BAD[name])
    with pytest.raises(FormatError) as caught:
        load_weights(tmp_path / "w")
    assert len(str(caught.value)) < 1000
    # What a header declares is compared with the file before the library reserves it.
    long = name in (
        "a header longer than the file",
        "the longest header",
        "a header past all of ours",
    )
    assert not long or "a header of" in str(caught.value)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=4,
)
ENTRY = st.fixed_dictionaries(
    {
        "dtype": st.sampled_from(
            ["F32", "BF16", "F8_E4M3", "F4", "C64", "BOOL", "I64", "U16", "?"]
        ),
        "shape": st.lists(st.integers(0, 4) | st.integers(), max_size=3),
        "data_offsets": st.tuples(st.integers(0, 16), st.integers(0, 64)) | st.lists(st.integers()),
    }
)
HEADER = st.dictionaries(st.text(max_size=5) | st.just("__metadata__"), ENTRY | JSON, max_size=4)


@given(header=HEADER | JSON, data=st.binary(max_size=64))
@settings(max_examples=60, deadline=None)
def test_any_header_is_one_error(
    tmp_path_factory: pytest.TempPathFactory, header: Any, data: bytes
) -> None:
    """Nobody but `save_weights` writes a digest that fits."""
    path = tmp_path_factory.getbasetemp() / "any"
    path.write_bytes(framed(json.dumps(header).encode(), data))
    with pytest.raises(FormatError):
        load_weights(path)


@given(
    place=st.integers(0, 10**4),
    cut=st.integers(0, 8),
    put=st.binary(max_size=8) | st.sampled_from([b"[" * 2000, b"\xff" * 8]),
)
@settings(max_examples=100, deadline=None)
def test_any_change_is_one_error(
    tmp_path_factory: pytest.TempPathFactory, place: int, cut: int, put: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "changed"
    save_weights(path, TENSORS, HEADER_OF_OURS)
    whole = path.read_bytes()
    at = place % len(whole)
    changed = whole[:at] + put + whole[at + cut :]
    path.write_bytes(changed)
    if changed != whole:
        with pytest.raises(FormatError):
            load_weights(path)


def test_what_the_disk_refuses_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "closed"
    save_weights(path, TENSORS, HEADER_OF_OURS)

    def refuse(*_: object) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("mpdt.reading.os.open", refuse)
    with pytest.raises(StorageError, match="cannot be opened"):
        load_weights(path)
