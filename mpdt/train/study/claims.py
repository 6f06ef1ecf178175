"""What the paper claims, and what we claim, as pairs of rows of a study's tables. Data only.

    statement  who earns more than whom, in the names of rows; of which families it is asked
    claim      a statement of one family, with the paper's two figures where it has them

Our rows are MPDT-E's, whose input map is trained, where the paper's are MPDT's, whose map is
frozen: that is a claim of its own. What is made of them: verdicts.py.
Source of the published figures: Zheng et al. 2024, review text (zero-shot and ablation tables).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

CLAIMED_OF = ("one-block", "fifty")
"""The studies whose rows the claims name."""

_VEL = ("cheetah_vel",)
_FIFTY = ("ml45", "mt50")
# Families on which `one-block` plans every method; of mt10 it plans a few.
_ONE_BLOCK = ("cheetah_vel", "cheetah_dir", "ant_dir", "ml10")
FAMILIES = (*_ONE_BLOCK, "mt10", *_FIFTY)

# Mean return on unseen tasks, by variant as the paper's tables call it.
_PUBLISHED: Mapping[str, Mapping[str, float]] = {
    "cheetah_vel": {"MPDT": -139.88, "Prompt-DT": -192.38, "no TTA": -145.27, "MPDT-E": -186.07,
                    "mean start": -148.50, "one start": -159.26, "random start": -171.75,
                    "teacher parts": -169.50, "sparse": -138.24, "rank 10": -135.51,
                    "length 3": -299.20},
    "cheetah_dir": {"MPDT": 50.32, "Prompt-DT": -7.92},
    "ant_dir": {"MPDT": 121.84, "Prompt-DT": 123.46},
    "ml10": {"MPDT": 371.01, "Prompt-DT": 317.31},
    "mt10": {"MPDT": 1317.52, "Prompt-DT": 1087.54},
    "ml45": {"MPDT": 347.21, "Prompt-DT": 294.55, "no TTA": 337.80, "MPDT-E": 301.49,
             "mean start": 332.80, "rank 10": 350.33, "length 3": 110.83},
    "mt50": {"MPDT": 1559.94, "Prompt-DT": 994.63, "no TTA": 1304.07, "MPDT-E": 380.36,
             "mean start": 1482.75},
}  # fmt: skip


@dataclass(frozen=True)
class Claim:
    """`ahead` earns more than `behind` on the unseen tasks of `data`.

    Attributes:
        ahead, behind: names of rows.
        published: mean returns of the paper, of both, where it has both.
    """

    text: str
    data: str
    ahead: str
    behind: str
    published: tuple[float, float] | None = None


@dataclass(frozen=True)
class _Statement:
    """A claim before it is asked of a family.

    Attributes:
        figures: both variants as `_PUBLISHED` calls them; empty where the paper has none.
    """

    text: str
    ahead: str
    behind: str
    families: tuple[str, ...]
    figures: tuple[str, ...] = ()

    def asked_of(self, data: str) -> Claim:
        # `fifty` plans more than one rank and calls MPDT-no-distillation by its rank.
        plain = "rank-1" if data in _FIFTY else "MPDT-no-distillation"
        ahead, behind = (name.replace(_PLAIN, plain) for name in (self.ahead, self.behind))
        known = _PUBLISHED[data]
        figures = tuple(known[name] for name in self.figures if name in known)
        published = (figures[0], figures[1]) if len(figures) == 2 else None
        return Claim(self.text, data, ahead, behind, published)


_PLAIN = "{plain}"
_CROSS = "from cross, adapted"
_MEAN_AS_IS = "MPDT-E P_c o mean P_k, not adapted"
_MEAN_ADAPTED = "MPDT-E from cross_mean, adapted"


def _told_both_ways(
    text: str, ahead: str, behind: str, families: tuple[str, ...], figures: tuple[str, ...] = ()
) -> tuple[_Statement, _Statement]:
    """By the published protocol, and with prompts that X and its rewards point at."""
    return (
        _Statement(text, f"{ahead} {_CROSS}", f"{behind} {_CROSS}", families, figures),
        _Statement(f"{text}: task inferred", f"{ahead} infer", f"{behind} infer", families),
    )


_STATEMENTS = (
    _Statement("decomposition helps", f"{_PLAIN} {_CROSS}", f"Soft-Prompt-TTA {_CROSS}",
               (*_ONE_BLOCK, *_FIFTY)),
    *_told_both_ways("distillation helps", "MPDT-E", _PLAIN, (*_ONE_BLOCK, *_FIFTY)),
    _Statement("distillation beats the teacher's prompts as task parts", f"MPDT-E {_CROSS}",
               f"MPDT-teacher-parts {_CROSS}", (*_VEL, *_FIFTY), ("MPDT", "teacher parts")),
    # As the paper compares them: another start, and no adaptation.
    _Statement("P_c, adapted, beats P_c o mean P_k, not adapted", f"MPDT-E {_CROSS}", _MEAN_AS_IS,
               FAMILIES, ("MPDT", "no TTA")),
    # The same start with and without.
    _Statement("adaptation on X helps: P_c o mean P_k", _MEAN_ADAPTED, _MEAN_AS_IS,
               (*_VEL, *_FIFTY), ("mean start", "no TTA")),
    _Statement("adaptation on X helps: one soft prompt for all tasks", f"Soft-Prompt-TTA {_CROSS}",
               "Soft-Prompt-TTA not adapted", (*_ONE_BLOCK, *_FIFTY)),
    _Statement("adaptation on X helps: inferred prompts", "MPDT-E infer, adapted", "MPDT-E infer",
               (*_ONE_BLOCK, "mt10")),
    _Statement("adaptation on X helps: inferred prompts of MPDT-ones", "MPDT-ones infer, adapted",
               "MPDT-ones infer", (*_ONE_BLOCK, "mt10")),
    _Statement("starting from P_c alone beats P_c o mean P_k", f"MPDT-E {_CROSS}", _MEAN_ADAPTED,
               (*_VEL, *_FIFTY), ("MPDT", "mean start")),
    _Statement("starting from P_c alone beats P_c o one P_k", f"MPDT-E {_CROSS}",
               "MPDT-E from cross_one, adapted", _VEL, ("MPDT", "one start")),
    _Statement("starting from P_c alone beats a random task part", f"MPDT-E {_CROSS}",
               "MPDT-E from cross_random, adapted", _VEL, ("MPDT", "random start")),
    # Its input map is trained, as MPDT-E's.
    _Statement("a sparse loss helps", f"MPDT+sparse {_CROSS}", f"MPDT-E {_CROSS}",
               (*_VEL, *_FIFTY), ("sparse", "MPDT")),
    *_told_both_ways("a frozen input map is better", "MPDT", "MPDT-E", (*_ONE_BLOCK, *_FIFTY),
                     ("MPDT", "MPDT-E")),
    *_told_both_ways("pretrained weights help (against trained from scratch)", "MPDT-E",
                     "MPDT-WP", (*_ONE_BLOCK, *_FIFTY)),
    *_told_both_ways("pretrained weights help (against random and frozen)", "MPDT-E",
                     "MPDT-WP-frozen", (*_ONE_BLOCK, *_FIFTY)),
    *_told_both_ways("rank 10 is better than rank 1", "rank-10", _PLAIN, (*_VEL, *_FIFTY),
                     ("rank 10", "MPDT")),
    *_told_both_ways("length 30 is better than length 3", _PLAIN, "length-3", (*_VEL, *_FIFTY),
                     ("MPDT", "length 3")),
    _Statement("MPDT beats zero-shot Prompt-DT", f"MPDT-E {_CROSS}", "Prompt-DT not adapted",
               FAMILIES, ("MPDT", "Prompt-DT")),
    _Statement("ours: task parts near one can be averaged", "MPDT-ones infer", "mixture infer",
               _VEL),
    _Statement("ours: their mixture beats the nearest prompt", "MPDT-ones infer", f"{_PLAIN} infer",
               _VEL),
    _Statement("ours: MPDT-ones beats Prompt-DT, both told the task by X and rewards",
               "MPDT-ones infer", "Prompt-DT infer", FAMILIES),
    _Statement("ours: MPDT-ones beats its like trained from scratch (smaller rate)",
               "MPDT-ones infer", "WP-ones infer", (*_VEL, "ml45")),
    *(_Statement(f"ours: MPDT-ones, 3,000 updates, beats its like trained from scratch ({rate})"
                 f"{how}", f"{ahead} {row}", f"WP-ones-long {row}", ("ml10",))
      for ahead, rate in (("ones-long", "smaller rate"), ("ones-long-slower", "same rate"))
      for how, row in (("", _CROSS), (": nothing read", "P_c o mean P_k, not adapted"),
                       (": task inferred", "infer"))),
)  # fmt: skip
CLAIMS = tuple(statement.asked_of(data) for statement in _STATEMENTS for data in statement.families)
