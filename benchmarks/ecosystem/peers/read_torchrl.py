"""TorchRL: a Minari set as its replay buffer, and one gradient step of behaviour cloning."""

import os
import sys

os.environ["MINARI_DATASETS_PATH"], cache = sys.argv[1], sys.argv[2]
import minari
import torch
import torchrl
from torchrl.data.datasets.minari_data import MinariExperienceReplay

name = next(name for name in sorted(minari.list_local_datasets()) if "expert" in name)
buffer = MinariExperienceReplay(name, 64, root=cache, load_from_local_minari=True)
assert len(buffer) == minari.load_dataset(name).total_steps
batch = buffer.sample()
names = set(batch.keys())
assert "episode" in names and "options" not in names  # goal and seeds are left out
seen, wanted = batch["observation"].float(), batch["action"].float()
torch.manual_seed(0)
policy = torch.nn.Linear(seen.shape[-1], wanted.shape[-1])
loss = (policy(seen) - wanted).square().mean()
loss.backward()
before = loss.item()
with torch.no_grad():
    for weight in policy.parameters():
        weight -= 1e-3 * weight.grad
after = (policy(seen) - wanted).square().mean().item()
assert after < before
print(
    torchrl.__version__, f"{len(buffer):,} transitions of {name}; loss {before:.4f} -> {after:.4f}"
)
