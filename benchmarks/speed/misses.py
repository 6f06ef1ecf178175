"""What is known about targets that were missed, and what the next factor of two would need.

Printed by performance_page.py into docs/performance.md; MISSES only where one was missed. Times
are process times of one thread, measured on the page's machine with cProfile or a timer.
"""

from __future__ import annotations

MISSES = {
    "collecting": (
        "Physics is all but a tenth of a block. The rest is the policy's matrix products, rewards "
        "and observations of a step, one digest per episode, and the part on the disk (zip, "
        "fsync), which the limit does not write. On a busy machine two workers get a smaller "
        "share of the processor than a peer's single process does, so the ratio to Minari's "
        "collector says something on an idle one only."
    ),
    "storing": (
        "Packing is bound by the processor, not by the disk: 1.25 s for 81 MB, after 2.07 s before "
        "steps were written some megabytes at a time, the file's digests taken in bulk and "
        "quantiles column by column. Of these 31 % are statistics of the columns, 31 % reading and "
        "checking the parts, 25 % writing and the episodes' digests, 3 % the check of the written "
        "file. SHA-256 runs three times over every byte (part, episode, file read back); at the "
        "rate in the table that alone is a floor, and it is what tells a torn write. Opening is "
        "bound by h5py, more than a hundred small datasets, and by the episode table, 200 bytes "
        "per episode, with one SHA-256 over its digests; only the last two grow."
    ),
    "sampling": (
        "A batch of 160 windows fell from 1,136 to 238 us. Of these about 100 are random numbers: "
        "two calls per task whose order is part of what (seed, step) means; 66 are "
        "returns-to-go, summed in float64 in the order of the episode so that they have the same "
        "bits as a sum over all of it; the gather is 74. The bare rows of the table leave out "
        "pads, sums, masks, timesteps and previous actions. Fifty times the loop would be less "
        "than the random numbers alone."
    ),
    "training": (
        "What an update does beside matrix products: attention over 50 keys, norms, masks and the "
        "copies between them, each a small operation on one thread. The smaller a model's width, "
        "the larger their share."
    ),
    "remembering": (
        "Packing ends with the statistics of all columns. Their quantiles are exact, so whole "
        "columns are held, as many as fit into 256 MiB and at least one: memory grows up to that "
        "bound, and beyond it with the 24 bytes per step of a single column."
    ),
    "starting": (
        "What is imported before a command is known; `python -X importtime -m mpdt.data.cli "
        "--help` lists it."
    ),
    "pretraining": (
        "The policy's own forward pass and stable-baselines3's buffers take the time in "
        "which experience is collected and physics are not stepped."
    ),
}
FLOORS = {
    "collecting": "More cores; per core the simulator is all there is.",
    "metaworld": (
        "Per step about 160 us are physics, run by MuJoCo one environment at a time. The published "
        "rewards, Python functions of a few arrays, are most of the rest. Native stepping of whole "
        "batches (a prototype for reach: 2.2 times) needs every observation and reward written "
        "anew, and the published warm start given up, so other bytes."
    ),
    "storing": "Hashing in several threads, and one read of the parts instead of two.",
    "sampling": "Another meaning of (seed, step): one draw for all tasks. That is another run.",
    "training": (
        "An accelerator. On this processor the update is within a factor of two of one large "
        "bfloat16 matrix product."
    ),
    "acting": (
        "A window that does not slide: keys and values of old tokens could stay if positions were "
        "relative and the policy were trained with everything before the window in sight."
    ),
    "pretraining": "The network's forward and backward passes outside of Python.",
}
