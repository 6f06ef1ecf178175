"""LeRobot: its own LeRobotDataset on the folder, item by item, with windows of three actions.

Installed without its pins (torch below 2.11, datasets below 5). torchvision, which it imports for
images, has no build that loads beside PyTorch's CPU wheel here; an empty module stands in, and
there are no images.
"""

import importlib.metadata
import logging
import sys

from without_torchvision import stand_in

logging.disable(logging.WARNING)
stand_in()
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

folder, steps = sys.argv[1], int(sys.argv[3])
plain = LeRobotDataset("me/exported", root=folder)
assert len(plain) == steps, len(plain)
ahead = {"action": [0, 1 / plain.fps, 2 / plain.fps]}
windows = LeRobotDataset("me/exported", root=folder, delta_timestamps=ahead)
ends = np.flatnonzero(np.diff([int(i) for i in plain.hf_dataset["episode_index"]]))
for i in (0, 5, int(ends[0])):
    item = windows[i]
    assert item["action_is_pad"].tolist() == [False] + [i == ends[0]] * 2
    assert np.array_equal(item["action"][0], plain[i]["action"])
    if i != ends[0]:
        assert np.array_equal(item["action"][2], plain[i + 2]["action"])
assert plain[0]["task"] and plain.meta.stats["observation.state"]["mean"].size
version = importlib.metadata.version("lerobot")
print(version, f"{plain.num_episodes} episodes, {len(plain):,} items; windows of three actions")
