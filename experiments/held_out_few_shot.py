"""How long and how fast should few-shot tune? Asked of classes left out of training.

    python experiments/held_out_few_shot.py FILE --cell ml45.MPDT-ones.s0 --run FOLDER
        [--leave-out 9 | NAME ...] [--draw 0] [--episodes 10] [--json F]
        --try updates=300 --try updates=1000 lr=3e-4 ...

FILE's training tasks but those left out are trained on as the cell has it (once, in FOLDER,
resumable); each of those left out is then tuned on 200 steps of its expert, every weight, and
judged on other goals than the labelled ones. Test tasks are not touched.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from typing import Any

import msgspec
import numpy as np
from held_out_classes import drawn, parser_of
from trained import SEED
from trials import train_without

from mpdt.draw.table import markdown_table
from mpdt.errors import MpdtError, UsageError
from mpdt.train.adapt.candidates import Candidates
from mpdt.train.adapt.few_shot import FewShotSettings
from mpdt.train.evaluate.rollout import SimulatorCache, evaluate
from mpdt.train.fit.trained import Trained
from mpdt.train.run.config import TrainConfig

EVERY_WEIGHT = FewShotSettings(qualities=("expert",), tuned="all", updates=300)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--try", dest="tries", nargs="+", action="append", required=True)
    args = parser.parse_args()
    try:
        settings = {" ".join(words): settings_of(words) for words in args.tries}
        left_out = drawn(args.data, args.leave_out, args.draw)
        print("left out:", *left_out, flush=True)
        config, trained = train_without(args.data, args.cell, left_out, args.run)
        content: dict[str, Any] = {
            "cell": args.cell, "left_out": left_out, "episodes": args.episodes, "seed": SEED,
            "updates": config.multitask.steps,
            "content_hash": trained.material.dataset.content_hash, "tried": {},
        }  # fmt: skip
        for name, own in settings.items():
            content["tried"][name] = judge(config, trained, own, args.episodes)
            print(name, content["tried"][name], flush=True)
            if args.json:
                args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except MpdtError as error:
        sys.exit(error.render())
    rows = [[name, f"{np.mean(one['returns']):,.1f}", f"{np.mean(one['success']):.2f}"]
            for name, one in content["tried"].items()]  # fmt: skip
    print(markdown_table(["settings", "mean return", "success"], rows))


def settings_of(words: list[str]) -> FewShotSettings:
    """`updates=1000 lr=3e-4` over what few-shot-all has. Raises: UsageError."""
    given = dict(word.partition("=")[::2] for word in words)
    try:
        return msgspec.convert(
            msgspec.to_builtins(EVERY_WEIGHT) | given, FewShotSettings, strict=False
        )
    except msgspec.ValidationError as error:
        raise UsageError("no settings of few-shot", where=f"--try {' '.join(words)}",
                         found=str(error)) from error  # fmt: skip


def judge(
    config: TrainConfig, trained: Trained, settings: FewShotSettings, episodes: int
) -> dict[str, list[Any]]:
    """The mean return and the share of successes of every task left out, by name."""
    material, family = trained.material, trained.material.family
    config = msgspec.structs.replace(config, few_shot=settings)
    tuned = next(one for one in Candidates(trained, config) if one.name.startswith("few_shot"))
    result = evaluate(
        tuned.controller, family, material.tasks(material.test_rows), material.options,
        config.evaluation.horizon or material.horizon, episodes, SEED, config.evaluation.max_rows,
        None, SimulatorCache().make, partial(material.goal_key, block="train"),
    )  # fmt: skip
    return {"tasks": [material.dataset.tasks.names[row] for row in material.test_rows],
            "returns": result.returns.mean(axis=1).round(1).tolist(),
            "success": [] if result.successes is None
            else result.successes.mean(axis=1).tolist()}  # fmt: skip


if __name__ == "__main__":
    main()
