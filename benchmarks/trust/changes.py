"""What `texts.py` does to a text: one change of a value or of the bytes."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

Random = np.random.Generator
DEEP, LONG = 2000, 200_000
MARK = "\uf8ffMARK\uf8ff"

# As JSON texts: what Python objects cannot hold (nesting, keys twice, huge numbers) as well.
ODD = (
    "null", "true", "[]", "{}", '""', '"x"', "0", "-1", "1.5", "1e400", "-1e400", "NaN", "Infinity",
    "9" * 400, "-" + "9" * 400, "9223372036854775808", "1e-400", "[" * DEEP + "]" * DEEP,
    '{"a":' * DEEP + "1" + "}" * DEEP, json.dumps("x" * LONG), '"\\u0000"', '"\\ud800"',
    '"\\u202e\\u001b[31mred"', '"../../etc/passwd"', '"/dev/zero"', '"a\\nb"', '"[/x]"',
    "[" + ",".join(["1"] * 20_000) + "]", '{"a": 1, "a": 2}', '[null, [null]]', '{"": {"": []}}',
)  # fmt: skip


def paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every value below, and to the whole."""
    yield path
    items = value.items() if isinstance(value, dict) else (
        enumerate(value) if isinstance(value, list) else ()
    )  # fmt: skip
    for key, item in items:
        yield from paths(item, (*path, key))


def change_value(value: Any, random: Random) -> str:
    """JSON text of `value` with one value replaced, gone, twice, renamed or wrapped."""
    ways = list(paths(value))
    way = ways[int(random.integers(len(ways)))]
    if not way:
        return ODD[int(random.integers(len(ODD)))]
    changed = copy.deepcopy(value)
    holder = changed
    for key in way[:-1]:
        holder = holder[key]
    key, choice = way[-1], int(random.integers(8))
    if choice == 0:
        del holder[key]
    elif choice == 1:
        holder[key] = [holder[key]]
    elif choice == 2:
        holder[key] = {"value": holder[key]}
    elif choice == 3 and isinstance(holder, dict):
        holder[f"{key}_"] = holder.pop(key)
    elif choice == 4 and isinstance(holder, list):
        holder.insert(0, holder[key])
    else:
        holder[key] = MARK
        odd = ODD[int(random.integers(len(ODD)))]
        return json.dumps(changed).replace(json.dumps(MARK), odd)
    return json.dumps(changed)


def change_bytes(content: bytes, random: Random) -> bytes:
    """Cut, NUL, not UTF-8, a mark of byte order, brackets, a piece twice, nothing."""
    at = int(random.integers(len(content) + 1))
    parts = (b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"[" * DEEP, b"{" * DEEP, b"\r", b"\t", b"&a *a",
             b"\xed\xa0\x80", b"!!python/object/apply:os.system [x]\n", b"\x1b[31m")  # fmt: skip
    choice = int(random.integers(4))
    if choice == 0:
        return content[:at]
    if choice == 1:
        return content[:at] + content[at // 2 :]
    if choice == 2:
        return b"" if random.random() < 0.3 else content[at:]
    return content[:at] + parts[int(random.integers(len(parts)))] + content[at:]
