"""mlcroissant: the metadata of a parquet export, and its first record."""

import importlib.metadata
import sys

import mlcroissant

data = mlcroissant.Dataset(jsonld=sys.argv[1] + "/croissant.json")
issues = data.metadata.ctx.issues
assert not issues.errors, issues.report()
name = next(r.uuid for r in data.metadata.record_sets if r.uuid.startswith("data/"))
record = next(iter(data.records(name)))
print(importlib.metadata.version("mlcroissant"), f"first record of {name}: {len(record)} fields")
