"""What a pickle may contain, and that nothing else in it is ever run.

Every payload below would create the file `marker` if any part of it were executed; the first
test shows on the standard library that the payloads work.
"""

from __future__ import annotations

import copyreg
import io
import marshal
import os
import pickle
import pickletools
import struct
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpdt.data.exchange.unpickle import load_bytes, load_object_array, load_pickle
from mpdt.errors import FormatError, MissingFileError


class Calls:
    """Pickles as a call of `function` with `arguments`."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


def dump(value: object, protocol: int = 4) -> bytes:
    return pickle.dumps(value, protocol)


def touching(marker: Path) -> str:
    return f"__import__('pathlib').Path({str(marker)!r}).touch()"


def code_of(marker: Path) -> types.CodeType:
    return compile(touching(marker), "payload", "exec")


def payloads(marker: Path) -> dict[str, bytes]:
    """Pickles that create `marker` when an ordinary unpickler reads them."""
    system, text = Calls(os.system, f"touch {marker}"), touching(marker)
    objects = np.empty(1, dtype=object)
    objects[0] = {"rewards": system}
    touch = f"touch {marker}".encode()
    found = {f"os.system, protocol {p}": dump(system, p) for p in range(6)}
    return found | {
        "builtins.eval": dump(Calls(eval, text)),
        "builtins.exec": dump(Calls(exec, text)),
        "in a dict in a list": dump([{"observations": [system]}]),
        "in a tuple": dump((1, (2, system))),
        "in an object array": dump(objects),
        "as an argument": dump(Calls(print, system)),
        "marshal": dump(Calls(exec, Calls(marshal.loads, marshal.dumps(code_of(marker))))),
        "INST": b"(S'" + touch + b"'\nios\nsystem\n.",
        "OBJ": b"(cos\nsystem\nV" + touch + b"\no.",
        "GLOBAL and REDUCE": b"cos\nsystem\n(V" + touch + b"\ntR.",
        "STACK_GLOBAL": b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c"
        + bytes([len(touch)]) + touch + b"\x85R.",
        "NEWOBJ": b"\x80\x02csubprocess\nPopen\n(]X\x05\x00\x00\x00touchaX"
        + struct.pack("<I", len(str(marker))) + str(marker).encode() + b"at\x81.",
        "discarded by POP": b"(cos\nsystem\n(V" + touch + b"\ntR0]0].",
    }  # fmt: skip


def test_the_payloads_work_on_an_unguarded_unpickler(tmp_path: Path) -> None:
    skipped = ("NEWOBJ", "discarded by POP", "in an object array")
    for name, data in payloads(tmp_path / "marker").items():
        if name in skipped:  # these fail halfway there, after or before the call
            continue
        pickle.loads(data)
        assert (tmp_path / "marker").exists(), name
        (tmp_path / "marker").unlink()


NAMES = sorted(payloads(Path("marker")))


@pytest.mark.parametrize("name", NAMES)
def test_no_payload_runs(tmp_path: Path, name: str) -> None:
    marker, file = tmp_path / "marker", tmp_path / "data.pkl"
    file.write_bytes(payloads(marker)[name])
    with pytest.raises(FormatError, match="is not allowed in a pickle") as caught:
        load_pickle(file)
    assert not marker.exists()
    assert str(file) in caught.value.where
    assert "nothing in the file was run" in caught.value.hint


def test_a_payload_inside_an_npy_does_not_run(tmp_path: Path) -> None:
    marker, file = tmp_path / "marker", tmp_path / "prompt.npy"
    objects = np.empty(1, dtype=object)
    objects[0] = {"rewards": Calls(os.system, f"touch {marker}")}
    np.save(file, objects, allow_pickle=True)
    with pytest.raises(FormatError, match=r"global 'posix.system' is not allowed"):
        load_object_array(file)
    assert not marker.exists()


SHAPE = b"(K\x00tC\x01bt"
ARRAY = b"\x80\x04cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85C\x01bt"
DTYPE = b"cnumpy\ndtype\nX\x02\x00\x00\x00f4\x85R"


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (dump(Calls(os.system, "x")), r"global 'posix\.system'"),
        (dump(Calls(eval, "x")), r"global 'builtins\.eval'"),
        (b"cbuiltins\neval\n.", r"global 'builtins\.eval'"),
        (b"c__builtin__\neval\n.", r"global '__builtin__\.eval'"),
        (b"cnumpy\nload\n.", r"global 'numpy\.load'"),
        (b"cnumpy.core.multiarray\nfromfile\n.", r"global 'numpy\.core\.multiarray\.fromfile'"),
        # Dotted names would walk from an allowed module to any other.
        (b"\x80\x04\x8c\x05numpy\x8c\x0eos.path.exists\x93.", r"global 'numpy\.os\.path"),
        (b"ccopyreg\n_reconstructor\n.", r"global 'copyreg\._reconstructor'"),
        (b"ccopyreg\n__newobj__\n.", r"global 'copyreg\.__newobj__'"),
        (b"ctypes\nCodeType\n.", r"global 'types\.CodeType'"),
        (b"cmarshal\nloads\n.", r"global 'marshal\.loads'"),
        (b"Pwhatever\n.", "operation PERSID"),
        (b"\x80\x02X\x01\x00\x00\x00xQ.", "operation BINPERSID"),
        (b"\x80\x02\x82\x01.", "operation EXT1"),
        (b"\x80\x02\x83\x01\x00.", "operation EXT2"),
        (b"\x80\x02\x84\x01\x00\x00\x00.", "operation EXT4"),
        (b"(S'x'\nios\nsystem\n.", "operation INST"),
        (b"(o.", "operation OBJ"),
        (b"\x80\x02cnumpy\nndarray\n)\x81.", "operation NEWOBJ"),
        (b"\x80\x04cnumpy\nndarray\n)}\x92.", "operation NEWOBJ_EX"),
        (b"\x80\x05\x97.", "operation NEXT_BUFFER"),
        (b"\x80\x04\x8f.", "operation EMPTY_SET"),
        # A call of something that is no function, and of a type that would allocate.
        (b"]]tR.", "."),
        (b"V1\n)R.", "a call of str"),
        (b"cnumpy\nndarray\n(L1000000000000L\nttR.", "a call of numpy.ndarray|damaged"),
        (b"\x80\x02cnumpy\nndarray\nJ\xff\xff\xff\x7f\x85\x85R.", r"a call of numpy\.ndarray"),
        # State of anything but an array or a dtype: `BUILD` sets attributes.
        (b"cnumpy\nndarray\n}(V__class__\nV1\nub.", "a state of _Global"),
        (b"cnumpy.core.multiarray\nscalar\n(NNtb.", "a state of _Global"),
        (b"](NNtb.", "a state of list"),
        (b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\ndtype\n(I0\ntS'b'\ntR.", "another type"),
        (b"cnumpy.core.multiarray\n_reconstruct\n(S'ndarray'\n(I0\ntS'b'\ntR.", "another type"),
        (b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I9999999\ntS'b'\ntR.", "an"),
        (b"c_codecs\nencode\n(Vrot\nVrot13\ntR.", "an encoding other than latin1"),
        (b"cnumpy\ndtype\n(VV999999999\ntR.", "dtype 'V999999999'"),
        (b"cnumpy\ndtype\n((lp0\ntR.", "a dtype"),
        (b"\x80\x04}]Nss.", "damaged|a dict key"),
        (b"\x80\x04})Ns.", "a dict key that is no text"),
    ],
)  # fmt: skip
def test_the_error_names_what_was_refused(data: bytes, named: str) -> None:
    with pytest.raises(FormatError, match=named):
        load_bytes(data, "x.pkl")


def test_registered_extensions_are_not_looked_up(tmp_path: Path) -> None:
    copyreg.add_extension("posix", "system", 201)
    try:
        data = b"\x80\x02\x82\xc9X\x05\x00\x00\x00false\x85R."
        assert pickle.loads(data) != 0  # it works elsewhere: `false` was run
        with pytest.raises(FormatError, match="operation EXT1"):
            load_bytes(data, "x.pkl")
    finally:
        copyreg.remove_extension("posix", "system", 201)


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
    with pytest.raises(FormatError, match="too large"):
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


def test_every_operation_is_known_to_pickletools() -> None:
    from mpdt.data.exchange.pickle_machine import _OPERATIONS, _VALUES

    known = {opcode.name for opcode in pickletools.opcodes}
    assert (_VALUES | set(_OPERATIONS)) <= known


def test_the_repository_has_no_other_door_for_pickles() -> None:
    """`torch.load`, `allow_pickle=True` and the unpickler of the standard library.

    Not looked at: benchmarks/peers/, which reads what we wrote the way others would.
    """
    import ast

    root = Path(__file__).parents[3]
    found = []
    for path in [*(root / "mpdt").rglob("*.py"), *(root / "benchmarks").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                closed = isinstance(node.value, ast.Constant) and node.value.value is False
                found += [] if closed else [f"{path.name}: allow_pickle"]
            if isinstance(node, ast.Attribute) and ast.unparse(node) in (
                "torch.load", "pickle.load", "pickle.loads", "pickle.Unpickler", "marshal.loads",
                "pickle._Unpickler", "joblib.load", "dill.loads", "cloudpickle.loads",
            ):  # fmt: skip
                found.append(f"{path.name}: {ast.unparse(node)}")
            if isinstance(node, ast.ImportFrom) and node.module in ("pickle", "marshal", "dill"):
                found.append(f"{path.name}: from {node.module}")
    assert not found, io.StringIO("\n".join(found)).getvalue()
