"""AgileRL: a Minari set as the replay buffer that its offline trainer fills, and a batch of it."""

import importlib.metadata
import os
import sys

os.environ["MINARI_DATASETS_PATH"] = sys.argv[1]
import minari
from agilerl.components.replay_buffer import ReplayBuffer
from agilerl.utils.minari_utils import minari_to_agile_buffer

name = next(name for name in sorted(minari.list_local_datasets()) if "expert" in name)
data = minari.load_dataset(name)
buffer = minari_to_agile_buffer(name, ReplayBuffer(max_size=data.total_steps))
assert len(buffer) == data.total_steps
first, stored = data[0], buffer.storage
assert (stored["obs"][:5].numpy() == first.observations[:5]).all()
assert (stored["next_obs"][:5].numpy() == first.observations[1:6]).all()
batch = buffer.sample(32)
assert batch["action"].shape == (32, *data.action_space.shape)
version = importlib.metadata.version("agilerl")
print(version, f"{len(buffer):,} transitions of {name} in its buffer; a batch of 32")
