"""What `fuzz.py` does to a file: one random change each."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

Random = np.random.Generator


def flip(content: bytes, random: Random) -> bytes:
    damaged = bytearray(content)
    damaged[random.integers(len(damaged))] ^= 1 << random.integers(8)
    return bytes(damaged)


def mutate_hdf5(path: Path, random: Random) -> None:
    """One structural change of an HDF5 file."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        arrays = [name for name in names if isinstance(file[name], h5py.Dataset)]
        holders = ["/", *names]
        name = str(random.choice(arrays))
        array = file[name]
        choice = random.integers(8)
        if choice == 0:
            del file[str(random.choice(names))]
        elif choice == 1:
            item = file[str(random.choice([h for h in holders if len(file[h].attrs)]))]
            del item.attrs[str(random.choice(list(item.attrs)))]
        elif choice == 2:
            item = file[str(random.choice([h for h in holders if len(file[h].attrs)]))]
            key = str(random.choice(list(item.attrs)))
            item.attrs[key] = str(random.choice(["", "x", "{}", "mpdt/2", "-1", "null"]))
        elif choice == 3 and array.dtype.kind in "iufb" and array.size:
            values = array[()]
            flat = values.reshape(-1)
            at = random.integers(flat.size)
            extremes = np.array([0, 1, -1, 127, 2**31 - 1, 2**62, np.nan, np.inf, -np.inf])
            with np.errstate(all="ignore"):
                flat[at] = random.choice(extremes).astype(values.dtype)
            array[...] = values
        elif choice == 4 and array.shape:
            values = array[()]
            del file[name]
            file[name] = values[:-1] if random.random() < 0.5 else np.concatenate([values, values])
        elif choice == 5 and array.dtype.kind in "iuf":
            values = array[()]
            del file[name]
            with np.errstate(all="ignore"):
                file[name] = values.astype(random.choice(["<f8", "<f4", "<i8", ">i4", "<u1"]))
        elif choice == 6:
            file.move(name, name + "_")
        else:
            other = str(random.choice(arrays))
            values = file[other][()]
            del file[name]
            file[name] = values


def mutate_text(content: bytes, random: Random) -> bytes:
    """One change of a line or of a character."""
    lines = content.decode().splitlines(keepends=True)
    at = int(random.integers(len(lines)))
    line = lines[at]
    choice = random.integers(6)
    if choice == 0:
        del lines[at]
    elif choice == 1:
        lines.insert(at, line)
    elif choice == 2:
        lines[at] = "  " + line
    elif choice == 3:
        lines[at] = line.replace(": ", ":", 1)
    else:
        place = int(random.integers(len(line)))
        junk = str(random.choice(list("-:{}[]\"'#&*!|>%@`1e\t\x00é")))
        lines[at] = line[:place] + junk + line[place + (choice == 5) :]
    return "".join(lines).encode()


def mutate_bytes(content: bytes, random: Random) -> bytes:
    """A flip, a cut or a piece twice."""
    choice, at = random.integers(3), int(random.integers(1, len(content)))
    if choice == 0:
        return flip(content, random)
    return content[:at] if choice == 1 else content[:at] + content[at // 2 :]
