"""What describes a Parquet export to others: the dataset card, and Croissant metadata.

Source: the Croissant format 1.0 of MLCommons; Hugging Face's YAML header of dataset cards.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from mpdt.data.exchange.manifest import Manifest
from mpdt.disk import sha256
from mpdt.version import __version__

_TERMS = (
    "arrayShape", "citeAs", "column", "equivalentProperty", "extract", "field", "fileObject",
    "fileProperty", "fileSet", "format", "includes", "isArray", "isLiveDataset", "jsonPath",
    "key", "md5", "parentField", "path", "recordSet", "references", "regex", "repeated",
    "replace", "samplingRate", "separator", "source", "subField", "transform",
)  # fmt: skip
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS},
}
_TYPES = {"float": "sc:Float", "double": "sc:Float", "bool": "sc:Boolean", "string": "sc:Text"}


def describe(manifest: Manifest, folder: Path) -> dict[str, Any]:
    """Croissant metadata of the Parquet files below `folder`, as JSON values."""
    header = manifest.header
    files = sorted(folder.rglob("*.parquet"))
    objects = [
        {
            "@type": "cr:FileObject",
            "@id": path.relative_to(folder).as_posix(),
            "name": path.relative_to(folder).as_posix(),
            "contentUrl": path.relative_to(folder).as_posix(),
            "encodingFormat": "application/x-parquet",
            "sha256": sha256(path),
        }
        for path in files
    ]
    records = [_records(path, folder, pq.read_schema(path)) for path in files]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": header.name,
        "version": header.version,
        "license": header.license,
        "description": _summary(manifest),
        "distribution": objects,
        "recordSet": records,
    }


def _records(path: Path, folder: Path, schema: Any) -> dict[str, Any]:
    file = path.relative_to(folder).as_posix()
    name = file.removesuffix(".parquet")
    fields = []
    for column in schema:
        is_vector = hasattr(column.type, "list_size")
        inner = str(column.type.value_type if is_vector else column.type)
        field = {
            "@type": "cr:Field",
            "@id": f"{name}/{column.name}",
            "name": column.name,
            "dataType": _TYPES.get(inner, "sc:Integer" if "int" in inner else "sc:Text"),
            "source": {"fileObject": {"@id": file}, "extract": {"column": column.name}},
        }
        if is_vector:
            field |= {"isArray": True, "arrayShape": str(column.type.list_size)}
        fields.append(field)
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "field": fields}


def readme(manifest: Manifest, qualities: Sequence[str]) -> str:
    """The dataset card; its YAML header tells Hugging Face datasets which files are what."""
    header = manifest.header
    configs = "".join(
        f"- config_name: {name}\n  data_files:\n  - split: train\n    path: data/{name}/*.parquet\n"
        for name in qualities
    )
    tasks = ", ".join(task.name for task in header.tasks)
    return f"""---
license: {json.dumps(header.license.lower())}
task_categories: [reinforcement-learning, robotics]
configs:
{configs}---

# {header.name} {header.version}

{_summary(manifest)}

Tasks: {tasks}.

`data/<quality>` has one row per step and one row group per episode. `episodes.parquet` has one
row per episode, with its seed key and the observation after the last step; `task`, `goal` and
`policy` are rows of the tables of these names. Content hash {manifest.content_hash}.

    SELECT task_name, quality_name, avg("return") FROM 'episodes.parquet' GROUP BY ALL
"""


def _summary(manifest: Manifest) -> str:
    header = manifest.header
    return (
        f"{manifest.num_episodes:,} episodes of {manifest.num_steps:,} steps of the family "
        f"{header.family}, {len(header.tasks)} tasks; observations of {header.observation_size} "
        f"and actions of {header.action_size} numbers. Written by mpdt {__version__}."
    )
