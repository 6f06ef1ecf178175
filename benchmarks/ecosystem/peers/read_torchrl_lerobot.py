"""TorchRL: the LeRobot folder as its replay buffer, and slices that stay in an episode.

It takes data sets from the hub alone, so its download is told where the folder lies.
"""

import sys

import huggingface_hub

folder, cache, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])
huggingface_hub.snapshot_download = lambda *_args, **_options: folder
import torchrl
from torchrl.data.datasets import LeRobotExperienceReplay

buffer = LeRobotExperienceReplay("me/exported", root=f"{cache}-lerobot", batch_size=64, slice_len=8)
assert len(buffer) == steps, len(buffer)
batch = buffer.sample()
rows = batch["episode"].reshape(8, 8)
assert (rows == rows[:, :1]).all() and (batch["frame"].reshape(8, 8).diff(dim=1) == 1).all()
size = batch["observation", "state"].shape[-1]
print(torchrl.__version__, f"{len(buffer):,} frames of {size} numbers; slices of 8 within episodes")
