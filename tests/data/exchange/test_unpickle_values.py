"""What is read from a pickle: arrays and plain values, bounded by the file, or a format error."""

from __future__ import annotations

import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.exchange.unpickle import load_bytes, load_object_array, load_pickle
from mpdt.errors import FormatError, MissingFileError


def dump(value: object, protocol: int = 4) -> bytes:
    return pickle.dumps(value, protocol)


ARRAY = b"\x80\x04cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85C\x01bt"
DTYPE = b"cnumpy\ndtype\nX\x02\x00\x00\x00f4\x85R"


def array_with(shape: bytes, raw: bytes, dtype: bytes = DTYPE) -> bytes:
    """A pickle of one float32 array whose BUILD says `shape` and `raw` (opcodes)."""
    return ARRAY + b"R(K\x01" + shape + dtype + b"\x89" + raw + b"tb."


@pytest.mark.parametrize(
    "data",
    [
        b"\x80\x04\x8d" + struct.pack("<Q", 1 << 40) + b"abc.",  # BINUNICODE8 of a terabyte
        b"\x80\x04X" + struct.pack("<I", (1 << 32) - 1) + b"abc.",
        b"\x80\x04\x8e" + struct.pack("<Q", 1 << 62) + b"abc.",  # BINBYTES8
        b"\x80\x05\x96" + struct.pack("<Q", 1 << 40) + b"abc.",  # BYTEARRAY8
        b"\x80\x04\x95" + struct.pack("<Q", 1 << 60) + b"abc.",  # FRAME
        b"\x80\x04\x8b" + struct.pack("<i", (1 << 31) - 1) + b"1.",  # LONG4
        b"\x80\x02I" + b"9" * 100_000 + b"\n.",
        b"\x80\x02]r" + struct.pack("<I", (1 << 32) - 1) + b"a.",  # a memo of 4 billion places
        array_with(b"\x8a\x05" + (1 << 36).to_bytes(5, "little") + b"\x85", b"C\x04abcd"),
        array_with(b"(" + b"J\xff\xff\xff\x7f" * 8 + b"t", b"C\x04abcd"),
        array_with(b"(" + b"K\x02" * 9 + b"t", b"C\x04abcd"),
        array_with(b"J\xff\xff\xff\xff\x85", b"C\x04abcd"),
        array_with(b"K\x02\x85", b"C\x04abcd"),
        array_with(b"(K\x00J\xff\xff\xff\x7fJ\xff\xff\xff\x7fJ\xff\xff\xff\x7ft", b"C\x00"),
        array_with(b"K\x01\x85", b"K\x01"),
        array_with(b"K\x02\x85", b"]", b"cnumpy\ndtype\nX\x01\x00\x00\x00O\x85R"),
        b"", b"garbage", b"\x80\x04]", b".", b"]]tR.", b"0.", b"\x80\x04h\x05.",
    ],
)  # fmt: skip
def test_lengths_beyond_the_file_are_refused_without_their_memory(data: bytes) -> None:
    with pytest.raises(FormatError) as caught:
        load_bytes(data, "bomb.pkl")
    assert len(caught.value.message()) < 500


def test_an_array_and_its_bytes_that_disagree() -> None:
    with pytest.raises(FormatError, match=r"array of shape \(2,\) of float32 has 4 bytes"):
        load_bytes(array_with(b"K\x02\x85", b"C\x04abcd"), "x.pkl")
    with pytest.raises(FormatError, match=r"array of shape \(2,\) of float32 has 12 bytes"):
        load_bytes(array_with(b"K\x02\x85", b"C\x0cabcdabcdabcd"), "x.pkl")


def test_one_text_copied_again_and_again_does_not_fill_the_memory() -> None:
    text = b"V" + b"a" * 100_000 + b"\np0\n0"
    copies = b"c_codecs\nencode\n(g0\nVlatin1\ntR" * 1000
    with pytest.raises(FormatError, match="content larger than the file"):
        load_bytes(text + copies + b".", "bomb.pkl")


def test_deep_nesting_is_only_deep() -> None:
    depth = 50_000
    assert isinstance(load_bytes(b"\x80\x02" + b"]" * depth + b"a" * (depth - 1) + b".", ""), list)


def test_too_many_operations_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mpdt.data.exchange.unpickle.MAX_OPERATIONS", 1000)
    with pytest.raises(FormatError, match="more than 1,000 operations"):
        load_bytes(b"\x80\x02]" + b"Na" * 1000 + b".", "x.pkl")


def test_a_large_file_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mpdt.data.exchange.unpickle.MAX_BYTES", 10)
    file = tmp_path / "large.pkl"
    file.write_bytes(dump("x" * 20))
    with pytest.raises(FormatError, match="larger than any file"):
        load_pickle(file)
    with pytest.raises(MissingFileError):
        load_pickle(tmp_path / "absent.pkl")


