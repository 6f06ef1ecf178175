"""One update of the training loop on one thread, at two shapes of language model.

    python benchmarks/speed/training.py [--rounds 3] [--keep]

ours     `fit/loop.py`: bfloat16 blocks where the processor multiplies it, the prompt of a task
         run once for its 16 windows, frozen weights without gradients
plain    the same loss in float32, every window behind a copy of its prompt
peer     transformers' DecisionTransformerModel of the same width and depth in float32: three
         tokens per step, all weights trained, AdamW
limit    one large matrix product in bfloat16; what an update needs is counted from its products
         alone: 2 per weight and token forwards, 2 backwards (frozen weights need no gradient)

Untrained weights: what they are does not change the time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rounds
import synthetic

DEPTH, TASKS, PER_TASK, K, PROMPT = 4, 4, 16, 20, 30
SHAPES = {"GPT-2 small": "random:gpt2", "SmolLM2-135M": "random:smollm2-135m"}


class Run:
    """Policy, prompts, optimiser and windows of one run; `dtype` auto is what users get.

    Args:
        hardware: where updates are computed; None = plainly on the processor.
    """

    def __init__(
        self, dataset: Any, backbone: str, dtype: str, depth: int = DEPTH, hardware: Any = None
    ) -> None:
        import torch

        from mpdt.data.slices.sampler import WindowSampler
        from mpdt.model.backbone import load_backbone
        from mpdt.model.policy import HeadSettings, PromptPolicy
        from mpdt.model.prompts import DecomposedPrompts, PromptSettings
        from mpdt.model.returns import ReturnTable
        from mpdt.model.tokens import InputSettings
        from mpdt.train.fit.device import PROCESSOR
        from mpdt.train.fit.loop import OptimiserSettings, make_optimizer

        rows = list(dataset.tasks.train_rows)[:TASKS]
        ids = {row: dataset.select(task=row, quality="expert") for row in rows}
        self.dataset = dataset
        self.sampler = WindowSampler(dataset, ids, rows, K, PER_TASK, 0)
        self.backbone = load_backbone(backbone, depth, dtype)
        stats = dataset.stats["observations"]
        inputs = InputSettings(kind="trained", return_to_go="none")
        self.policy = PromptPolicy(
            self.backbone, inputs, HeadSettings(hidden=256), stats["mean"], stats["std"],
            dataset.action_size)  # fmt: skip
        self.prompts = DecomposedPrompts(
            PromptSettings(length=PROMPT), TASKS, self.backbone.width, self.backbone.spread, 0
        )
        one = torch.ones(TASKS)
        self.hardware = hardware or PROCESSOR
        table = ReturnTable(scale=one, low=0 * one, high=one, target=one)
        self.returns = self.hardware.returns(table)
        self.settings = OptimiserSettings()
        self.optimizer = make_optimizer(self.policy, self.prompts, self.settings)
        self.done = 0

    def run(self) -> None:
        from mpdt.train.fit.loop import Update, fit

        update = Update(self.policy, self.prompts, self.returns, self.sampler.seed,
                        hardware=self.hardware)  # fmt: skip
        fit(update, self.sampler, self.optimizer, self.settings,
            range(self.done, self.done + 1), lambda step, parts: False)  # fmt: skip
        self.done += 1

    def plain(self) -> None:
        """The same update with nothing shared: a prompt in front of every window."""
        import torch
        from einops import repeat

        from mpdt.model.policy import PolicyBatch, action_loss
        from mpdt.model.prefix import NO_PREFIX

        windows = self.sampler.batch(self.done)
        batch, slots = PolicyBatch.from_windows(windows), torch.from_numpy(windows.slots)
        tokens, mask = self.policy.tokens(batch, self.returns.select(slots))
        before = repeat(self.prompts.task_prompts(slots), "n l s -> (n M) l s", M=PER_TASK)
        rows = torch.cat([before, tokens.flatten(0, 1)], dim=1)
        seen = torch.cat([torch.ones(len(rows), PROMPT, dtype=torch.bool), mask.flatten(0, 1)], 1)
        hidden, _ = self.backbone.forward_with_cache(NO_PREFIX, rows, seen)
        actions = self.policy.head(hidden[:, PROMPT:]).unflatten(0, mask.shape[:2])
        loss = action_loss(actions, batch.actions, batch.mask)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(list(self.prompts.parameters()), 0.25)
        self.optimizer.step()
        self.done += 1

    @property
    def flops(self) -> float:
        """Of the matrix products of one update, see above; attention's own are 1 %, left out."""
        blocks = self.backbone.blocks()
        weights = sum(p.numel() for p in blocks.parameters() if p.dim() == 2)
        tokens = TASKS * (PER_TASK * K + PROMPT)
        return 4.0 * weights * tokens


