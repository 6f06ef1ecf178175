"""Studies: lists of cells = data x method x seed, with the settings that are studied. Data only.

    fifty         ml45 and mt50, one block, longer: what the paper shows its ablations on
    one-block     every method on every family but mt10, the language model cut to its first block;
                  three seeds for the main ones, five on cheetah_vel; there one thing changed at a
                  time as well
    first-pass    what was run before with four blocks, at four times the cost (0018)
    depth         MPDT-ones with 4, 12 and all 30 blocks, GPT-2's shape, longer windows
    trials        the weights of one-block's and fifty's MPDT-ones again, after own episodes (0033);
                  a copy of a run's folder under the cell's name saves training it anew

The cells of each: planned/; what the settings are: recipes.py.
"""

from __future__ import annotations

from collections.abc import Mapping

from mpdt.errors import unknown_name
from mpdt.train.study.planned.depth import DEPTH
from mpdt.train.study.planned.fifty import FIFTY
from mpdt.train.study.planned.first_pass import FIRST_PASS
from mpdt.train.study.planned.one_block import ONE_BLOCK
from mpdt.train.study.planned.trials import TRIALS
from mpdt.train.study.recipes import Cell

STUDIES: Mapping[str, tuple[Cell, ...]] = {
    "one-block": ONE_BLOCK,
    "fifty": FIFTY,
    "depth": DEPTH,
    "trials": TRIALS,
    "first-pass": FIRST_PASS,
}


def get_study(name: str) -> tuple[Cell, ...]:
    """Raises: UsageError naming the nearest study."""
    if name not in STUDIES:
        raise unknown_name("study", name, STUDIES, where=f"study {name}")
    return STUDIES[name]
