"""`mpdt-train methods`: every method in one sentence, what it reads at test time, its paper."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass

from mpdt.train.adapt.align import INFERRED, NOT_ADAPTED, TRIALS
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.methods import METHODS, apply_method
from mpdt.train.run.presets import get_preset

_MPDT, _OURS = "Zheng et al. 2024", "ours, after Zheng et al. 2024"
_PROMPT_DT = "Xu et al. 2022"
_TOLD: dict[str, tuple[str, str]] = {
    "MPDT": ("decomposed, distilled soft prompts before a frozen language model; frozen input map",
             _MPDT),
    "MPDT-E": ("MPDT with a trained input map", _OURS),
    "MPDT-WP": ("MPDT on untrained weights of the same shape, all of which are trained", _MPDT),
    "MPDT-WP-frozen": ("MPDT on untrained weights of the same shape, which stay frozen", _MPDT),
    "MPDT+sparse": ("MPDT with a penalty on large task prompts", _MPDT),
    "MPDT-no-distillation": ("MPDT without a teacher", _MPDT),
    "MPDT-teacher-parts": ("MPDT with the teacher's task prompts frozen in it", _MPDT),
    "MPDT-mixed": ("MPDT that also trains behind mixtures of other tasks' prompts", _OURS),
    "MPDT-ones": ("MPDT whose task prompts begin near one, so that they can be averaged", _OURS),
    "Soft-Prompt": ("one soft prompt for all tasks, never adapted", "Lester et al. 2021"),
    "Soft-Prompt-TTA": ("one soft prompt for all tasks, adapted to each test task",
                        "Lester et al. 2021"),
    "Prompt-DT": ("a small transformer that is shown steps of a demonstration", _PROMPT_DT),
    "Prompt-DT-TTA": ("Prompt-DT with a gate over the demonstration, adapted to each test task",
                      _PROMPT_DT),
    "Prompt-DT-infer": ("Prompt-DT shown demonstrations of the training tasks that explain the "
                        "test task", _OURS),
    "MT-BC": ("behaviour cloning of all tasks at once, without prompt and return", _PROMPT_DT),
    "MT-BC-FT": ("MT-BC, all weights fine-tuned on each test task", _PROMPT_DT),
    "MT-ORL": ("one return-conditioned transformer for all tasks, without prompt", _PROMPT_DT),
    "MT-ORL-FT": ("MT-ORL, all weights fine-tuned on each test task", _PROMPT_DT),
    "HDT": ("adapters that a hyper-network makes from a demonstration without actions",
            "Xu et al. 2023"),
    "LaMo": ("a language model with low-rank updates and MLP input maps", "Shi et al. 2023"),
    "Full-FT": ("every weight of a pretrained language model is trained", "Reid et al. 2022"),
}  # fmt: skip


@dataclass(frozen=True)
class MethodFacts:
    """One method.

    Args:
        reads: of a test task before its first step, under the preset that was asked for.
    """

    name: str
    sentence: str
    reads: str
    paper: str


def catalogue(preset: str = "base") -> list[MethodFacts]:
    """All methods in the order of `METHODS`. Raises: UsageError for an unknown preset."""
    plain = get_preset(preset)
    return [
        MethodFacts(name, sentence, reads_of(apply_method(plain, name)), paper)
        for name, (sentence, paper) in ((name, _TOLD[name]) for name in METHODS)
    ]


def reads_of(config: TrainConfig) -> str:
    """What the rows of the table of test tasks read, in the words of their column `reads`."""
    found = []
    for start in config.adapt.starts:
        if start == NOT_ADAPTED:
            continue
        if start == TRIALS:
            rows = config.adapt.trials.rows
            found += ["X+rewards, trials" if row == "with_x" else "trials" for row in rows]
            continue
        rewards = start in INFERRED or config.adapt.returns == "decrement"
        found.append("X+rewards" if rewards else "X")
    if config.few_shot.qualities:
        found.append("labelled steps")
    if not found or NOT_ADAPTED in config.adapt.starts:
        found.append("nothing")
    return ", ".join(dict.fromkeys(found))


def print_catalogue(preset: str, as_json: bool) -> int:
    """On stdout: three aligned columns and a sentence below each, or JSON. Returns 0."""
    methods = catalogue(preset)
    found = json.dumps([asdict(one) for one in methods], indent=1)
    sys.stdout.write((found if as_json else _text(methods)) + "\n")
    return 0


def _text(methods: list[MethodFacts]) -> str:
    widths = [max(len(getattr(one, key)) for one in methods) for key in ("name", "reads")]
    lines = [f"{'method':<{widths[0]}}  {'reads':<{widths[1]}}  paper"]
    for one in methods:
        lines += [f"{one.name:<{widths[0]}}  {one.reads:<{widths[1]}}  {one.paper}",
                  f"    {one.sentence}"]  # fmt: skip
    lines += ["", "reads = of a test task before its first step: X = the set for test-time "
              "adaptation"]  # fmt: skip
    return "\n".join(lines)
