"""Exports of a dataset file, read by the packages they are made for.

    mpdt-data export FILE --to parquet|lerobot|minari|npz -o ...
    python -m venv /tmp/eco && /tmp/eco/bin/pip install -r benchmarks/ecosystem.txt
    python benchmarks/ecosystem.py FILE --python /tmp/eco/bin/python

The packages live in an environment of their own: some want versions that mpdt does not. Each
check is one line of the table: what, with which version, and what was read. Exit code 1 where
one failed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from mpdt.data.store.reader import open_dataset

# Each runs in the other environment with FOLDER as argument and prints one line.
CHECKS = {
    ("Hugging Face datasets", "parquet"): """
import datasets
names = datasets.get_dataset_config_names(folder)
rows = [datasets.load_dataset(folder, n, split="train", cache_dir=cache).num_rows for n in names]
assert sum(rows) == steps, rows
print(datasets.__version__, f"{len(names)} configurations, {sum(rows)} rows")
""",
    ("duckdb", "parquet"): """
import duckdb
query = f'''SELECT task_name, quality_name, avg("return") r FROM '{folder}/episodes.parquet'
            GROUP BY ALL ORDER BY ALL'''
rows = duckdb.sql(query).fetchall()
summed = duckdb.sql(f"SELECT sum(reward) FROM '{folder}/data/*/*.parquet'")
total = duckdb.sql(f'''SELECT sum("return") FROM '{folder}/episodes.parquet' ''')
a, b = summed.fetchall()[0][0], total.fetchall()[0][0]
assert abs(a - b) <= 1e-6 * max(1, abs(b)), (a, b)
some = ", ".join(f"{task} {quality} {mean:.1f}" for task, quality, mean in rows[:2])
print(duckdb.__version__, "mean return", some, "...")
""",
    ("mlcroissant", "parquet"): """
import importlib.metadata
import mlcroissant
data = mlcroissant.Dataset(jsonld=folder + "/croissant.json")
issues = data.metadata.ctx.issues
assert not issues.errors, issues.report()
name = next(r.uuid for r in data.metadata.record_sets if r.uuid.startswith("data/"))
record = next(iter(data.records(name)))
print(importlib.metadata.version("mlcroissant"), f"first record of {name}: {len(record)} fields")
""",
    ("pandas", "lerobot"): """
import pandas
tasks = pandas.read_parquet(folder + "/meta/tasks.parquet")
assert tasks.index.name == "task" and list(tasks.columns) == ["task_index"]
print(pandas.__version__, f"{len(tasks)} tasks by their text")
""",
    ("lerobot-doctor", "lerobot"): """
import importlib.metadata, pathlib, re, subprocess
program = pathlib.Path(sys.executable).with_name("lerobot-doctor")
done = subprocess.run([program, folder], capture_output=True, text=True)
found = re.search(r"Summary: .*", done.stdout)
assert found and "FAIL" not in found.group(), done.stdout + done.stderr
print(importlib.metadata.version("lerobot-doctor"), found.group())
""",
    ("minari", "minari"): """
import json, os, pathlib
os.environ["MINARI_DATASETS_PATH"] = folder
import minari
names = sorted(minari.list_local_datasets())
total = sum(minari.load_dataset(name).total_steps for name in names)
assert total == steps, total
print(minari.__version__, f"{len(names)} sets, {total} steps")
""",
}
PRELUDE = "import sys\nfolder, cache, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--python", default=sys.executable, help="interpreter with the packages")
    options = parser.parse_args()
    dataset = open_dataset(options.file)
    work = Path(tempfile.mkdtemp(prefix="ecosystem-"))
    failed = 0
    print("| package | format | result |\n|---|---|---|")
    for (package, form), code in CHECKS.items():
        folder = work / form
        if not folder.exists():
            export = ["-m", "mpdt.data.cli", "export", str(options.file), "--to", form, "-q"]
            subprocess.run([sys.executable, *export, "-o", str(folder)], check=True,
                           stdout=subprocess.DEVNULL)  # fmt: skip
        words = [str(folder), str(work / "cache"), str(dataset.num_steps)]
        done = subprocess.run([options.python, "-c", PRELUDE + code, *words], capture_output=True,
                              text=True, check=False)  # fmt: skip
        failed += done.returncode != 0
        lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
        text = lines[-1] if lines else "no output"
        print(f"| {package} | {form} | {'' if done.returncode == 0 else 'FAILED: '}{text} |")
    print(json.dumps({"file": options.file.name, "failed": failed}), file=sys.stderr)
    shutil.rmtree(work)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
