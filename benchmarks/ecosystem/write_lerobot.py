"""Writes the tree of `tests/golden/lerobot` with lerobot's own writer, in the environment of
`make ecosystem`:

    build/ecosystem/bin/python benchmarks/ecosystem/write_lerobot.py FOLDER

Columns are those of public Meta-World sets. Of what it writes, statistics are not kept: mpdt does
not read them. Two things of lerobot 0.4.4 do not go with newer libraries: torchvision, which it
imports for images, is left out (`peers/without_torchvision.py`); and numpy 2.4 makes no number of
an array of one, so values of one number are unpacked before datasets encodes them.
"""

import sys

from peers.without_torchvision import stand_in

stand_in()
import datasets.features.features as features
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

encode = features.Value.encode_example
features.Value.encode_example = lambda self, value: encode(
    self, value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
)

one = {"shape": (1,), "names": None}
columns = {
    "observation.state": {"dtype": "float32", "shape": (4,), "names": ["x", "y", "z", "gripper"]},
    "observation.environment_state": {"dtype": "float32", "shape": (39,),
                                      "names": [f"keypoint_{i}" for i in range(39)]},
    "action": {"dtype": "float32", "shape": (4,), "names": None},
    "next.reward": {"dtype": "float32", **one},
    "next.success": {"dtype": "bool", **one},
}  # fmt: skip
tree = LeRobotDataset.create("mpdt/tree", fps=80, features=columns, root=sys.argv[1],
                             use_videos=False)  # fmt: skip
for episode, (task, rows) in enumerate(
    [("reach-v3", 5), ("Push the puck, then stop.", 4), ("reach-v3", 6)]
):
    for row in range(rows):
        first = 100 * episode + 10 * row
        tree.add_frame({
            "observation.state": np.arange(first, first + 4, dtype=np.float32),
            "observation.environment_state": np.arange(first, first + 39, dtype=np.float32),
            "action": np.full(4, row / 8, np.float32),
            "next.reward": np.array([row], np.float32),
            "next.success": np.array([row >= 3]), "task": task,
        })  # fmt: skip
    tree.save_episode()
tree.finalize()
