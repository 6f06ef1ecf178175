"""Verbs that only look: list, show, info. Bodies import lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Names, Options, number, split_names, text_table

if TYPE_CHECKING:
    from mpdt.data.spec.entry import DatasetSpec


@dataclass(frozen=True, kw_only=True)
class List(Options):
    """List the entries of datasets.yaml and the dataset files of a folder, with their state.

    ok: made from this entry as it is now; stale: from another state of it; missing; damaged.

    Examples:
      mpdt-data list
      mpdt-data list --dir data
      mpdt-data list --spec my.yaml --json
    """

    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """Another datasets.yaml than ./datasets.yaml or the shipped one."""
    dir: Annotated[Path, arg(metavar="FOLDER")] = Path()
    """Folder with the files."""

    def run(self) -> None:
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.reading import missing

        if not self.dir.is_dir():
            raise missing(self.dir, "no such folder")
        catalog = load_catalog(self.spec)
        rows = [_entry_row(spec, self.dir / f"{name}.h5") for name, spec in catalog.specs.items()]
        named = {row["file"] for row in rows}
        rows += [
            _file_row(path) for path in sorted(self.dir.glob("*.h5")) if str(path) not in named
        ]
        heading = ("name", "version", "family", "state", "file", "episodes")
        cells = [[str(row[key]) for key in heading] for row in rows]
        self.print(
            {"catalog": str(catalog.path), "rows": rows},
            f"entries of {catalog.path}\n"
            + text_table([heading, *cells], numbers_from=5)
            + "".join(
                f"\n{row['name']} acts with weights that mpdt does not ship: {row['weights']}"
                for row in rows
                if row.get("weights")
            ),
        )


def _entry_row(spec: DatasetSpec, path: Path) -> dict[str, Any]:
    from mpdt.data.spec.entry import own_weights, spec_hash

    row: dict[str, Any] = {
        "name": spec.name,
        "version": spec.version,
        "family": spec.family,
        "episodes": "",
    }
    if path_of_weights := own_weights(spec.behaviour):
        row["weights"] = path_of_weights
    if not path.exists():
        parts = path.with_name(path.name + ".parts")
        return row | {"state": "unfinished" if parts.is_dir() else "missing", "file": str(path)}
    found = _file_row(path)
    if found["state"] == "ok" and found.pop("spec_hash") != spec_hash(spec):
        found["state"] = "stale"
    return row | {key: found[key] for key in ("state", "file", "episodes")}


def _file_row(path: Path) -> dict[str, Any]:
    from mpdt.data.store.reader import open_dataset
    from mpdt.errors import MpdtError, StorageError

    try:
        data = open_dataset(path)
    except MpdtError as error:
        damaged = "" if isinstance(error, StorageError) else "damaged: "
        return {
            "name": "", "version": "", "family": "", "state": f"{damaged}{error.what}",
            "file": str(path), "episodes": "",
        }  # fmt: skip
    return {
        "name": data.name, "version": data.version, "family": data.family,
        "state": "cut-out" if data.parent else "ok", "file": str(path),
        "episodes": data.num_episodes, "spec_hash": data.spec_hash,
    }  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Show(Options):
    """Show what is in a dataset file: header, tasks and their returns, slices, TTA sets.

    Examples:
      mpdt-data show cheetah_dir.h5
      mpdt-data show ml10.h5:expert --tasks reach,push --episodes 5
      mpdt-data show 'parts/*.h5' --tasks reach
    """

    file: Annotated[Positional[str], arg(metavar="FILE[:SLICE]")]
    """File, or one slice of it; a folder, a pattern or A.h5,B.h5: several files as one."""
    tasks: Names = ()
    """Only these tasks."""
    episodes: Annotated[int, arg(metavar="N")] = 0
    """List the first N episodes too."""
    schema: bool = False
    """Show the arrays of the file format instead."""

    def run(self) -> None:
        import numpy as np

        from mpdt.data.slices.several import open_ref
        from mpdt.data.verbs.describe import (
            describe,
            describe_episode,
            header_lines,
            level_table,
            reference_table,
            schema,
        )
        from mpdt.errors import check_at_least

        check_at_least("--episodes", self.episodes, 0)
        data, slice_name = open_ref(self.file)
        names = split_names(self.tasks) or None
        ids = data.select(task=names, slice=slice_name)
        if self.schema:
            self.print(*schema())
            return
        found = describe(data, ids)
        text = [*header_lines(found), "", level_table(data, ids, names)]
        if references := reference_table(data, names):
            text += ["", references]
        if data.slices:
            text += [
                "",
                "slices   " + ", ".join(f"{n} ({len(i):,})" for n, i in data.slices.items()),
            ]
        for name, tta in data.tta.items():
            tasks = [data.tasks.names[int(row)] for row in np.unique(tta.task)]
            text.append(f"tta      {name}: {len(tta):,} episodes of {', '.join(tasks)}")
        if self.episodes:
            found["listed"] = [describe_episode(data, int(i)) for i in ids[: self.episodes]]
            heading = ("id", "task", "quality", "length", "return", "success", "seed key")
            cells = [
                [str(e["id"]), e["task"], e["quality"], str(e["length"]), number(e["return"]),
                 str(e["success"]).lower(), "/".join(map(str, e["seed_key"]))]
                for e in found["listed"]
            ]  # fmt: skip
            text += ["", text_table([heading, *cells], numbers_from=3)]
        self.print(found, "\n".join(text))


@dataclass(frozen=True, kw_only=True)
class Info(Options):
    """Versions, machine and surroundings, to paste into a bug report; or what is missing here.

    With --check the exit code is 2 if mpdt lacks a package that it cannot do without.

    Examples:
      mpdt-data info
      mpdt-data info --check
      mpdt-data info > versions.txt
    """

    check: bool = False
    """Say what each part needs that is not there, what for, and how to get it."""

    def run(self) -> None:
        if self.check:
            self._check()
            return
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.store import provenance
        from mpdt.data.verbs.surroundings import other_packages, surroundings
        from mpdt.data.workers.processes import default_workers

        catalog = load_catalog()
        found: dict[str, dict[str, str]] = {
            "packages": provenance.packages() | other_packages(),
            "machine": provenance.machine() | {"cores": str(default_workers())},
            "surroundings": surroundings(),
            "catalog": {"datasets.yaml": str(catalog.path), "entries": str(len(catalog.specs))},
        }
        rows = [row for part in found.values() for row in part.items()]
        self.print(found, text_table(rows, numbers_from=9))

    def _check(self) -> None:
        from dataclasses import asdict

        from mpdt.data.verbs.needs import REQUIRED, needs
        from mpdt.errors import UsageError

        found = needs()
        rows = [("part", "for", "", "to get it"), *(
            (one.part, one.gives, f"missing: {', '.join(one.lacks)}" if one.lacks else "there",
             one.get) for one in found)]  # fmt: skip
        self.print([asdict(one) for one in found], text_table(rows, numbers_from=9))
        if lacks := next(one.lacks for one in found if one.part == REQUIRED):
            raise UsageError("packages are missing that mpdt needs for everything",
                             where="this installation", found=", ".join(lacks),
                             hint="pip install mpdt")  # fmt: skip
