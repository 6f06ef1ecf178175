"""The verb that adds a set for test-time adaptation. Its body imports lazily."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from mpdt.data.verbs.editing import File
from mpdt.data.verbs.make import Workers
from mpdt.data.verbs.options import Names, Options, split_names

if TYPE_CHECKING:
    from mpdt.data.spec.entry import TtaRule

ROLES = ("test", "train", "all")


@dataclass(frozen=True, kw_only=True)
class Tta(Options):
    """Add a set of random-action episodes for test-time adaptation to a file.

    What is left out is as in the file's spec for a set of that name. The set is the one that
    collecting at once would have given; the file's episodes and content hash stay.

    Examples:
      mpdt-data tta cheetah_dir.h5 --name wide --action-scale 3
      mpdt-data tta ml10.h5 --name fifty --episodes 50 --horizon 500
      mpdt-data tta mt10.h5 --tasks reach,push --preset-return 1200 --name two
    """

    file: File
    """File to add to; put it before --tasks."""
    name: Annotated[str, arg(metavar="SET")] = "default"
    """Name of the set."""
    tasks: Names = ()
    """test, train or all, or names of tasks."""
    episodes: Annotated[int | None, arg(metavar="N")] = None
    """Per task."""
    horizon: Annotated[int | None, arg(metavar="STEPS")] = None
    """Steps per episode."""
    action_scale: Annotated[float | None, arg(metavar="F")] = None
    """Range of the drawn actions as a multiple of the bounds."""
    preset_return: Annotated[str | None, arg(metavar="RETURN|auto")] = None
    """Return asked of the policy; auto = the family's fixed target."""
    workers: Workers = None
    """Processes; default one per core."""
    overwrite: bool = False
    """Replace another set of that name."""
    restart: bool = False
    """Start again: delete unfinished parts."""
    dry_run: bool = False
    """Stop after the plan."""

    def run(self) -> None:
        from mpdt.data.collect.add_tta import add_set, set_job, stored_rule
        from mpdt.data.store.reader import open_dataset
        from mpdt.data.verbs.progress import show_progress
        from mpdt.data.workers.processes import default_workers

        dataset = open_dataset(self.file)
        rule, names = self.rule(stored_rule(dataset, self.name))
        job = set_job(dataset, self.name, rule, names)
        plan = job.plan
        workers = default_workers() if self.workers is None else self.workers
        tasks = list(dict.fromkeys(block.task.name for block in plan.blocks))
        planned = {"path": str(self.file), "set": self.name, "tasks": tasks,
                   "episodes": plan.num_tta_episodes, "steps": plan.num_steps,
                   "seconds": round(plan.seconds(workers))}  # fmt: skip
        text = (f"{self.file}   set {self.name}   {len(tasks)} tasks   "
                f"{plan.num_tta_episodes:,} episodes   {plan.num_steps:,} steps")  # fmt: skip
        if self.dry_run:
            self.print(planned, text)
            return
        self.say(text)
        with show_progress(self.quiet) as tell:
            done = add_set(dataset, job, workers=workers, overwrite=self.overwrite,
                           restart=self.restart, on_progress=tell)  # fmt: skip
        for warning in done.warnings:
            self.say(f"warning: {warning}")
        added = done.dataset.tta[self.name]
        self.print(
            {**planned, "steps": int(added.length.sum()), "content_hash": added.content_hash,
             "warnings": done.warnings, "is_new": done.is_new},
            f"{'added' if done.is_new else 'there already'}   {self.file}   set {self.name}   "
            f"{len(added):,} episodes   "
            f"content {added.content_hash[:8]}",
        )  # fmt: skip

    def rule(self, rule: TtaRule) -> tuple[TtaRule, tuple[str, ...]]:
        """`rule` with what was typed laid over it, and the names of single tasks.

        Raises: UsageError for a preset return that is no number.
        """
        import msgspec

        typed = {"episodes": self.episodes, "horizon": self.horizon,
                 "action_scale": self.action_scale,
                 "preset_return": self._preset()}  # fmt: skip
        names = split_names(self.tasks)
        if len(names) == 1 and names[0] in ROLES:
            typed["tasks"], names = names[0], ()
        elif names:
            typed["tasks"] = "all"
        given = {key: value for key, value in typed.items() if value is not None}
        return msgspec.structs.replace(rule, **given), names

    def _preset(self) -> float | str | None:
        from mpdt.errors import UsageError

        if self.preset_return in (None, "auto"):
            return self.preset_return
        try:
            return float(self.preset_return)
        except ValueError:
            raise UsageError("not a return", where="--preset-return", expected="a number or auto",
                             found=self.preset_return) from None  # fmt: skip
