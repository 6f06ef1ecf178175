"""Verbs that compare: verify a file with itself, lock with datasets.yaml. Bodies import lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Options, split_names, text_table

Ids = Annotated[tuple[str, ...], arg(metavar="ID[,ID...]")]


@dataclass(frozen=True, kw_only=True)
class Verify(Options):
    """Check everything a dataset file can prove about itself; exit code 1 if a check fails.

    Checks: format, hash, shapes, values, flags, returns, quality, duplicates, leak, claims, tta,
    replay.

    Examples:
      mpdt-data verify cheetah_dir.h5 --locked
      mpdt-data verify ml10.h5 --replay all --markdown ml10-verify.md
      mpdt-data verify ml10.h5 --skip replay,duplicates --fail-on warn
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """File to check; put it before --only and --skip."""
    replay: Annotated[str | None, arg(metavar="2%|N|all")] = None
    """Episodes to simulate again: a share of each quality of each task, a number, or all; where
    none can be, the check then fails. Default 2%, as far as that goes."""
    workers: Annotated[int | None, arg(metavar="N")] = None
    """Processes for long replays; default one per core, 0 = none."""
    locked: bool = False
    """Compare with datasets.lock too."""
    only: Ids = ()
    """Only these checks."""
    skip: Ids = ()
    """All but these checks."""
    fail_on: Literal["fail", "warn"] = "fail"
    """What makes the exit code 1."""
    markdown: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the findings there too."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """The datasets.yaml whose lock counts; default as in collect."""

    def run(self) -> None:
        from mpdt.data.lock.file import lock_path
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.verify.finding import Outcome
        from mpdt.data.verify.verify import markdown, summary, verify
        from mpdt.data.workers.processes import default_workers
        from mpdt.disk import check_replaceable, write_bytes
        from mpdt.errors import DataError

        like = b"# mpdt-data verify"
        if self.markdown is not None:
            check_replaceable(self.markdown, like)
        report = verify(
            self.file,
            only=split_names(self.only),
            skip=split_names(self.skip),
            replay=self.replay,
            lock=lock_path(load_catalog(self.spec).path) if self.locked else None,
            say=self.say,
            workers=default_workers() if self.workers is None else self.workers,
        )
        findings = report.findings
        if self.markdown is not None:
            write_bytes(self.markdown, markdown(report).encode(), like=like)
        self.print(
            {
                "path": str(report.path),
                "content_hash": report.content_hash,
                "summary": summary(findings),
                "checks": [one.as_json() for one in findings],
            },
            "\n".join([line for one in findings for line in one.lines()] + [summary(findings)]),
        )
        bad = [Outcome.FAIL] + [Outcome.WARN] * (self.fail_on == "warn")
        if failed := [one for one in findings if one.outcome in bad]:
            raise DataError(
                f"{len(failed)} of {len(findings)} checks: {', '.join(one.id for one in failed)}",
                where=str(self.file),
                hint=next((one.hint for one in failed if one.hint), ""),
            )


@dataclass(frozen=True, kw_only=True)
class Lock(Options):
    """Compare datasets.lock with datasets.yaml and with the files that are there.

    Nothing is simulated, and of the files only the headers are read (verify --locked reads all).
    With --check the exit code is 1 if a spec changed or a file is not the locked one.

    Examples:
      mpdt-data lock
      mpdt-data lock --check
      mpdt-data lock --check --dir data --json
    """

    check: bool = False
    """Fail on anything that is not as locked."""
    dir: Annotated[Path, arg(metavar="FOLDER")] = Path()
    """Folder with the files."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """Another datasets.yaml than ./datasets.yaml or the shipped one."""

    def run(self) -> None:
        from mpdt.data.lock.file import lock_path
        from mpdt.data.lock.states import lock_states
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.errors import DataError, Lines

        catalog = load_catalog(self.spec)
        path = lock_path(catalog.path)
        states = lock_states(catalog, path, self.dir)
        heading = ("name", "locked", "spec", "file")
        cells = [[one.name, one.locked or "-", one.spec, one.file] for one in states]
        rows: list[dict[str, Any]] = [
            {"name": one.name, "locked": one.locked, "spec": one.spec, "file": one.file,
             "problem": one.problem, "hint": one.hint}
            for one in states
        ]  # fmt: skip
        text = f"{path} against {catalog.path}\n" + text_table([heading, *cells], numbers_from=9)
        self.print({"lock": str(path), "catalog": str(catalog.path), "rows": rows}, text)
        problems = [one for one in states if one.problem]
        if self.check and problems:
            raise DataError(
                Lines.of(f"{len(problems)} not as locked", *(one.problem for one in problems)),
                where=str(path),
                hint=problems[0].hint,
            )
