"""OGBench: its loader on a pair of files, both of its forms, against each other."""

import importlib.metadata
import pathlib
import sys

import numpy as np
from ogbench.utils import load_dataset

folder, steps = pathlib.Path(sys.argv[1]), int(sys.argv[3])
pairs = [path for path in sorted(folder.glob("*.npz")) if not path.stem.endswith("-val")]
total = 0
for path in pairs:
    for half in (path, path.with_name(f"{path.stem}-val.npz")):
        plain, compact = load_dataset(half), load_dataset(half, compact_dataset=True)
        rows = compact["valids"].astype(bool)
        assert np.array_equal(compact["observations"][rows], plain["observations"])
        after = np.flatnonzero(rows) + 1
        assert np.array_equal(compact["observations"][after], plain["next_observations"])
        assert len(plain["actions"]) == rows.sum() and plain["terminals"][-1] == 1
        total += len(plain["actions"])
assert total == steps, total
version = importlib.metadata.version("ogbench")
print(version, f"{len(pairs)} pairs of files, {total:,} transitions, both forms of its loader")
