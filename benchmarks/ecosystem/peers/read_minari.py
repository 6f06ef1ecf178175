"""Minari: every set, and one episode replayed in the environment it says it comes from."""

import os
import sys

os.environ["MINARI_DATASETS_PATH"], steps = sys.argv[1], int(sys.argv[3])
import minari
import numpy as np

names = sorted(minari.list_local_datasets())
total = sum(minari.load_dataset(name).total_steps for name in names)
assert total == steps, total
data = minari.load_dataset(next(name for name in names if "expert" in name))
env = data.recover_environment()
episode = data[0]
metadata = next(iter(data.storage.get_episode_metadata([0])))
observation, _ = env.reset(seed=int(metadata["seed"]), options=metadata["options"])
assert np.array_equal(observation.astype("f4"), episode.observations[0])
for step, action in enumerate(episode.actions):
    observation, reward, *_ = env.step(action)
    assert np.array_equal(observation.astype("f4"), episode.observations[step + 1]), step
    assert np.float32(reward) == np.float32(episode.rewards[step]), step
print(minari.__version__, f"{len(names)} sets, {total:,} steps; {step + 1} steps replayed, equal")
