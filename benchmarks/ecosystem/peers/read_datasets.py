"""Hugging Face datasets: every configuration of a parquet export, all rows."""

import sys

import datasets

folder, cache, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])
names = datasets.get_dataset_config_names(folder)
rows = [datasets.load_dataset(folder, n, split="train", cache_dir=cache).num_rows for n in names]
assert sum(rows) == steps, rows
print(datasets.__version__, f"{len(names)} configurations, {sum(rows):,} rows")