def decision_transformer(dataset: Any, ours: Run) -> Callable[[], None]:
    """transformers' own, at the width and depth of `ours`."""
    import torch
    from transformers import DecisionTransformerConfig, DecisionTransformerModel

    from mpdt.model.policy import PolicyBatch

    width = ours.backbone.width
    heads = 12 if width % 12 == 0 else 9
    config = DecisionTransformerConfig(
        state_dim=dataset.observation_size, act_dim=dataset.action_size, hidden_size=width,
        max_ep_len=1000, n_layer=DEPTH, n_head=heads, n_inner=4 * width)  # fmt: skip
    model = DecisionTransformerModel(config)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-4)
    step = 0

    def run() -> None:
        nonlocal step
        batch = PolicyBatch.from_windows(ours.sampler.batch(step))
        flat = {
            name: getattr(batch, name).flatten(0, 1)
            for name in ("observations", "actions", "returns_to_go", "timesteps", "mask")
        }
        found = model(
            states=flat["observations"], actions=flat["actions"],
            rewards=flat["returns_to_go"][..., None], timesteps=flat["timesteps"],
            returns_to_go=flat["returns_to_go"][..., None],
            attention_mask=flat["mask"].long()).action_preds  # fmt: skip
        loss = (found - flat["actions"]).square()[flat["mask"]].mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 0.25)
        optimizer.step()
        step += 1

    return run


def product(dtype: Any, device: str = "cpu") -> tuple[Callable[[], None], float]:
    """A matrix product of the size of a block's, and its floating-point operations."""
    import torch

    tokens, width, times = 1280, 768, 8
    a = torch.randn(tokens, width, dtype=dtype, device=device)
    b = torch.randn(4 * width, width, dtype=dtype, device=device)

    def run() -> None:
        for _ in range(times):
            torch.nn.functional.linear(a, b)

    return run, 2.0 * times * tokens * width * 4 * width


@contextmanager
def data() -> Iterator[Any]:
    """New data to draw windows from; gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="mpdt-bench-", dir=rounds.scratch()) as work:
        yield synthetic.write(Path(work) / "ml10.h5", "ml10", 10, 500)


def updates() -> Iterator[tuple[str, Run, Run]]:
    """Per shape of language model: as users get it, and in plain float32, on the same new data."""
    with data() as dataset:
        for name, backbone in SHAPES.items():
            yield name, Run(dataset, backbone, "auto"), Run(dataset, backbone, "float32")


def measure(report: rounds.Report) -> None:
    import torch

    torch.set_num_threads(1)
    few = min(3, report.rounds)
    for name, ours, plain in updates():
        size = f"{TASKS} tasks x {PER_TASK} windows, {DEPTH} blocks"
        report.compare(
            f"update, {name}, {size}", "updates/s",
            [rounds.Way(f"mpdt, {str(ours.backbone.dtype)[6:]}", "ours", ours.run, 1),
             rounds.Way("mpdt, plain float32", "plain", plain.plain, 1),
             rounds.Way("DecisionTransformerModel", "peer",
                        decision_transformer(ours.dataset, ours), 1)],
            [rounds.Target("mpdt, plain float32", 5.0)], few)  # fmt: skip
        (half, work_half), (full, work_full) = product(torch.bfloat16), product(torch.float32)
        report.compare(
            f"arithmetic of an update, {name}", "FLOP/s",
            [rounds.Way("mpdt", "ours", ours.run, ours.flops),
             rounds.Way("matmul, bfloat16", "limit", half, work_half),
             rounds.Way("matmul, float32", "limit", full, work_full)],
            [rounds.Target("matmul, bfloat16", 0.5)], few)  # fmt: skip


if __name__ == "__main__":
    rounds.main("training", measure)
