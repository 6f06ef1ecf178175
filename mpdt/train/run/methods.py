"""The method, its variants and its baselines: what each changes in a preset, as data.

    mpdt-train --method Prompt-DT --data FILE       preset base, with these lines over it

All share windows, normalisation (training tasks only), sampler, loop, evaluation and seeds.
Sizes follow the preset: whole models are trained at the shape of Prompt-DT's own code
(3 blocks, width 128), not at the 12 blocks the paper gave its baselines.

Deviations of the public Prompt-DT code that are left out on purpose: statistics of test data,
unseeded runs, returns shown at evaluation to a model trained without, fine-tuning that ignores
the inputs left out or keeps an optimiser from task to task, a prompt that is always an
episode's end. See docs/decisions/0011.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpdt.errors import unknown_name
from mpdt.train.run.config import TrainConfig, from_plain, to_plain

Changes = Mapping[str, Any]

_NO_TEACHER: Changes = {"teacher": {"distillation": "none"}}
_MIXTURE: Changes = {"adapt": {"infer": {"tasks": 2}}}
_UNADAPTED: Changes = {"adapt": {"starts": ["none"]}}
_FROM_SCRATCH: Changes = {"backbone": {"name": "random:prompt-dt", "depth": None, "frozen": False}}
_THREE_TOKENS: Changes = {
    "inputs": {"kind": "trained", "start": "random", "tokens_per_step": 3,
               "previous_action": True, "return_to_go": "family", "return_clip": True},
    "head": {"hidden": 0},
}  # fmt: skip
_WHOLE_TUNED: Changes = {
    "few_shot": {"qualities": ["expert"], "start": "none", "tuned": "all", "updates": 10,
                 "per_task": 256, "lr": 1e-4},
}  # fmt: skip
_LANGUAGE_RATES: Changes = {"optimiser": {"lr": 3e-4}}
_PROMPT_DT: Changes = {"prompts": {"kind": "demonstration", "length": 5}}
_NO_PROMPT: Changes = {"prompts": {"kind": "none"}}
_SHARED: Changes = {"prompts": {"kind": "shared"}}

METHODS: Mapping[str, tuple[Changes, ...]] = {
    # Published: frozen input map; MPDT-E trains it.
    "MPDT": ({"inputs": {"kind": "frozen"}},),
    "MPDT-E": ({"inputs": {"kind": "trained"}},),
    "MPDT-WP": ({"backbone": {"name": "random:smollm2-135m", "frozen": False}}, _LANGUAGE_RATES),
    "MPDT-WP-frozen": ({"backbone": {"name": "random:smollm2-135m"}},),
    "MPDT+sparse": ({"multitask": {"sparse": 0.2}},),
    "MPDT-no-distillation": (_NO_TEACHER,),
    # P_c o P_k^teacher, the teacher frozen: the rebuttal's variant.
    "MPDT-teacher-parts": ({"teacher": {"distillation": "parts"}},),
    # Ours: half of the time a training task acts with the mixture `infer` would find for it.
    "MPDT-mixed": (_NO_TEACHER, {"mixing": {"share": 0.5}}, _MIXTURE),
    # Ours: every P_k starts near one, so prompts stay near each other and can be averaged.
    "MPDT-ones": (_NO_TEACHER, {"prompts": {"task_init": "ones"}}, _MIXTURE),
    "Soft-Prompt": (_SHARED, _NO_TEACHER, _UNADAPTED),
    "Soft-Prompt-TTA": (_SHARED, _NO_TEACHER, {"adapt": {"starts": ["cross"]}}),
    "Prompt-DT": (_FROM_SCRATCH, _THREE_TOKENS, _PROMPT_DT, _NO_TEACHER, _UNADAPTED,
                  {"few_shot": {"demonstration": True}}),
    "Prompt-DT-TTA": (_FROM_SCRATCH, _THREE_TOKENS, _PROMPT_DT, _NO_TEACHER,
                      {"adapt": {"starts": ["cross_one"]}}),
    "Prompt-DT-infer": (_FROM_SCRATCH, _THREE_TOKENS, _PROMPT_DT, _NO_TEACHER,
                        {"adapt": {"starts": ["infer"]}}),
    "MT-BC": (_FROM_SCRATCH, _THREE_TOKENS, {"inputs": {"return_to_go": "none"}}, _NO_PROMPT,
              _NO_TEACHER, _UNADAPTED),
    "MT-BC-FT": (_FROM_SCRATCH, _THREE_TOKENS, {"inputs": {"return_to_go": "none"}}, _NO_PROMPT,
                 _NO_TEACHER, _UNADAPTED, _WHOLE_TUNED),
    "MT-ORL": (_FROM_SCRATCH, _THREE_TOKENS, _NO_PROMPT, _NO_TEACHER, _UNADAPTED),
    "MT-ORL-FT": (_FROM_SCRATCH, _THREE_TOKENS, _NO_PROMPT, _NO_TEACHER, _UNADAPTED, _WHOLE_TUNED),
    "HDT": (_FROM_SCRATCH, _THREE_TOKENS,
            {"prompts": {"kind": "hyper", "length": 20, "rank": 4}}, _NO_TEACHER, _UNADAPTED,
            {"few_shot": {"qualities": ["expert"], "demonstration": True, "updates": 100,
                          "lr": 1e-3}}),
    "LaMo": ({"backbone": {"lora_rank": 16, "lora_alpha": 32.0}}, _THREE_TOKENS,
             {"inputs": {"kind": "mlp"}, "head": {"hidden": None}}, _NO_PROMPT, _NO_TEACHER,
             _UNADAPTED),
    "Full-FT": ({"backbone": {"frozen": False}}, _THREE_TOKENS, _NO_PROMPT, _NO_TEACHER,
                _UNADAPTED, _LANGUAGE_RATES),
}  # fmt: skip


def has_language_model(method: str) -> bool:
    """Whether the method's network has the shape of a language model, and so a depth to choose."""
    return _FROM_SCRATCH not in METHODS[method]


def apply_method(config: TrainConfig, name: str) -> TrainConfig:
    """The configuration with a method's changes, under its name.

    Raises: UsageError naming the nearest method.
    """
    if name not in METHODS:
        raise unknown_name("method", name, METHODS, where="--method")
    plain = to_plain(config)
    for changes in METHODS[name]:
        plain = merge(plain, changes)
    return from_plain(plain | {"method": name})


def merge(plain: Mapping[str, Any], changes: Changes) -> dict[str, Any]:
    """`changes` laid over `plain`, group by group; keys of neither side are lost."""
    merged = dict(plain)
    for key, value in changes.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = merge(merged[key], value) if both else value
    return merged
