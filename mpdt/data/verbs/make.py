"""Verbs that make data: plan, collect, pretrain, calibrate. Bodies import lazily."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from mpdt.data.verbs.options import Names, Options, split_names, split_steps

if TYPE_CHECKING:
    from mpdt.data.collect.engine import Engine
    from mpdt.data.collect.job import Job
    from mpdt.data.collect.plan import Plan
    from mpdt.data.lock.keeper import LockKeeper
    from mpdt.data.spec.catalog import Catalog
    from mpdt.data.spec.entry import DatasetSpec

Name = Annotated[Positional[str], arg(metavar="NAME")]
Output = Annotated[Path | None, arg(aliases=["-o"], metavar="FILE")]
Workers = Annotated[int | None, arg(metavar="N")]


@dataclass(frozen=True, kw_only=True)
class Plans(Options):
    """Show what collecting a dataset would do: blocks, steps, time and size.

    Examples:
      mpdt-data plan cheetah_dir
      mpdt-data plan ml10 --tasks reach,push
      mpdt-data plan ml10 --smoke --json
    """

    name: Name
    """Entry of datasets.yaml."""
    output: Output = None
    """File it would write; default NAME.h5 here."""
    tasks: Names = ()
    """Only these tasks, by name or index."""
    workers: Workers = None
    """Processes; default one per core."""
    smoke: bool = False
    """A tiny version with the same tasks, as NAME-smoke."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """Another datasets.yaml than ./datasets.yaml or the shipped one."""

    def run(self) -> None:
        from mpdt.data.spec.catalog import load_catalog

        job = self.chosen_job(load_catalog(self.spec))
        self.print(self.estimate(job.plan) | {"notices": job.notices}, self.estimate_text(job.plan))

    def chosen_job(self, catalog: Catalog) -> Job:
        """The job of the chosen entry; says where rates and references come from.

        Raises: as `chosen_spec`; SpecError or UsageError for a behaviour that is not there.
        """
        from mpdt.data.collect.job import make_job

        job = make_job(self.chosen_spec(catalog))
        for notice in job.notices:
            self.say(notice)
        return job

    def chosen_spec(self, catalog: Catalog) -> DatasetSpec:
        """The entry with --tasks and --smoke applied. Raises: SpecError, UsageError."""
        import msgspec

        from mpdt.data.spec.smoke import smoke
        from mpdt.data.spec.tasks import get_family

        spec = catalog.get(self.name)
        if self.tasks:
            family = get_family(spec.family)
            names = split_names(self.tasks)
            chosen = {family.task(int(n) if n.isdigit() else n) for n in names}
            ordered = sorted(chosen, key=lambda task: task.index)
            spec = msgspec.structs.replace(spec, tasks=tuple(task.name for task in ordered))
        return smoke(spec) if self.smoke else spec

    def target(self, spec: DatasetSpec) -> Path:
        return self.output or Path(f"{spec.name}.h5")

    def num_workers(self) -> int:
        from mpdt.data.workers.processes import default_workers

        return default_workers() if self.workers is None else self.workers

    def estimate(self, plan: Plan) -> dict[str, Any]:
        return {
            "name": plan.spec.name,
            "version": plan.spec.version,
            "target": str(self.target(plan.spec)),
            "spec_hash": plan.spec_hash,
            "tasks": [task.name for task in plan.tasks],
            "blocks": len(plan.blocks),
            "episodes": plan.num_episodes,
            "tta_episodes": plan.num_tta_episodes,
            "steps": plan.num_steps,
            "bytes": plan.file_bytes,
            "workers": self.num_workers(),
            "seconds": round(plan.seconds(self.num_workers())),
        }

    def estimate_text(self, plan: Plan) -> str:
        """One line: what it is, how much, how long. Steps and size are upper bounds."""
        workers = self.num_workers()
        spec = plan.spec
        minutes = plan.seconds(workers) / 60
        return (
            f"{spec.name} {spec.version}   {len(plan.tasks)} tasks   {len(plan.blocks)} blocks   "
            f"{plan.num_episodes:,} episodes + {plan.num_tta_episodes:,} tta   "
            f"{plan.num_steps:,} steps   about {plan.file_bytes / 1e6:.0f} MB   "
            f"{max(0.1, minutes):.1f} min   {workers} worker{'s' if workers != 1 else ''} "
            f"-> {self.target(spec)}"
        )


@dataclass(frozen=True, kw_only=True)
class Collect(Plans):
    """Make a dataset, or go on with an interrupted collection of it.

    Examples:
      mpdt-data collect cheetah_dir
      mpdt-data collect ml10 --workers 2 -o data/ml10.h5
      mpdt-data collect mt50 --engine ray --address auto
    """

    engine: Literal["processes", "ray"] = "processes"
    """Who does the blocks: processes of this machine, or tasks of a Ray cluster."""
    address: Annotated[str | None, arg(metavar="HOST:PORT")] = None
    """Of a running Ray cluster, `auto` for this machine's; default: start one here."""
    shared_folder: bool = False
    """Every Ray node sees the target's folder: parts are written there, not sent back."""
    restart: bool = False
    """Start again: delete unfinished parts, replace a finished file."""
    locked: bool = False
    """Only the episodes that datasets.lock holds will do."""
    update_lock: bool = False
    """Replace the entry of datasets.lock even if the version is the same."""
    dry_run: bool = False
    """Stop after the plan."""

    def run(self) -> None:
        if self.dry_run:
            super().run()
            return
        from mpdt.data.collect.collect import collect
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.verbs.describe import describe, level_table
        from mpdt.data.verbs.progress import show_progress
        from mpdt.errors import quoted

        catalog = load_catalog(self.spec)
        job = self.chosen_job(catalog)
        self.say(self.estimate_text(job.plan))
        target = self.target(job.spec)
        with show_progress(self.quiet) as tell:
            done = collect(
                job, target, engine=self.chosen_engine(), restart=self.restart,
                lock=self.lock_keeper(catalog), on_progress=tell,
            )  # fmt: skip
        for warning in done.warnings:
            self.say(f"warning: {warning}")
        data = done.dataset
        size = target.stat().st_size / 1e6
        verb = "packed " if done.is_new else "nothing to do: complete "
        if done.lock:
            self.say(f"lock    {done.lock}")
        self.print(
            describe(data) | {"is_new": done.is_new, "warnings": done.warnings, "lock": done.lock},
            f"{verb} {target}   {data.num_episodes:,} episodes   {size:.1f} MB   "
            f"content {data.content_hash[:8]}\n" + level_table(data),
        )
        if done.is_new:
            self.say(f"next    mpdt-data report {quoted(target)}   "
                     f"mpdt-train --data {quoted(target)}")  # fmt: skip

    def chosen_engine(self) -> Engine:
        """Raises: UsageError for options of the other engine."""
        from mpdt.data.collect.engine import Processes, RayCluster
        from mpdt.errors import UsageError

        if self.engine == "ray":
            if self.workers is not None:
                raise UsageError("--workers counts processes of this machine",
                                 hint="a Ray cluster has as many as it has cores")  # fmt: skip
            return RayCluster(self.address, self.shared_folder)
        if self.address or self.shared_folder:
            raise UsageError("--address and --shared-folder are of a Ray cluster",
                             hint="add --engine ray")  # fmt: skip
        return Processes(self.workers)

    def lock_keeper(self, catalog: Catalog) -> LockKeeper | None:
        """The lock beside the catalog; none for some of an entry's tasks. Raises: UsageError.

        A smoke version has an entry of its own, which is compared but not added unasked.
        """
        from mpdt.data.lock.file import lock_path
        from mpdt.data.lock.keeper import LockKeeper
        from mpdt.errors import UsageError

        if self.tasks:
            if self.locked or self.update_lock:
                raise UsageError("the lock holds whole entries",
                                 hint="leave --tasks or the lock out")  # fmt: skip
            return None
        path = lock_path(catalog.path)
        return LockKeeper(path, self.locked, self.update_lock, add=not self.smoke)


