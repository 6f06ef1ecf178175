"""Whatever a method trains acts from its bundle: demonstrations, adapters, additions, networks."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from makers import make_bundle, make_trained

import mpdt
from mpdt.errors import UsageError
from mpdt.model.closed_loop import ClosedLoop
from mpdt.train.bundle.contents import contents_of, own_prompts
from mpdt.train.run.config import to_plain

TINY = ("--backbone.name", "random:tiny-llama", "--backbone.depth", "2")
SEEN = np.random.default_rng(0).normal(size=(5, 2, 20)).astype(np.float32)
PAID = np.random.default_rng(1).normal(size=(5, 2)).astype(np.float32)


@pytest.mark.parametrize(("method", "words"), [
    ("MPDT", TINY), ("MPDT-E", ()), ("MPDT-teacher-parts", ()), ("Soft-Prompt", ()),
    ("Prompt-DT", ()), ("MT-BC", ()), ("MT-ORL", ()), ("LaMo", TINY),
    ("HDT", ("--prompts.length", "3")), ("Full-FT", TINY),
])  # fmt: skip
def test_every_method(method, words, tiny_file, tmp_path):
    prepared, trained = make_trained(tiny_file, method, *words)
    with torch.no_grad():  # as if it had been trained: nothing is where it began
        generator = torch.Generator().manual_seed(0)
        for module in (trained.policy, trained.prompts):
            for value in module.parameters():
                if value.requires_grad:
                    value += 0.05 * torch.randn(value.shape, generator=generator).to(value.dtype)
        prompts = trained.prompts.task_prompts()
    policy = mpdt.load_policy(make_bundle(tmp_path / "b", prepared, trained))
    window = prepared.config.sampler.window
    loop = ClosedLoop(trained.policy, prompts, torch.arange(2), window, trained.returns)
    policy.reset(["forward", "backward"])
    for step, seen in enumerate(SEEN):
        paid = PAID[step] if step else None
        assert np.array_equal(policy.act_batch(seen, paid), loop.act(seen, paid)), step
    if not trained.policy.backbone.frozen:
        with pytest.raises(UsageError, match="was trained as well"):
            contents_of(trained, [own_prompts(trained)], to_plain(prepared.config), "b", {},
                        with_backbone=False)  # fmt: skip
