"""Settings of the protocol `trials`: chosen on held-out training tasks (docs/decisions/0033)."""

from __future__ import annotations

from typing import Literal

import msgspec

from mpdt.errors import UsageError, check_above_zero, check_at_least

TrialRow = Literal["alone", "with_x", "race"]


BEFORE_THERE_WAS_A_CHOICE = {"mean": False, "infer": "world", "search": "plan"}
"""Settings that runs on record do not name."""


class WorldSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The learned world model: an ensemble of small networks."""

    members: int = 3
    hidden: int = 200
    """Width of the two hidden layers."""
    episodes: int = 16
    """Episodes of each training task, half of them random, that it is pretrained on; 0 = all."""
    pretraining: int = 2000
    """Updates on the training tasks' steps; once per run."""
    refitting: int = 200
    """Updates on what a task's own trials have shown, before each that plans."""
    every: int = 50
    """Steps of planning after which the model learns from the trial so far; 0 = never."""
    refreshing: int = 30
    """Updates of that."""
    batch: int = 256
    """Steps per update and member."""
    lr: float = 1e-3
    echo: int = 2000
    """Updates of the prompts' echo; a tenth of these before each trial that plans."""

    def __post_init__(self) -> None:
        for name, least in (("echo", 10), ("members", 1), ("hidden", 1), ("episodes", 0),
                            ("pretraining", 1), ("refitting", 1), ("every", 0),
                            ("refreshing", 1), ("batch", 4)):  # fmt: skip
            check_at_least(f"adapt.trials.world.{name}", getattr(self, name), least)
        check_above_zero("adapt.trials.world.lr", self.lr)


class PlannerSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Search for actions inside the model (cross-entropy method)."""

    horizon: int = 24
    """Steps looked ahead."""
    knot: int = 4
    """Steps that share an action, and after which it is planned anew."""
    samples: int = 96
    rounds: int = 2
    elites: int = 12
    """Best samples that the next round is drawn around."""
    spread: float = 0.5
    """Standard deviation of the first round, as a share of half the action box."""
    discount: float = 0.98
    noise: float = 0.15
    """Standard deviation added to what is done, as a share of half the action box."""
    probing: int = 3
    """Of so many trials that plan one has probes: now and then it goes straight in a direction,
    away from where plans stay; 0 = none."""
    probe_every: int = 36
    """Steps from one probe to the next."""
    probe: int = 12
    """Steps of a probe."""
    echoes: int = 3
    """Roll-outs of each trained prompt's echo inside the model, all but one with noise; 0 = no
    proposals."""

    def __post_init__(self) -> None:
        for name, least in (("horizon", 1), ("knot", 1), ("samples", 1), ("rounds", 1),
                            ("elites", 1), ("discount", 0), ("noise", 0),
                            ("probing", 0), ("probe_every", 1), ("probe", 0),
                            ("echoes", 0)):  # fmt: skip
            check_at_least(f"adapt.trials.planner.{name}", getattr(self, name), least)
        check_above_zero("adapt.trials.planner.spread", self.spread)


class TrialSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Own episodes on each unseen task, with rewards and successes, before it is judged."""

    episodes: tuple[int, ...] = (10,)
    """K, own episodes per task; several make a row each out of the same trials."""
    rows: tuple[TrialRow, ...] = ("alone", "with_x")
    """alone: nothing but the trials. with_x: X and its rewards as well. race: K prompts of the
    training tasks are tried and the best is taken, for comparison."""
    seed: int = 0
    """Root of the trials' seeds, a stream apart from evaluation's."""
    opening: int = 200
    """Steps of the first trial that trained prompts act before the planner does; where nothing
    plans, of one round of their tour."""
    infer: Literal["rewards", "world"] = "rewards"
    """Which model is asked for the training tasks that explain what the first trial was paid: the
    reward model, as large as `adapt.infer` says, or the world model's reward heads."""
    search: Literal["climb", "plan"] = "climb"
    """What further trials are where the simulator has no successes: mixtures of prompts near the
    best one, or a planner's (they have one where there are successes)."""
    mean: bool = False
    """The mean of all training tasks' prompts stays a contender and is tried in an episode of its
    own. Where there are many training tasks it may be better than what X points at."""
    demonstrations: int = 2
    """Own successes that a clone learns from, the quickest first."""
    clones: int = 4
    """At most so many clones of a task."""
    practice: int = 2
    """Successes of a clone after which another learns from these as well; 0 = never."""
    tail: int = 60
    """Steps after its first success that still belong to a demonstration."""
    updates: int = 300
    """Of a clone."""
    lr: float = 1e-3
    """Of a clone."""
    world: WorldSettings = WorldSettings()
    planner: PlannerSettings = PlannerSettings()

    def __post_init__(self) -> None:
        for name in ("episodes", "rows"):
            if not getattr(self, name):
                raise UsageError("at least one is needed", where=f"adapt.trials.{name}")
        for count in self.episodes:
            check_at_least("adapt.trials.episodes", count, 0)
        for name, least in (("seed", 0), ("opening", 0), ("demonstrations", 1), ("clones", 0),
                            ("practice", 0), ("tail", 0), ("updates", 1)):  # fmt: skip
            check_at_least(f"adapt.trials.{name}", getattr(self, name), least)
        check_above_zero("adapt.trials.lr", self.lr)
