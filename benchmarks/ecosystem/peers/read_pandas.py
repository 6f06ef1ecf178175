"""pandas: the task index of a LeRobot tree, and one row per step."""

import pathlib
import sys

import pandas

folder, steps = pathlib.Path(sys.argv[1]), int(sys.argv[3])
tasks = pandas.read_parquet(folder / "meta/tasks.parquet")
assert tasks.index.name == "task" and list(tasks.columns) == ["task_index"]
rows = sum(len(pandas.read_parquet(path)) for path in folder.glob("data/*/*.parquet"))
assert rows == steps, rows
print(pandas.__version__, f"{len(tasks)} tasks by their text, {rows:,} rows")
