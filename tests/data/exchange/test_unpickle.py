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
from mpdt.errors import FormatError


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


def test_every_operation_is_known_to_pickletools() -> None:
    from mpdt.data.exchange.pickle_machine import _OPERATIONS, _VALUES

    known = {opcode.name for opcode in pickletools.opcodes}
    assert (_VALUES | set(_OPERATIONS)) <= known


def test_the_repository_has_no_other_door_for_pickles() -> None:
    """`torch.load`, `allow_pickle=True` and the unpickler of the standard library.

    Not looked at: benchmarks/ecosystem/peers/, which reads what we wrote the way others would.
    """
    import ast

    root = Path(__file__).parents[3]
    found = []
    for path in [*(root / "mpdt").rglob("*.py"), *(root / "benchmarks").glob("[!e]*/*.py")]:
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
