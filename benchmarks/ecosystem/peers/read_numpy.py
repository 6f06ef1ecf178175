"""NumPy: the npz arrays, cut at the rows that hold only a final observation."""

import pathlib
import sys

import numpy as np

path = next(pathlib.Path(sys.argv[1]).rglob("*.npz"))
arrays = np.load(path, allow_pickle=False)
assert int(arrays["valids"].sum()) == int(sys.argv[3])
assert len(arrays["observations"]) == len(arrays["valids"])
print(np.__version__, f"{int(arrays['valids'].sum()):,} steps, {len(arrays.files)} arrays")
