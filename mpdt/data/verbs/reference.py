"""The verb that measures references. Its body imports lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from mpdt.data.verbs.make import Output, Workers
from mpdt.data.verbs.options import (
    Names,
    Options,
    number,
    split_names,
    split_steps,
    text_table,
)

if TYPE_CHECKING:
    from mpdt.data.sim.measure import Campaign


@dataclass(frozen=True, kw_only=True)
class Reference(Options):
    """Measure what zero, random, the best constant and the expert earn on every task.

    The references of the shipped entries are shipped too. Those measured here win over them in
    every collection started from this folder; delete the file to go back. Stop and start it as
    you like: what the file holds already is kept.

    Of a dataset file they are measured at its horizon, with its options, and entered in it as well.

    Examples:
      mpdt-data reference cheetah_dir
      mpdt-data reference vel.h5
      mpdt-data reference ml10 --horizons 200,500 --policies zero,random,constant
      mpdt-data reference mt50 --seed 2 -o other.json
    """

    name: Annotated[Positional[str], arg(metavar="NAME|FILE")]
    """Entry of datasets.yaml, or a dataset file NAME.h5."""
    horizons: Names = ()
    """Episode lengths in steps; default: the entry's own."""
    policies: Names = ()
    """Only these of zero, random, constant, expert; default: all."""
    seed: int = 1
    """Root seed of the measured episodes."""
    most: Annotated[int, arg(metavar="N")] = 1280
    """Episodes per task and policy after which to give up being precise."""
    workers: Workers = None
    """Processes; default one per core."""
    restart: bool = False
    """Measure again what is on record already."""
    output: Output = None
    """File to add to; default: where collect looks for it, here."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """Another datasets.yaml than ./datasets.yaml or the shipped one."""

    def run(self) -> None:
        from mpdt.data.collect.standing import recorded_references, standing_spec
        from mpdt.data.sim.measure import KINDS, measure
        from mpdt.data.sim.record import LOCAL_FILE
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.store.amend import set_references
        from mpdt.data.store.reader import open_dataset
        from mpdt.data.workers.processes import default_workers
        from mpdt.disk import check_replaceable
        from mpdt.errors import UsageError, unknown_name

        kinds = split_names(self.policies) or KINDS
        for kind in kinds:
            if kind not in KINDS:
                raise unknown_name("policy", kind, KINDS, where="--policies")
        horizons = split_steps(self.horizons, where="--horizons")
        target, file = self.output or Path(LOCAL_FILE), _file(self.name)
        if file is None:
            spec = load_catalog(self.spec).get(self.name)
        else:
            if horizons or self.output or self.spec:
                raise UsageError(
                    "a file has its own horizon, and takes what is measured here",
                    where=str(file),
                    hint="leave out --horizons, -o and --spec",
                )
            spec = standing_spec(open_dataset(file))
            check_replaceable(file)  # what is measured goes into it at the end
        campaign = measure(
            spec, target, horizons=horizons,
            kinds=kinds, seed=self.seed, cap=self.most, restart=self.restart,
            workers=default_workers() if self.workers is None else self.workers,
            on_progress=self.say,
        )  # fmt: skip
        rows = summary(campaign)
        if file is not None:
            set_references(file, recorded_references(spec))
        written = f"{target}, {file}" if file else str(target)
        self.print({"path": str(target), "references": rows}, f"{table(rows)}\nwrote  {written}")


def _file(name: str) -> Path | None:
    """The file that is meant; names of entries have no ending and lie in no folder."""
    path = Path(name)
    return path if path.suffix in (".h5", ".hdf5") or len(path.parts) > 1 else None


def summary(campaign: Campaign) -> list[dict[str, Any]]:
    """Every score of a campaign, with its error as a share of the span."""
    rows = []
    for horizon in campaign.horizons:
        for task, policies in campaign.policies.items():
            span = campaign.span(task, horizon)
            for policy in policies:
                if score := campaign.score(task, policy, horizon):
                    rows.append({
                        "task": task.name, "horizon": horizon, "policy": policy.partition(":")[0],
                        "mean": score.mean, "error": round(score.error, 4),
                        "episodes": score.episodes, "success": score.success,
                        "share": round(score.error / abs(span), 4) if span else None,
                    })  # fmt: skip
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """One line per task and horizon: each policy's mean and error, and the worst share."""
    shown = ("zero", "random", "expert")
    heading = ("task", "steps", *shown, "episodes", "success", "worst error / span")
    cells = [heading]
    for task, horizon in dict.fromkeys((row["task"], row["horizon"]) for row in rows):
        own = [row for row in rows if (row["task"], row["horizon"]) == (task, horizon)]
        by_name = {row["policy"]: row for row in own}
        means = [
            f"{number(by_name[name]['mean'])} +- {number(by_name[name]['error'])}"
            if name in by_name else "-"
            for name in shown
        ]  # fmt: skip
        success = by_name.get("expert", {}).get("success")
        worst = max(own, key=lambda row: row["share"] or 0.0)
        cells.append((
            task, str(horizon), *means, f"{sum(row['episodes'] for row in own):,}",
            "-" if success is None else f"{success:.2f}",
            "-" if worst["share"] is None else f"{worst['share']:.2%} {worst['policy']}",
        ))  # fmt: skip
    return text_table(cells, numbers_from=1)
