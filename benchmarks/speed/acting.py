"""Closed-loop acting and adaptation of soft prompts, on one thread.

    python benchmarks/speed/acting.py [--rounds 5] [--keep]

acting     ours: all rows as one batch, prompts run once, old tokens only looked at (decision 0024)
           whole: the same with the whole window of K = 20 recomputed at each step
           plain: one episode after another, prompt and window recomputed at each step, as the
           evaluation loops of Decision Transformer and Prompt-DT do; where there are rows to spare
           limit: one new token per row and step through all blocks, everything before it cached.
           Behind the first block a window that slides cannot reach it: what deeper blocks kept of
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

K, PROMPT = training.K, training.PROMPT
STEPS = {1: 40, 16: 8, 100: 3}
"""Rows -> steps in a round."""
LEAST = {(1, 1): 3.0, (100, 1): 10.0, (100, 4): 1.5}
"""(rows, blocks) -> how many times the whole window."""


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


def together(update: training.Run, rows: int) -> Callable[[], float]:
    acting, steps = loop(update, rows), STEPS[rows]
    seen = np.random.default_rng(0).standard_normal((steps, rows, update.policy.observation_size))

    def run() -> float:
        for step in seen.astype(np.float32):
            acting.act(step)
        return float(steps * rows)

    return run


def whole(update: training.Run, rows: int, alone: bool = False) -> Callable[[], float]:
    """Every token of a full window through all blocks; `alone`: row after row, prompt and all."""
    import torch

    from mpdt.model.policy import PolicyBatch

    policy, generator = update.policy, torch.Generator().manual_seed(0)
    index = torch.arange(rows) % training.TASKS
    prompts = update.prompts.task_prompts().detach()
    with torch.no_grad():
        prefix = update.backbone.encode_prefix(prompts).select(index)
    shape = (rows, 1, K)
    window = PolicyBatch(
        torch.randn((*shape, policy.observation_size), generator=generator),
        torch.zeros(*shape, policy.action_size), torch.zeros(shape),
        torch.arange(K).expand(shape), torch.ones(shape, dtype=torch.bool),
    )  # fmt: skip

    def once() -> float:
        with torch.no_grad():
            before = update.backbone.encode_prefix(prompts[:1]) if alone else prefix
            tokens, mask = policy.tokens(window)
            hidden, _ = update.backbone.forward_with_cache(before, tokens[:, 0], mask[:, 0])
            policy.head(hidden[:, -1:])
        return float(rows)

    return lambda: sum(once() for _ in range(STEPS[rows]))


def one_token(update: training.Run, rows: int) -> Callable[[], float]:
    """Blocks and head for one token per row, with keys and values of all others ready."""
    import torch

    before = torch.zeros(rows, PROMPT + K - 1, update.backbone.width)
    with torch.no_grad():
        cache = update.backbone.encode_prefix(before)
    token, mask = torch.zeros(rows, 1, update.backbone.width), torch.ones(rows, 1, dtype=torch.bool)

    def run() -> float:
        with torch.no_grad():
            for _ in range(STEPS[rows]):
                hidden, _ = update.backbone.forward_with_cache(cache, token, mask)
                update.policy.head(hidden)
        return float(STEPS[rows] * rows)

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
        tokens, mask = update.policy.tokens(batch)
        for task in range(training.TASKS):
            before = prompts[task].expand(training.PER_TASK, -1, -1)
            seen = torch.cat([torch.ones(before.shape[:2], dtype=torch.bool), mask[task]], dim=1)
            rows = torch.cat([before, tokens[task]], dim=1)
            _, features = update.backbone.forward_with_cache(NO_PREFIX, rows, seen, True)
            kept = tuple(feature[:, PROMPT:] for feature in features)
            torch.autograd.grad(distance(kept, mask[task]), prompts, retain_graph=True)
        return float(training.TASKS)

    return run


def compare_acting(report: rounds.Report, update: training.Run, name: str) -> None:
    blocks = update.backbone.num_layers
    kind = str(update.backbone.dtype)[6:]
    for rows in STEPS:
        ways = [rounds.Way("mpdt", "ours", together(update, rows), 0),
                rounds.Way("one token per step", "limit", one_token(update, rows), 0),
                rounds.Way("whole window", "plain", whole(update, rows), 0)]  # fmt: skip
        least = LEAST.get((rows, blocks))
        targets = [rounds.Target("whole window", least)] if least else []
        if rows == max(STEPS):
            alone = whole(update, 1, alone=True)
            ways.append(rounds.Way("one episode at a time", "plain", alone, 0))
            targets.append(rounds.Target("one episode at a time", 10.0))
        report.compare(f"acting, {name}, {kind}, {blocks} block{'s' * (blocks > 1)}, {rows} row"
                       f"{'s' * (rows > 1)}", "actions/s", ways, targets)  # fmt: skip


def measure(report: rounds.Report) -> None:
    import torch

    from mpdt.model.language import pick_dtype

    torch.set_num_threads(1)
    few = min(3, report.rounds)
    for name, ours, plain in training.updates():
        report.compare(
            f"adapting, {name}, {training.TASKS} tasks x {training.PER_TASK} windows",
            "tasks/s",
            [rounds.Way("mpdt", "ours", adapting(ours, True), 0),
             rounds.Way("task after task, nothing shared", "plain",
                        adapting(plain, False), 0)],
            rounds=few)  # fmt: skip
    rotary = training.SHAPES["SmolLM2-135M"]
    kinds = {str(pick_dtype("auto"))[6:], "float32"}
    with training.data() as dataset:
        for kind in sorted(kinds):
            for depth in (1, training.DEPTH):
                update = training.Run(dataset, rotary, kind, depth)
                compare_acting(report, update, "SmolLM2-135M")
        # Positions that are learned vectors: the window is recomputed but for the last block.
        compare_acting(report, training.Run(dataset, "random:gpt2", "auto", 1), "GPT-2 small")


if __name__ == "__main__":
    rounds.main("acting", measure)
