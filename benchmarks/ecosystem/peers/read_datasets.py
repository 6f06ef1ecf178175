"""Hugging Face datasets: every configuration of a parquet export, all rows; one as a stream."""

import sys

import datasets

folder, cache, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])
names = datasets.get_dataset_config_names(folder)
rows = [datasets.load_dataset(folder, n, split="train", cache_dir=cache).num_rows for n in names]
assert sum(rows) == steps, rows
stream = datasets.load_dataset(folder, names[0], split="train", streaming=True, cache_dir=cache)
whole = datasets.load_dataset(folder, names[0], split="train", cache_dir=cache)
count = 0
for count, row in enumerate(stream, 1):
    if count <= 3:
        assert row == whole[count - 1], count
assert count == whole.num_rows
print(
    datasets.__version__,
    f"{len(names)} configurations, {sum(rows):,} rows; {count:,} of them as a stream",
)
