"""What `texts.py` does to a text: one change of a value or of the bytes, where the text stands."""

from __future__ import annotations

import copy
import io
import json
import pickle
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml

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
    parts = (
        *(b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"[" * DEEP, b"{" * DEEP, b"\r", b"\t", b"&a *a"),
        *(b"\xed\xa0\x80", b"!!python/object/apply:os.system [x]\n", b"\x1b[31m"),
    )
    choice = int(random.integers(4))
    if choice == 0:
        return content[:at]
    if choice == 1:
        return content[:at] + content[at // 2 :]
    if choice == 2:
        return b"" if random.random() < 0.3 else content[at:]
    return content[:at] + parts[int(random.integers(len(parts)))] + content[at:]


Write = Callable[[Path, Random], None]


def in_json(name: str = "") -> Write:
    """A value or a byte of a JSON file; `name` below a folder."""

    def change(path: Path, random: Random) -> None:
        path = path / name if name else path
        content = path.read_bytes()
        if random.random() < 0.25:
            path.write_bytes(change_bytes(content, random))
        else:
            path.write_text(change_value(json.loads(content), random), errors="surrogatepass")

    return change


def in_lines(path: Path, random: Random) -> None:
    """A line of a file of JSON lines."""
    lines = path.read_text().splitlines()
    at = int(random.integers(len(lines)))
    lines[at] = change_value(json.loads(lines[at]), random)
    path.write_bytes("\n".join(lines).encode(errors="surrogatepass") + b"\n")


def in_yaml(path: Path, random: Random) -> None:
    content = path.read_bytes()
    if random.random() < 0.4:
        path.write_bytes(change_bytes(content, random))
    else:  # JSON is YAML
        text = change_value(yaml.safe_load(content), random)
        path.write_bytes(text.encode(errors="surrogatepass"))


def in_attributes(path: Path, random: Random) -> None:
    """A text of a dataset file, under a new seal."""
    from mpdt.data.store.seal import seal

    with h5py.File(path, "r+") as file:
        places = ["/"]
        file.visit(places.append)
        texts = [(place, key) for place in places for key, value in file[place].attrs.items()
                 if isinstance(value, str)]  # fmt: skip
        place, key = texts[int(random.integers(len(texts)))]
        text = str(file[place].attrs[key])
        try:
            changed = change_value(json.loads(text), random)
        except ValueError:
            changed = change_value(text, random)
            changed = changed[1:-1] if random.random() < 0.5 else changed
        try:
            del file[place].attrs[key]
            file[place].attrs[key] = changed.replace("\0", "\\0")[:60_000]
            seal(file)
        except Exception:  # noqa: BLE001  what cannot be written needs no reading
            pass


def in_texts(path: Path, random: Random) -> None:
    """One text of a table in a dataset file, under a new seal."""
    from mpdt.data.store.seal import seal

    with h5py.File(path, "r+") as file:
        found: list[str] = []
        file.visititems(
            lambda name, item: (
                found.append(name)
                if isinstance(item, h5py.Dataset) and item.dtype.kind == "O" and item.size
                else None
            )
        )
        array = file[found[int(random.integers(len(found)))]]
        values = array.asstr()[()].reshape(-1)
        at = int(random.integers(len(values)))
        try:
            changed = change_value(json.loads(values[at]), random)
        except ValueError:
            changed = change_value(values[at], random)[1:-1]
        try:
            values[at] = changed.replace("\0", "\\0")
            array[...] = values.reshape(array.shape)
            seal(file)
        except Exception:  # noqa: BLE001
            pass


def in_header(path: Path, random: Random) -> None:
    """The JSON header of a safetensors file, or the one of ours inside it."""
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header, rest = json.loads(content[8 : 8 + size]), content[8 + size :]
    choice = random.random()
    if choice < 0.2:
        path.write_bytes(change_bytes(content[: 8 + size], random) + rest)
        return
    if choice < 0.6:
        digest, _, said = header["__metadata__"]["mpdt"].partition("\n")
        said = change_value(json.loads(said), random)
        header["__metadata__"]["mpdt"] = f"{digest}\n{said}"
        text = json.dumps(header)
    else:
        text = change_value(header, random)
    new = text.encode(errors="surrogatepass")
    path.write_bytes(len(new).to_bytes(8, "little") + new + rest)


def in_npz(path: Path, random: Random) -> None:
    """The manifest of a lossless npz export."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = next(name for name in members if name.startswith("mpdt"))
    array = np.load(io.BytesIO(members[name]), allow_pickle=False)
    raw = array.tobytes() if array.dtype.kind in "uS" else str(array).encode()
    new = change_manifest(raw, random)
    buffer = io.BytesIO()
    value = np.frombuffer(new, np.uint8) if array.dtype.kind == "u" else np.array(new)
    np.save(buffer, value.astype(array.dtype) if array.dtype.kind == "u" else value)
    members[name] = buffer.getvalue()
    with zipfile.ZipFile(path, "w") as archive:
        for key, content in members.items():
            archive.writestr(key, content)


def in_pickle(path: Path, random: Random) -> None:
    """An episode with another type, shape or key somewhere; still a well-formed pickle."""
    from mpdt.data.exchange.unpickle import load_pickle

    episodes = load_pickle(path)
    odd = [None, 1, 1e400, "x", b"x", [], {}, (), True, np.float32(1), np.zeros(()), 10**400,
           np.zeros((0, 3)), np.full((5, 20), np.nan), np.zeros((5, 20), "U3"), [[1], [2]],
           np.zeros((5, 20), np.complex64), np.zeros(5, "M8[s]"), float("nan")]  # fmt: skip
    value = odd[int(random.integers(len(odd)))]
    keys = list(episodes[0])
    key = keys[int(random.integers(len(keys)))]
    choice = int(random.integers(6))
    if choice == 0:
        episodes = value
    elif choice == 1:
        episodes[1] = value
    elif choice == 2:
        del episodes[0][key]
    elif choice == 3:
        episodes[0][value if isinstance(value, str | int | None) else "more"] = value
    else:
        episodes[int(random.integers(2))][key] = value
    path.write_bytes(pickle.dumps(episodes, protocol=int(random.integers(2, 6))))


def change_manifest(raw: bytes, random: Random) -> bytes:
    """The manifest of an export, in three of four cases under a new hash."""
    from mpdt.data.exchange.manifest import _HASH, _hash_of

    manifest = json.loads(raw)
    del manifest[_HASH]
    text = change_value(manifest, random)
    try:
        changed = json.loads(text)
        if random.random() < 0.75 and isinstance(changed, dict):
            text = text[:-1] + f', "{_HASH}": "{_hash_of(changed)}"}}'
    except (ValueError, RecursionError):  # what has no hash needs no reading
        pass
    return text.encode(errors="surrogatepass")


def in_metadata(path: Path, random: Random) -> None:
    """One of the metadata files, or the manifest in all of them."""
    if random.random() < 0.5:
        files = sorted(path.rglob("metadata.json"))
        manifest = change_manifest(json.loads(files[0].read_text())["mpdt"].encode(), random)
        for file in files:
            said = json.loads(file.read_text()) | {"mpdt": manifest.decode(errors="replace")}
            file.write_text(json.dumps(said))
        return
    in_json(_one(path, "metadata.json", random))(path, random)


def _one(folder: Path, name: str, random: Random) -> str:
    found = sorted(path.relative_to(folder).as_posix() for path in folder.rglob(name))
    return found[int(random.integers(len(found)))]


def in_bytes(path: Path, random: Random) -> None:
    path.write_bytes(change_bytes(path.read_bytes(), random))


def in_any_json(path: Path, random: Random) -> None:
    """As `in_json`, of a text that may be anything already."""
    path.write_text(change_value([path.read_text(), 5000, None], random), errors="surrogatepass")


def in_judged(path: Path, random: Random) -> None:
    """An earlier judgement; what the run has cost is not known otherwise."""
    (path / "spent.json").unlink()
    in_json(f"judged/{'0' * 16}.json")(path, random)


def in_parquet(path: Path, random: Random) -> None:
    """The manifest in the metadata of a table."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    text = change_manifest(table.schema.metadata[b"mpdt"], random)
    pq.write_table(table.replace_schema_metadata({b"mpdt": text}), path)


def in_config(path: Path, random: Random) -> None:
    """A goal, or an episode, of a folder of pickles."""
    files = sorted(path.rglob("*.pkl"))
    chosen = files[int(random.integers(len(files)))]
    if "config" not in chosen.name:
        in_pickle(chosen, random)
        return
    odd = [None, [], [{}], [{"direction": "x"}], [{"direction": 1e400}], {"direction": 1}, 10**400,
           [{"direction": np.zeros((0,))}], [{"direction": [[1.0]]}], [[1.0]]]  # fmt: skip
    chosen.write_bytes(pickle.dumps(odd[int(random.integers(len(odd)))], protocol=4))
