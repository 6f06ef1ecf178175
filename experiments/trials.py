"""Which settings should trials have? Asked of training tasks that were left out of training.

    python experiments/trials.py FILE --leave-out door-open sweep --run FOLDER
        [--row alone] [--episodes 10] [--with planner.noise=0.3 opening=0] [--json F]

FILE's training tasks but those left out are trained on (once, in FOLDER, resumable); those left out
then get own trials as unseen tasks do, and the policies that the trials speak for are judged on
fresh goals. Test tasks are not touched, so settings may be chosen by this table (decision 0033).
X of a task left out is its first 20 random episodes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from trained import SEED

from mpdt.errors import MpdtError
from mpdt.model.backbone import from_settings
from mpdt.seeding import phase_seed
from mpdt.train.adapt.align import AdaptSettings
from mpdt.train.adapt.infer import explain
from mpdt.train.adapt.trials.inside import make_inside
from mpdt.train.adapt.trials.lived import stretches_of
from mpdt.train.adapt.trials.schedule import Ground, TaskTrials
from mpdt.train.adapt.trials.settings import TrialSettings
from mpdt.train.evaluate.controller import PromptController
from mpdt.train.evaluate.rollout import SimulatorCache, evaluate
from mpdt.train.fit.reward import fit_reward_model, read_training_tasks, read_transitions
from mpdt.train.fit.trained import Trained
from mpdt.train.run.build import build
from mpdt.train.run.config import TrainConfig
from mpdt.train.run.folder import RunFolder, claimed
from mpdt.train.run.identity import identify, plain_settings
from mpdt.train.run.methods import merge
from mpdt.train.run.prepare import Prepared, prepare
from mpdt.train.run.progress import Progress
from mpdt.train.run.trainer import Trainer
from mpdt.train.study.plans import STUDIES, get_study
from mpdt.train.study.study import configure

X_EPISODES = 20


def train_without(
    data: str, cell: str, left_out: list[str], run: Path
) -> tuple[TrainConfig, Trained]:
    """The cell of a study trained without these tasks, which are its test tasks."""
    config = next(configure(one) for study in STUDIES for one in get_study(study)
                  if one.name == cell)  # fmt: skip
    config = msgspec.structs.replace(
        config, adapt=msgspec.structs.replace(AdaptSettings(starts=("none",)),
                                              infer=config.adapt.infer))  # fmt: skip
    found = prepare(config, data)
    names = found.material.dataset.tasks.names
    rows = found.material.train_rows
    kept = tuple(row for row in rows if names[row] not in left_out)
    material = replace(
        found.material, train_rows=kept, test_rows=tuple(row for row in rows if row not in kept),
        episode_ids={row: found.material.episode_ids[row] for row in kept},
    )  # fmt: skip
    plain = plain_settings(config)
    prepared = Prepared(config, plain, data, material, identify(config, plain, material))
    torch.set_num_threads(1)
    learner, folder = build(prepared, from_settings(config.backbone)), RunFolder(run)
    with claimed(folder, prepared.identity, False):
        return config, Trainer(learner, folder, Progress()).train()


def try_out(
    config: TrainConfig, trained: Trained, settings: TrialSettings, row: str, judged: int,
    only: list[str],
) -> dict[str, Any]:  # fmt: skip
    """Per task: what was done, and return and success of the policy after each K asked for."""
    material, family = trained.material, trained.material.family
    dataset, box = material.dataset, (material.family.action_low, material.family.action_high)
    seed, progress, window = phase_seed(config.seed, "trials"), Progress(), config.sampler.window
    began = time.process_time()
    inside = make_inside(trained, settings, window, seed, progress.update)
    print(f"made inside in {time.process_time() - began:.0f} s", flush=True)
    model = fit_reward_model(read_training_tasks(material), config.adapt.infer, seed)
    most, found, cache = max(settings.episodes), {}, SimulatorCache()
    horizon = config.evaluation.horizon or material.horizon
    returns = trained.returns.pooled([family.return_target])
    ground = Ground(trained, inside, settings, window, horizon, config.adapt.infer.tasks, bytes(32),
                    model if settings.infer == "rewards" else None)  # fmt: skip
    asked = zip(material.test_rows, material.tasks(material.test_rows), strict=True)
    for task_row, task in asked:
        if only and task.name not in only:
            continue
        ids = dataset.select(task=task_row, quality="random")[:X_EPISODES]
        weights, x = None, []
        if row == "with_x":
            steps = read_transitions(dataset, ids, dataset.steps.rewards, *box)
            own = explain(model, steps, config.adapt.infer.tasks).weights
            weights = torch.from_numpy(own[None]).float()
            x = stretches_of(dataset, ids.tolist(), dataset.steps.rewards, *box)
        began = time.process_time()
        trials = TaskTrials(ground, task, returns, lambda number, text: None, weights, x,
                            race=row == "race")  # fmt: skip
        for number in range(most):
            at = time.process_time()
            trials.trial()
            episode = trials.tried.episodes[-1]
            hit = episode.successes is not None and episode.successes.any()
            reached = int(episode.successes.argmax()) if hit else "-"
            print(f"  {task.name} {number + 1}: {trials.tried.acts[-1]} "
                  f"{episode.episode_return:.0f} {reached} ({time.process_time() - at:.0f} s)",
                  flush=True)  # fmt: skip
        took = time.process_time() - began
        rows: dict[int, tuple[str, float, float | None]] = {}  # by place: names may be shared
        chosen = {count: trials.tried.chosen[count] for count in sorted({0, *settings.episodes})}
        for place in set(chosen.values()):
            one = trials.tried.contenders[place]
            actor = PromptController(one.policy, one.prompt, returns, window, *box)
            result = evaluate(
                actor, family, [task], material.options, horizon, judged, SEED, 128, None,
                cache.make, partial(material.goal_key, block="train"),
            )  # fmt: skip
            share = None if result.successes is None else float(result.successes.mean())
            rows[place] = (one.name, float(result.returns.mean()), share)
        told = {count: rows[place] for count, place in chosen.items()}
        print(task.name, told, f"{took:.0f} s", flush=True)
        found[task.name] = {
            "acts": trials.tried.acts, "seconds": round(took),
            "returns": [round(e.episode_return, 1) for e in trials.tried.episodes],
            "successes": [e.success for e in trials.tried.episodes],
            "after": {str(count): row for count, row in told.items()},
        }  # fmt: skip
    return found


def settings_with(words: list[str], episodes: list[int]) -> TrialSettings:
    """`planner.noise=0.3` laid over the defaults. Raises: MpdtError; msgspec.ValidationError."""
    plain: dict[str, Any] = msgspec.to_builtins(TrialSettings(episodes=tuple(episodes)))
    for word in words:
        path, _, value = word.partition("=")
        changes: Any = json.loads(value)
        for name in reversed(path.split(".")):
            changes = {name: changes}
        plain = merge(plain, changes)
    return msgspec.convert(plain, TrialSettings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data")
    parser.add_argument("--leave-out", nargs="+", required=True)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--cell", default="ml10.ones-long.s0")
    parser.add_argument("--row", choices=("alone", "with_x", "race"), default="with_x")
    parser.add_argument("--episodes", type=int, nargs="+", default=[1, 3, 10])
    parser.add_argument("--judged", type=int, default=20)
    parser.add_argument("--tasks", nargs="*", default=[])
    parser.add_argument("--with", dest="words", nargs="*", default=[])
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    try:
        settings = settings_with(args.words, args.episodes)
        config, trained = train_without(args.data, args.cell, args.leave_out, args.run)
        found = try_out(config, trained, settings, args.row, args.judged, args.tasks)
    except MpdtError as error:
        sys.exit(error.render())
    for count in sorted({0, *args.episodes}):
        rows = [one["after"][str(count)] for one in found.values()]
        shares = [share for _, _, share in rows if share is not None]
        earned = np.mean([mean for _, mean, _ in rows])
        print(f"{args.row} {' '.join(args.words)} K={count}: return {earned:.1f}"
              + (f", success {np.mean(shares):.2f}" if shares else ""))  # fmt: skip
    if args.json:
        content = {"left_out": args.leave_out, "row": args.row, "with": args.words,
                   "settings": msgspec.to_builtins(settings), "judged": args.judged, "seed": SEED,
                   "tasks": found}  # fmt: skip
        args.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
