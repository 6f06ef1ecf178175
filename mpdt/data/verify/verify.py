"""Verify: everything a file can prove about itself, as a list of findings. It never raises for
what is in the file.

    format ── shapes ── one pass over all steps: hash, values, flags, returns, duplicates
       '         '      tables: quality, leak, claims, tta  simulator: replay
       '---------'----- what builds on a failed one is skipped
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mpdt.data.lock.file import LockEntry, read_lock
from mpdt.data.store.origin import damaged_hint
from mpdt.data.verify.amount import SHARE, Amount
from mpdt.data.verify.claims import check_claims
from mpdt.data.verify.duplicates import DuplicatesCheck
from mpdt.data.verify.file_format import open_unchecked
from mpdt.data.verify.finding import Finding, Outcome
from mpdt.data.verify.flags import FlagsCheck
from mpdt.data.verify.hashes import HashCheck
from mpdt.data.verify.leak import check_leak
from mpdt.data.verify.material import Material, read_material
from mpdt.data.verify.quality import check_quality
from mpdt.data.verify.replay import check_replay
from mpdt.data.verify.returns import ReturnsCheck
from mpdt.data.verify.shapes import check_shapes
from mpdt.data.verify.streaming import StepCheck
from mpdt.data.verify.tta import check_tta
from mpdt.data.verify.values import ValuesCheck
from mpdt.draw.table import markdown_table
from mpdt.errors import FormatError, MpdtError, UsageError, quoted, unknown_name
from mpdt.pace import Pace

CHECKS = (
    "format", "hash", "shapes", "values", "flags", "returns", "quality", "duplicates", "leak",
    "claims", "tta", "replay",
)  # fmt: skip


@dataclass(frozen=True)
class Report:
    """Findings in the order of CHECKS; `content_hash` is empty where the file cannot be read."""

    path: Path
    content_hash: str
    findings: Sequence[Finding]

    def count(self, outcome: Outcome) -> int:
        return sum(finding.outcome is outcome for finding in self.findings)


def verify(
    path: Path,
    *,
    only: Sequence[str] = (),
    skip: Sequence[str] = (),
    replay: str | None = None,
    lock: Path | None = None,
    say: Callable[[str], None] = lambda line: None,
    workers: int = 0,
) -> Report:
    """Check a file. Memory does not grow with it.

    Args:
        only, skip: ids of CHECKS. `format` and `shapes` are looked at in any case, and told of
            if they fail.
        replay: `2%` of each run, a number of episodes in all, or `all`; then, or with the check in
            `only` and no import, it fails where nothing can be replayed. None: 2 %, as far as
            that goes.
        lock: datasets.lock to compare with.
        say: told what takes long.
        workers: processes for long replays, which in a script need `if __name__ == "__main__":`;
            0 = none.
    Raises: UsageError for an id or amount; MissingFileError; StorageError; FormatError for a
        lock that cannot be read.
    """
    for id in (*only, *skip):
        if id not in CHECKS:
            raise unknown_name("check", id, CHECKS)
    if workers < 0:
        raise UsageError("a negative number of workers", found=str(workers))
    wanted = {id for id in CHECKS if (not only or id in only) and id not in skip}
    amount = Amount.parse(SHARE if replay is None else replay)
    entries = read_lock(lock) if lock else {}
    with np.errstate(all="ignore"):
        material, found = _open(path)
        if material is not None:
            # Of an import the check alone asks for what stands in a replay's place.
            asked = replay is not None or ("replay" in only and not material.is_imported)
            entry = (str(lock), entries.get(material.dataset.name)) if lock else None
            found += _stream(_step_checks(material, wanted, entry), material, say)
            for id, check in (
                ("quality", check_quality), ("leak", check_leak),
                ("claims", partial(check_claims, lock=entry)), ("tta", check_tta),
                ("replay", partial(check_replay, amount=amount, asked=asked, say=say,
                                   workers=workers)),
            ):  # fmt: skip
                if id in wanted:
                    found.append(_guarded(id, path, partial(check, material)))
    by_id = {finding.id: finding for finding in found}
    failed = next((one for one in found if one.outcome is Outcome.FAIL), None)
    shown = []
    for id in CHECKS:
        if id in by_id:
            if id in wanted or by_id[id].outcome is Outcome.FAIL:
                shown.append(by_id[id])
        elif id in wanted and failed is not None:
            shown.append(Finding(id, Outcome.SKIP, f"builds on {failed.id}"))
    return Report(path, material.dataset.content_hash if material else "", shown)


def verify_all(
    paths: Sequence[Path],
    *,
    replay: str | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Report:
    """`verify` of each file; of several each finding begins with the name of its file."""
    reports = [verify(path, replay=replay, say=say) for path in paths]
    if len(reports) == 1:
        return reports[0]
    findings = [
        replace(finding, text=f"{report.path.name}: {finding.text}")
        for report in reports
        for finding in report.findings
    ]
    return Report(paths[0], "", findings)


def _open(path: Path) -> tuple[Material | None, list[Finding]]:
    """The file if its format and shapes allow a look at its steps, and these two findings."""
    try:
        dataset, finding = open_unchecked(path)
        material = None if dataset is None else read_material(path, dataset)
    except FormatError as error:
        hint = error.hint or damaged_hint(path)
        return None, [Finding("format", Outcome.FAIL, error.message(), hint=hint)]
    if material is None:
        return None, [finding]
    shapes = _guarded("shapes", path, lambda: check_shapes(material))
    sound = shapes.outcome is not Outcome.FAIL
    return (material if sound else None), [finding, shapes]


def _step_checks(
    material: Material, wanted: set[str], lock: tuple[str, LockEntry | None] | None
) -> list[StepCheck]:
    checks: list[StepCheck] = [
        HashCheck(material, lock), ValuesCheck(material), FlagsCheck(material),
        ReturnsCheck(material), DuplicatesCheck(material),
    ]  # fmt: skip
    return [check for check in checks if check.id in wanted]


def _stream(
    checks: Sequence[StepCheck], material: Material, say: Callable[[str], None]
) -> list[Finding]:
    """One pass over the steps with all checks; one that breaks does not stop the others."""
    if not checks:
        return []
    broken: dict[str, Finding] = {}
    pace = Pace()
    for track in material.tracks():
        for chunk in track.chunks():
            for check in checks:
                if check.id not in broken:
                    failed = _run(check.id, material.path, partial(check.look, track, chunk))
                    if failed is not None:
                        broken[check.id] = failed
            if pace.is_time():
                say(f"verify   {chunk.last:,}/{len(track):,} episodes")
    return [
        broken.get(check.id) or _guarded(check.id, material.path, check.finding) for check in checks
    ]


def _run(id: str, path: Path, step: Callable[[], object]) -> Finding | None:
    """Do one step of a check; the finding of one that broke."""
    try:
        step()
    except MpdtError as error:
        return Finding(id, Outcome.FAIL, error.message(), hint=error.hint or damaged_hint(path))
    except Exception as error:  # noqa: BLE001  whatever the file holds, a check may not crash
        what = f"could not be looked at: {type(error).__name__}: {error}"
        return Finding(id, Outcome.FAIL, what, hint=damaged_hint(path))
    return None


def _guarded(id: str, path: Path, check: Callable[[], Finding]) -> Finding:
    """The finding of a check, also of one that broke."""
    found: list[Finding] = []
    return _run(id, path, lambda: found.append(check())) or found[0]


def summary(findings: Iterable[Finding]) -> str:
    """`10 passed, 1 warning`."""
    counts = dict.fromkeys(Outcome, 0)
    for finding in findings:
        counts[finding.outcome] += 1
    words = [f"{counts[Outcome.PASS]} passed"]
    if counts[Outcome.WARN]:
        words.append(f"{counts[Outcome.WARN]} warning{'s' if counts[Outcome.WARN] > 1 else ''}")
    if counts[Outcome.FAIL]:
        words.append(f"{counts[Outcome.FAIL]} failed")
    if counts[Outcome.SKIP]:
        words.append(f"{counts[Outcome.SKIP]} skipped")
    if counts[Outcome.NONE]:
        words.append(f"{counts[Outcome.NONE]} with nothing to check")
    return ", ".join(words)


def markdown(report: Report) -> str:
    """The findings as a page; the file by its name only, so that the page tells no path."""
    rows = [
        (one.id, one.outcome.value, one.text, f"`{one.hint}`" if one.hint else "")
        for one in report.findings
    ]
    table = markdown_table(("check", "outcome", "finding", "next"), rows, numbers=False)
    known = f"Content `{report.content_hash or 'unknown'}`: {summary(report.findings)}."
    return f"# mpdt-data verify {quoted(report.path.name)}\n\n{known}\n\n{table}\n"