@dataclass(frozen=True, kw_only=True)
class Pretrain(Options):
    """Train the behaviour network of a family and export its rungs.

    Of cheetah_dir, cheetah_vel and ant_dir, whose rungs are shipped, or of a family of your own:
    PPO or SAC on its simulator, the task's goal beside the observation, as the family's `pretrain`
    says. An entry acts by it with `behaviour: {network: ./NAME}`. Needs the extra:
    pip install 'mpdt[behaviour]'.

    Examples:
      mpdt-data pretrain cheetah_dir
      mpdt-data pretrain cheetah_dir --steps 2000000 -o weights
      mpdt-data pretrain my_family --seed 1 --no-resume
    """

    name: Name
    """Network to train, named as its family."""
    seed: int = 0
    """Seed of initial weights, minibatches and episodes."""
    steps: Annotated[int | None, arg(metavar="N")] = None
    """Environment steps; default: the family's own."""
    resume: bool = True
    """Go on from the last checkpoint."""
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="FOLDER")] = None
    """Folder for weights and record; default: here."""

    def run(self) -> None:
        from mpdt.data.sim.pretrain import pretrain

        path = pretrain(
            self.name, seed=self.seed, steps=self.steps, output=self.output,
            resume=self.resume, on_progress=self.say,
        )  # fmt: skip
        self.print({"path": str(path)}, f"wrote  {path}")


@dataclass(frozen=True, kw_only=True)
class Calibrate(Options):
    """Find the mixing rate that makes each script `medium`; minutes per task of Meta-World.

    The rates of all tasks of Meta-World at 200 and 500 steps are shipped. Those measured here win
    over them in every collection started from this folder; delete the file to go back. Stop and
    start it as you like: what the file holds already is kept.

    Examples:
      mpdt-data calibrate ml10
      mpdt-data calibrate ml10 --horizons 100,300 -o rates.json
      mpdt-data calibrate ml10 --seed 2 --restart
    """

    name: Name
    """Entry of datasets.yaml with scripted behaviour."""
    horizons: Names = ()
    """Episode lengths in steps; default: the entry's own."""
    seed: int = 1
    """Root seed of the measured episodes."""
    workers: Workers = None
    """Processes; default one per core."""
    restart: bool = False
    """Measure again what the file holds already."""
    output: Output = None
    """File to add the rates to; default: where collect looks for them, here."""
    spec: Annotated[Path | None, arg(metavar="YAML")] = None
    """Another datasets.yaml than ./datasets.yaml or the shipped one."""

    def run(self) -> None:
        from mpdt.data.sim.calibrate import calibrate
        from mpdt.data.spec.catalog import load_catalog
        from mpdt.data.workers.processes import default_workers

        path = calibrate(
            load_catalog(self.spec).get(self.name), self.output,
            horizons=split_steps(self.horizons, where="--horizons"),
            seed=self.seed, restart=self.restart,
            workers=default_workers() if self.workers is None else self.workers,
            on_progress=self.say,
        )  # fmt: skip
        self.print({"path": str(path)}, f"wrote  {path}")
