"""The pickle layout of Prompt-DT, read as its code does: split, pickle, numpy, nothing of ours."""

import json
import pathlib
import pickle
import sys

import numpy as np

folder, steps = pathlib.Path(sys.argv[1]), int(sys.argv[3])
keys = {"observations", "actions", "rewards", "next_observations", "terminals"}
rows, files = 0, 0
for path in sorted(folder.rglob("*.pkl")):
    if path.name.startswith("config_"):
        continue
    episodes = pickle.loads(path.read_bytes())
    for one in episodes:
        length = len(one["rewards"])
        assert keys <= set(one) and {len(one[key]) for key in keys} == {length}
        assert one["terminals"][-1] and not one["terminals"][:-1].any()
        assert np.array_equal(one["observations"][1:], one["next_observations"][:-1])
        rows += 0 if "-prompt-" in path.name else length
    files += 1
assert rows == steps, rows
(split,) = (folder / "config").glob("*/*.json")
tasks = json.loads(split.read_text())
assert split.stem == f"{tasks['env']}_{tasks['total_tasks']}"
for i in {*tasks["train_tasks"], *tasks["test_tasks"]}:  # as load_data_prompt opens them
    for name in (f"{i}-expert", f"{i}-prompt-expert"):
        assert (folder / f"data/{tasks['env']}/{tasks['env']}-{name}.pkl").exists(), name
told = f"{len(tasks['train_tasks'])} training and {len(tasks['test_tasks'])} test tasks"
print(np.__version__, f"{files} files, {rows:,} steps; {told} in {split.name}")
