"""Which prompts of a bundle act: a task's own, or adapted ones by the name of their start."""

from __future__ import annotations

from operator import index

from mpdt.errors import UsageError, unknown_name
from mpdt.train.bundle.acting import ActingPolicy
from mpdt.train.bundle.build import Bundle
from mpdt.train.bundle.format import OWN, BundleConfig, PromptSet

NOT_ADAPTED = "none"


def policy_of_bundle(
    bundle: Bundle, task: str | int | None = None, start: str | None = None
) -> ActingPolicy:
    """A bundle's policy as one of its tasks.

    Args, Raises: as `load_policy`.
    """
    config = bundle.config
    name = _task(config, task)
    chosen = _prompts(config, name, start)
    return ActingPolicy(
        bundle.policy, bundle.prompts[chosen.name], bundle.returns(chosen.name), bundle.family,
        chosen.tasks, name, config.window,
    )  # fmt: skip


def _task(config: BundleConfig, task: str | int | None) -> str:
    names = [one.name for one in config.tasks]
    if task is None:
        return config.prompts[0].tasks[0]
    if not isinstance(task, str):
        task = index(task)
        if not 0 <= task < len(names):
            raise UsageError("no such row", where=config.name, expected=f"0 to {len(names) - 1}",
                             found=str(task))  # fmt: skip
        return names[task]
    if task not in names:
        raise unknown_name("task", task, names, where=config.name)
    return task


def refuse_left_out(config: BundleConfig, start: str | None) -> None:
    """Raises: UsageError for a row of the table that this policy has no prompts for."""
    if start in config.left_out:
        there = ", ".join(one.name for one in config.prompts)
        raise UsageError(
            f"the start '{start}' is left out: it has a network of its own for each task",
            where=config.name, expected=there,
            hint="mpdt-train adapt RUN --keep FILE keeps the episodes that it acts in",
        )  # fmt: skip


def _prompts(config: BundleConfig, task: str, start: str | None) -> PromptSet:
    sets = {one.name: one for one in config.prompts}
    if start is None:
        own = sets.get(OWN)
        start = OWN if own is not None and task in own.tasks else NOT_ADAPTED
    refuse_left_out(config, start)
    if start not in sets:
        raise unknown_name("start", start, sets, where=config.name)
    if task not in sets[start].tasks:
        others = [f'start="{one.name}"' for one in config.prompts if task in one.tasks]
        raise UsageError(
            f"the start '{start}' has no prompt for {task}",
            where=config.name,
            expected=", ".join(sets[start].tasks),
            hint=f"{task} can act with {' or '.join(others)}" if others else "",
        )
    return sets[start]
