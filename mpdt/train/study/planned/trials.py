"""Study `trials`: weights of MPDT-ones in one-block and fifty again, after own episodes (0033).

A copy of the run's folder under the cell's name saves training it anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpdt.train.study.planned.fifty import FIFTY_SIZE
from mpdt.train.study.recipes import (
    ANT_LONG,
    LONG,
    SCRATCH_ONES,
    TWO,
    VEL,
    Cell,
    one,
)

# As the rows on record were run, before held-out training tasks spoke for other settings (0033).
_BEFORE: Mapping[str, Any] = {"infer": "world", "search": "plan"}
_CHOSEN: Mapping[str, Any] = {"infer": "rewards", "search": "climb"}


def _trials(
    data: str, row: str, seed: int, trial_seed: int, label: str = "",
    changes: Mapping[str, Any] = _BEFORE, size: Mapping[str, Any] | None = None,
    scratch: bool = False,
) -> Cell:  # fmt: skip
    """One row of the protocol alone; fresh goals are judged 20 times a task."""
    adapt = {"starts": ["trials"], "trials": {"episodes": [1, 3, 10], "rows": [row],
                                              "seed": trial_seed, **changes}}  # fmt: skip
    judged = {"evaluation": {"blocks": ["test"], "episodes": 20}}
    usual = {VEL: {}, "ml45": FIFTY_SIZE, "ant_dir_endless": ANT_LONG}.get(data, LONG)
    size = usual if size is None else size
    name = row.replace("_", "-") + label
    method = ("MPDT-WP", SCRATCH_ONES, TWO) if scratch else ("MPDT-ones",)
    return one(data, *method, size, {"adapt": adapt}, judged, seed=seed,
                label=f"{'WP-' * scratch}ones-{name}-t{trial_seed}")  # fmt: skip


_WITH_MEAN: Mapping[str, Any] = {**_BEFORE, "mean": True}
TRIALS: tuple[Cell, ...] = (
    *(_trials("ml10", row, seed, trial_seed)
      for trial_seed in (0, 1, 2) for row in ("with_x", "alone") for seed in (0, 1, 2)),
    *(_trials(VEL, "alone", seed, 0) for seed in (0, 1, 2)),
    _trials("ml10", "race", 0, 0),
    *(_trials("ml45", row, 0, 0) for row in ("with_x", "alone")),
    *(_trials("ml45", row, 0, 0, "-mean", _WITH_MEAN) for row in ("with_x", "alone")),
    _trials("ant_dir_endless", "alone", 0, 0),
    *(_trials(VEL, "alone", seed, trial_seed, "-climb", _CHOSEN)
      for trial_seed in (0, 1, 2) for seed in (0, 1, 2)),
    # The weights of one-block's ones-long on cheetah_vel.
    *(_trials(VEL, "alone", seed, trial_seed, "-long", _CHOSEN, ANT_LONG)
      for trial_seed in (0, 1, 2) for seed in (0, 1, 2)),
    *(_trials("ml10", "alone", seed, trial_seed, "-rewards", _CHOSEN)
      for trial_seed in (0, 1, 2) for seed in (0, 1, 2)),
    # Clones that learn at the rate that few-shot preferred.
    *(_trials("ml10", "with_x", seed, 0, "-slower", {**_BEFORE, "lr": 3e-4})
      for seed in (0, 1, 2)),
    _trials("ml45", "alone", 0, 0, "-mean-rewards", {**_CHOSEN, "mean": True}),
    # The first trial is the policy's alone, as nine classes left out of ml45 preferred (0033).
    *(_trials("ml45", "with_x", seed, 0, "-whole", {**_CHOSEN, "mean": True, "opening": 500})
      for seed in (0, 1, 2)),
    # The weights of one-block's WP-ones-long: unseen classes know more of it from the start.
    *(_trials("ml10", row, seed, 0, "-long", _CHOSEN, scratch=True)
      for row in ("with_x", "alone") for seed in (0, 1, 2)),
)  # fmt: skip