def example() -> list[dict[str, Any]]:
    return [
        {
            "observations": np.arange(6, dtype=np.float32).reshape(2, 3) + i,
            "by column": np.asfortranarray(np.arange(6, dtype=">f8").reshape(2, 3)),
            "terminals": np.array([[False], [True]]),
            "none": np.empty((0, 3), np.float32),
            "direction": np.float64(-1.0),
            "count": np.int64(7),
            "plain": [1, -2, 3.5, None, True, "text", b"bytes", (1, (2,)), 1 << 70, {"a": {}}],
        }
        for i in range(2)
    ]


def assert_same(found: Any, wanted: Any) -> None:
    assert type(found) is type(wanted)
    if isinstance(wanted, dict):
        assert list(found) == list(wanted)
        for key in wanted:
            assert_same(found[key], wanted[key])
    elif isinstance(wanted, np.ndarray | np.generic):
        assert found.dtype == wanted.dtype and found.shape == wanted.shape
        np.testing.assert_array_equal(found, wanted)
    elif isinstance(wanted, list | tuple):
        assert len(found) == len(wanted)
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other)
    else:
        assert found == wanted


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_and_plain_values_of_every_protocol(tmp_path: Path, protocol: int) -> None:
    wanted = example()
    if protocol < 3:  # empty bytes are a call of `bytes` there, and non-empty ones of encode
        for one in wanted:
            del one["none"]
    file = tmp_path / "data.pkl"
    file.write_bytes(dump(wanted, protocol))
    assert_same(load_pickle(file), wanted)


@pytest.mark.parametrize("protocol", [2, 4])
def test_module_names_from_before_numpy_2(protocol: int) -> None:
    new, old = b"numpy._core.multiarray", b"numpy.core.multiarray"
    data = dump(np.arange(4), protocol)
    if protocol == 4:
        data = b"\x80\x04" + data[11:]  # no frame: its length would be wrong
        new, old = b"\x8c\x16" + new, b"\x8c\x15" + old
    assert new in data
    assert_same(load_bytes(data.replace(new, old), ""), np.arange(4))


def test_an_array_that_python_2_wrote() -> None:
    """Its protocol 2 has byte strings (U) where Python 3 reads text."""
    data = (
        b"\x80\x02}U\x07rewardscnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85"
        b"U\x01b\x87R(K\x01K\x02\x85cnumpy\ndtype\nU\x02f4K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff"
        b"\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x08\x00\x00\x80?\xff\x00\x00@tbs."
    )
    found = load_bytes(data, "")
    wanted = np.frombuffer(b"\x00\x00\x80?\xff\x00\x00@", "<f4")
    np.testing.assert_array_equal(found["rewards"], wanted)


def test_an_object_array_of_dicts(tmp_path: Path) -> None:
    wanted = example()
    objects = np.empty(2, dtype=object)
    objects[:] = wanted
    file = tmp_path / "prompt.npy"
    np.save(file, objects, allow_pickle=True)
    assert_same(load_object_array(file), wanted)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x93NUMPY", b"\x93NUMPY\x01\x00\xff\xff{}", dump([1]), b"\x93NUMPY\x01\x00v\x00" +
     b"(" * 117 + b"\n"],
)  # fmt: skip
def test_a_wrong_npy_header(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "wrong.npy"
    file.write_bytes(content)
    with pytest.raises(FormatError, match=r"not an \.npy file of dicts"):
        load_object_array(file)


def test_a_numeric_npy_is_none_of_dicts(tmp_path: Path) -> None:
    np.save(tmp_path / "numbers.npy", np.arange(3))
    with pytest.raises(FormatError, match="<i8"):
        load_object_array(tmp_path / "numbers.npy")
    np.save(tmp_path / "square.npy", np.full(2, {}, dtype=object), allow_pickle=True)
    head = (tmp_path / "square.npy").read_bytes().partition(b"\n")[0] + b"\n"  # of one dimension
    square = pickle.dumps(np.full((2, 2), {}, dtype=object))
    (tmp_path / "square.npy").write_bytes(head + square)
    with pytest.raises(FormatError, match=r"not an \.npy file of dicts"):
        load_object_array(tmp_path / "square.npy")


def test_damage_never_ends_in_anything_but_a_format_error() -> None:
    data = bytearray(dump(example()))
    rng = np.random.default_rng(0)
    refused, read = 0, 0
    for place in rng.integers(len(data), size=1000):
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(8))
        try:
            load_bytes(bytes(changed), "x.pkl")
        except FormatError:
            refused += 1
        else:
            read += 1
    assert refused + read == 1000
    assert refused and read  # both sides were met: operations, and numbers that nothing covers
