"""d3rlpy: a flat file as its dataset, and one gradient step of TD3+BC."""

import pathlib
import sys

import d3rlpy
import h5py
import numpy as np

path = next(pathlib.Path(sys.argv[1]).glob("*expert*.hdf5"))
with h5py.File(path) as file:
    names = ("observations", "actions", "rewards", "terminals", "timeouts")
    flat = {name: np.asarray(file[name]) for name in names}
data = d3rlpy.dataset.MDPDataset(**flat)
# Its episodes hold no observation after the last step: where time ran out, that step is no
# transition to it.
assert data.transition_count == len(flat["rewards"]) - int(flat["timeouts"].sum())
total = sum(float(episode.compute_return()) for episode in data.episodes)
assert abs(total - flat["rewards"].sum(dtype="f8")) < 1e-3 * abs(total)
algo = d3rlpy.algos.TD3PlusBCConfig(batch_size=32).create(device="cpu")
algo.build_with_dataset(data)
losses = algo.update(data.sample_transition_batch(32))
assert np.isfinite(list(losses.values())).all(), losses
print(d3rlpy.__version__, f"{data.size()} episodes, {data.transition_count:,} "
      f"transitions of {path.stem}; one update of TD3+BC")  # fmt: skip
