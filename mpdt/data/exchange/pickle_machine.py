"""The machine behind `unpickle`: performs the few operations that build plain values and arrays."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

_GLOBALS = {
    f"{package}.{name}": name.rpartition(".")[2]
    for package in ("numpy.core", "numpy._core")
    for name in ("multiarray._reconstruct", "multiarray.scalar", "numeric._frombuffer")
} | {"numpy.ndarray": "ndarray", "numpy.dtype": "dtype", "_codecs.encode": "encode"}
_DTYPES = {"b1", "?", "O", "O8"} | {
    f"{kind}{size}" for kind in "iuf" for size in (1, 2, 4, 8) if f"{kind}{size}" != "f1"
}
_VALUES = frozenset({
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT",
    "STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE",
    "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8",
})  # fmt: skip


def kind_of(value: object) -> str:
    """What a value is, for an error; never its content, which may be anything."""
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape} of {value.dtype}"
    return type(value).__name__


class RefusedError(Exception):
    """Something a pickle of arrays has no need for; named in the message."""


class _Global(str):
    """A known word; the only thing REDUCE accepts."""


class _Dtype:
    """A dtype under construction: REDUCE gives its code, BUILD its byte order."""

    def __init__(self, code: object) -> None:
        if not isinstance(code, str) or code not in _DTYPES:
            raise RefusedError(f"dtype {str(code)[:20]!r}" if isinstance(code, str) else "a dtype")
        self.code, self.order = code, "="

    def build(self, state: Any) -> None:
        order, *structure = state[1:5]
        if order not in ("<", ">", "|", "=") or structure != [None] * 3:
            raise RefusedError("a structured dtype")
        self.order = order

    def resolve(self) -> np.dtype[Any]:
        return np.dtype(self.code).newbyteorder(self.order)  # type: ignore[arg-type]  # one of four


class _Unfinished:
    """An array before its BUILD. Remembers its memo places, which then get the real one."""

    def __init__(self) -> None:
        self.places: list[int] = []


class Machine:
    """Stack, marks and memo of one pickle."""

    def __init__(self, budget_bytes: int) -> None:
        self.stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        # Copies are made of what the file holds once; references to one text or list, copied
        # again and again, would be the way to fill the memory from a small file.
        self._budget_bytes = budget_bytes + 4096

    def perform(self, name: str, argument: Any) -> None:
        """One operation. Raises: RefusedError for one that no pickle of arrays needs."""
        if name in _VALUES:
            self.stack.append(argument)
        elif name in _OPERATIONS:
            _OPERATIONS[name](self, argument)
        else:
            raise RefusedError(f"operation {name}")

    def _spend(self, num_bytes: int) -> None:
        self._budget_bytes -= num_bytes
        if self._budget_bytes < 0:
            raise RefusedError("content larger than the file")

    def _since_mark(self) -> list[Any]:
        start = self._marks.pop()
        items = self.stack[start:]
        del self.stack[start:]
        return items

    def mark(self, _: Any) -> None:
        self._marks.append(len(self.stack))

    def pop(self, _: Any) -> None:
        if self._marks and self._marks[-1] == len(self.stack):
            self._marks.pop()
        else:
            self.stack.pop()

    def constant(self, value: Any) -> None:
        self.stack.append(value)

    def tuple_of(self, count: int | None) -> None:
        items = self._since_mark() if count is None else self.stack[len(self.stack) - count :]
        if count is not None:
            if len(items) != count:
                raise IndexError("stack is too short")
            del self.stack[len(self.stack) - count :]
        self.stack.append(tuple(items))

    def list_of(self, _: Any) -> None:
        self.stack.append(self._since_mark())

    def append(self, items: list[Any]) -> None:
        if not isinstance(self.stack[-1], list):
            raise TypeError("APPEND to something that is no list")
        self.stack[-1].extend(items)

    def set_items(self, items: list[Any]) -> None:
        if not isinstance(self.stack[-1], dict):
            raise TypeError("SETITEM of something that is no dict")
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str):  # hashing deeply nested tuples ends the process
                raise RefusedError("a dict key that is no text")
            self.stack[-1][key] = value

    def dict_of(self, _: Any) -> None:
        items = self._since_mark()
        self.stack.append({})
        self.set_items(items)

    def put(self, place: int | None) -> None:
        place, value = len(self._memo) if place is None else place, self.stack[-1]
        if isinstance(value, _Unfinished):
            value.places.append(place)
        self._memo[place] = value

    def get(self, place: int) -> None:
        self.stack.append(self._memo[place])

    def name_global(self, text: str | None) -> None:
        if text is None:
            name, module = self.stack.pop(), self.stack.pop()
        else:
            module, name = text.split(" ", 1)
        if not (isinstance(module, str) and isinstance(name, str)):
            raise TypeError("STACK_GLOBAL without two texts")
        if f"{module}.{name}" not in _GLOBALS:
            raise RefusedError(f"global '{f'{module}.{name}'[:80]}'")
        self.stack.append(_Global(_GLOBALS[f"{module}.{name}"]))

    def reduce(self, _: Any) -> None:
        arguments, function = self.stack.pop(), self.stack.pop()
        if not isinstance(function, _Global) or not isinstance(arguments, tuple):
            raise RefusedError(f"a call of {kind_of(function)}")
        if function == "_reconstruct":
            subtype, shape, _code = arguments
            if not (isinstance(subtype, _Global) and subtype == "ndarray" and shape == (0,)):
                raise RefusedError("an array of another type than numpy.ndarray")
            self.stack.append(_Unfinished())
        elif function == "dtype":
            self.stack.append(_Dtype(arguments[0]))
        elif function == "encode":
            text, encoding = arguments
            if not isinstance(text, str) or encoding != "latin1":
                raise RefusedError("an encoding other than latin1")
            self._spend(len(text))
            self.stack.append(text.encode("latin1"))
        elif function == "_frombuffer":
            raw, dtype, shape, order = arguments
            self.stack.append(self._array(shape, dtype, order == "F", raw))
        elif function == "scalar":
            dtype, raw = arguments
            self.stack.append(self._array((), dtype, False, raw)[()])
        else:
            raise RefusedError(f"a call of numpy.{function}")

    def build(self, _: Any) -> None:
        state, target = self.stack.pop(), self.stack[-1]
        if not isinstance(state, tuple):
            raise RefusedError(f"a state of {kind_of(target)} that is no tuple")
        if isinstance(target, _Dtype):
            target.build(state)
        elif isinstance(target, _Unfinished):
            _version, shape, dtype, fortran, raw = state
            self.stack[-1] = array = self._array(shape, dtype, bool(fortran), raw)
            for place in target.places:
                self._memo[place] = array
        else:
            raise RefusedError(f"a state of {kind_of(target)}")

    def _array(self, shape: Any, dtype: Any, fortran: bool, raw: Any) -> np.ndarray[Any, Any]:
        sizes_fit = isinstance(shape, tuple) and len(shape) <= 8
        if not sizes_fit or not all(type(size) is int and 0 <= size < 1 << 40 for size in shape):
            raise RefusedError("an array with a wrong shape")
        if not isinstance(dtype, _Dtype):
            raise RefusedError(f"an array of {kind_of(dtype)}")
        count, order = math.prod(shape), "F" if fortran else "C"
        if dtype.code.startswith("O"):
            if not isinstance(raw, list) or len(raw) != count:
                raise ValueError("an array of objects and its list disagree")
            self._spend(count)
            objects = np.empty(count, dtype=object)
            for place, item in enumerate(raw):
                objects[place] = item
            return objects.reshape(shape)
        if isinstance(raw, str):  # text of Python 2
            self._spend(len(raw))
            raw = raw.encode("latin1")
        found = len(raw) if isinstance(raw, bytes | bytearray) else -1
        exact = dtype.resolve()
        if found != count * exact.itemsize:
            raise ValueError(f"an array of shape {shape} of {exact} has {found} bytes")
        if count == 0:
            return np.empty(shape, exact)
        array: np.ndarray[Any, Any] = np.frombuffer(raw, exact).reshape(shape, order=order)  # type: ignore[call-overload]
        return array


def _pair(machine: Machine, _: Any) -> None:
    value, key = machine.stack.pop(), machine.stack.pop()
    machine.set_items([key, value])


_OPERATIONS: dict[str, Callable[[Machine, Any], None]] = {
    "PROTO": lambda machine, _: None,
    "FRAME": lambda machine, _: None,
    "STOP": lambda machine, _: None,
    "MARK": Machine.mark,
    "POP": Machine.pop,
    "NONE": lambda machine, _: machine.constant(None),
    "NEWTRUE": lambda machine, _: machine.constant(True),
    "NEWFALSE": lambda machine, _: machine.constant(False),
    "EMPTY_LIST": lambda machine, _: machine.constant([]),
    "EMPTY_DICT": lambda machine, _: machine.constant({}),
    "EMPTY_TUPLE": lambda machine, _: machine.constant(()),
    "TUPLE": lambda machine, _: machine.tuple_of(None),
    "TUPLE1": lambda machine, _: machine.tuple_of(1),
    "TUPLE2": lambda machine, _: machine.tuple_of(2),
    "TUPLE3": lambda machine, _: machine.tuple_of(3),
    "LIST": Machine.list_of,
    "DICT": Machine.dict_of,
    "APPEND": lambda machine, _: machine.append([machine.stack.pop()]),
    "APPENDS": lambda machine, _: machine.append(machine._since_mark()),
    "SETITEM": _pair,
    "SETITEMS": lambda machine, _: machine.set_items(machine._since_mark()),
    "PUT": Machine.put,
    "BINPUT": Machine.put,
    "LONG_BINPUT": Machine.put,
    "MEMOIZE": Machine.put,
    "GET": Machine.get,
    "BINGET": Machine.get,
    "LONG_BINGET": Machine.get,
    "GLOBAL": Machine.name_global,
    "STACK_GLOBAL": Machine.name_global,
    "REDUCE": Machine.reduce,
    "BUILD": Machine.build,
}
