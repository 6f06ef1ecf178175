"""Study `first-pass`: what was run before with four blocks, at four times the cost (0018)."""

from __future__ import annotations

from mpdt.train.study.recipes import (
    ALL_TUNED,
    EVERY_START,
    EXPERT,
    INFER,
    LEVELS,
    LONG,
    PLAIN,
    SMALLER,
    STARTS,
    TEST,
    VEL,
    Cell,
    four,
)

_NEAREST = ({"adapt": {"starts": ["infer", "infer_aligned"], "infer": {"tasks": 1}}}, TEST)
FIRST_PASS: tuple[Cell, ...] = (
    *(four(VEL, method, STARTS, EXPERT)
      for method in (PLAIN, "MPDT-E", "MPDT", "MPDT-mixed")),
    *(four(VEL, method, STARTS, seed=seed) for seed in (1, 2) for method in (PLAIN, "MPDT-E")),
    *(four(VEL, method, STARTS) for method in ("MPDT-WP", "MPDT-WP-frozen")),
    *(four(VEL, "MPDT-ones", STARTS, EXPERT, seed=seed, label="ones") for seed in (0, 1, 2)),
    four(VEL, "Soft-Prompt-TTA", EXPERT),
    *(four(VEL, method) for method in ("MT-BC-FT", "MT-ORL-FT")),
    *(four(VEL, "Prompt-DT", INFER, seed=seed) for seed in (0, 1, 2)),
    four(VEL, "Prompt-DT", {"multitask": {"steps": 5000}}, INFER, label="Prompt-DT-long"),
    four(VEL, "MPDT-E", EVERY_START, LEVELS, label="starts"),
    four(VEL, PLAIN, {"prompts": {"rank": 10}}, STARTS, label="rank-10"),
    four(VEL, PLAIN, {"prompts": {"length": 3}}, STARTS, label="length-3"),
    *(four(VEL, PLAIN, {"backbone": {"depth": depth}}, STARTS, label=f"depth-{depth}")
      for depth in (1, 2)),
    four("cheetah_dir", "MPDT-E", STARTS, EXPERT),
    four("cheetah_dir", "MPDT-ones", STARTS, EXPERT, label="ones"),
    four("ant_dir", PLAIN, STARTS, EXPERT),
    four("ant_dir", "MPDT-ones", STARTS, EXPERT, label="ones"),
    *(four(data, "Prompt-DT", INFER) for data in ("cheetah_dir", "ant_dir", "ml10")),
    *(four(data, PLAIN, STARTS, EXPERT) for data in ("ml10", "mt10")),
    four("ml10", PLAIN, LONG, {"adapt": {"starts": ["cross"]}}, EXPERT, label="long"),
    four("mt10", PLAIN, LONG, INFER, label="long"),
    *(four("mt10", "Prompt-DT", SMALLER, {"multitask": {"steps": steps}}, INFER, label=label)
      for label, steps in (("Prompt-DT-long", 6000), ("Prompt-DT-longest", 16000))),
    # Neither return-to-go nor time: goals at other distances shift both.
    four("mt10", "Prompt-DT", SMALLER, {"multitask": {"steps": 8000}}, INFER,
          {"inputs": {"return_to_go": "none", "time_table": 0}}, label="Prompt-DT-reactive"),
    # Other judgements of the weights of MPDT-no-distillation (of mt10: of `long`): the nearest
    # task's prompt alone, and few-shot that tunes the map and the head as well.
    *(four(VEL, PLAIN, *_NEAREST, seed=seed, label="nearest") for seed in (1, 2)),
    four("ant_dir", PLAIN, *_NEAREST, label="nearest"),
    four("mt10", PLAIN, LONG, *_NEAREST, label="long-nearest"),
    four("ml10", PLAIN, ALL_TUNED, TEST, label="few-shot-all"),
)  # fmt: skip
