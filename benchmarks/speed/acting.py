"""Closed-loop acting and adaptation of soft prompts, on one thread.

    python benchmarks/speed/acting.py [--rounds 3] [--keep]

acting     ours: all rows as one batch, prompts run once, windows of K = 20 recomputed at each step
           plain: one episode after another, prompt and window recomputed at each step, as the
           evaluation loops of Decision Transformer and Prompt-DT do
           limit: one new token per row and step, everything before it cached. No window that
           slides can reach it: its tokens change their positions, and what deeper blocks kept of
           the others has seen tokens that are no longer there
adapting   ours: windows of all test tasks as one batch, prompts run once per task
           plain: one task after another, every window behind a copy of its prompt, float32
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import rounds
import training

ROWS, STEPS, K, PROMPT = 50, 4, training.K, training.PROMPT


def loop(update: training.Run, rows: int) -> Any:
    """A closed loop whose window is full."""
    import torch

    from mpdt.model.closed_loop import ClosedLoop

    index = torch.arange(rows) % training.TASKS
    prompts = update.prompts.task_prompts().detach()
    made = ClosedLoop(update.policy, prompts, index, K)
    for _ in range(K):
        made.act(np.zeros((rows, update.policy.observation_size), np.float32))
    return made


def together(update: training.Run) -> Callable[[], float]:
    acting = loop(update, ROWS)
    seen = np.random.default_rng(0).standard_normal((STEPS, ROWS, update.policy.observation_size))

    def run() -> float:
        for step in seen.astype(np.float32):
            acting.act(step)
        return float(STEPS * ROWS)

    return run


def alone(update: training.Run) -> Callable[[], float]:
    """One row; its prompt is run again for every action."""
    import torch

    acting = loop(update, 1)
    prompts = update.prompts.task_prompts().detach()[:1]
    seen = np.random.default_rng(0).standard_normal((STEPS, 1, update.policy.observation_size))

    def run() -> float:
        for step in seen.astype(np.float32):
            with torch.no_grad():
                acting._prefix = update.backbone.encode_prefix(prompts)
            acting.act(step)
        return float(STEPS)

    return run


def one_token(update: training.Run) -> Callable[[], float]:
    """Blocks and head for one token per row, with keys and values of all others ready."""
    import torch

    width = update.backbone.width
    before = torch.zeros(ROWS, PROMPT + K - 1, width)
    with torch.no_grad():
        cache = update.backbone.encode_prefix(before)
    token, mask = torch.zeros(ROWS, 1, width), torch.ones(ROWS, 1, dtype=torch.bool)

    def run() -> float:
        with torch.no_grad():
            for _ in range(STEPS):
                hidden, _ = update.backbone.forward_with_cache(cache, token, mask)
                update.policy.head(hidden)
        return float(STEPS * ROWS)

    return run


def adapting(update: training.Run, at_once: bool) -> Callable[[], float]:
    """One update of P_c towards statistics of training; tasks done."""
    import torch

    from mpdt.model.policy import PolicyBatch
    from mpdt.model.prefix import NO_PREFIX

    prompts = update.prompts.task_prompts().detach().requires_grad_()

    def distance(features: Any, mask: Any) -> Any:
        kept = [feature[mask] for feature in features]
        return sum(x.mean(0).abs().sum() + x.var(0).abs().sum() for x in kept)

    def run() -> float:
        batch = PolicyBatch.from_windows(update.sampler.batch(0))
        if at_once:
            output = update.policy(batch, prompts, layer_features=True)
            torch.autograd.grad(distance(output.features, batch.mask), prompts)
            return float(training.TASKS)
        tokens, mask = update.policy._tokens(batch, None, None)
        for task in range(training.TASKS):
            before = prompts[task].expand(training.PER_TASK, -1, -1)
            seen = torch.cat([torch.ones(before.shape[:2], dtype=torch.bool), mask[task]], dim=1)
            rows = torch.cat([before, tokens[task]], dim=1)
            _, features = update.backbone.forward_with_cache(NO_PREFIX, rows, seen, True)
            kept = tuple(feature[:, PROMPT:] for feature in features)
            torch.autograd.grad(distance(kept, mask[task]), prompts, retain_graph=True)
        return float(training.TASKS)

    return run


def measure(report: rounds.Report) -> None:
    import torch

    torch.set_num_threads(1)
    few = min(3, report.rounds)
    for name, ours, plain in training.updates():
        report.compare(
            f"acting, {name}, {ROWS} rows", "actions/s",
            [rounds.Way("mpdt", "ours", together(ours), 0),
             rounds.Way("one token per step", "limit", one_token(ours), 0),
             rounds.Way("one episode at a time", "plain", alone(plain), 0)],
            [rounds.Target("one episode at a time", 10.0)], few)  # fmt: skip
        report.compare(
            f"adapting, {name}, {training.TASKS} tasks x {training.PER_TASK} windows",
            "tasks/s",
            [rounds.Way("mpdt", "ours", adapting(ours, True), 0),
             rounds.Way("task after task, nothing shared", "plain",
                        adapting(plain, False), 0)],
            rounds=few)  # fmt: skip


if __name__ == "__main__":
    rounds.main("acting", measure)
