"""Minari datasets, hdf5 (lossless): one set per task and quality.

    <folder>/mpdt/<family>/<task>/<quality>-v<major>/data/metadata.json, main_data.hdf5
        episode_0/observations (T+1, D), actions, rewards, terminations, truncations, infos/
            attrs: id, total_steps, seed, options/goal, options/seed_key, ...

With MINARI_DATASETS_PATH=<folder>, `minari.load_dataset(id)` reads them, and an episode starts
again with `env.reset(seed=metadata["seed"], options=metadata["options"])` in the recovered
environment. Source: Minari 0.5.4, storage and dataset modules; written with h5py alone, since its
own writer chunks the feature axis and cannot link (0038). A test has both write the same episodes.
`minari_arrow.py` writes the same sets in Minari's other storage; `minari_in.py` reads both, ours
and those of others.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from gymnasium.envs.registration import EnvSpec

from mpdt.data.exchange import hdf5
from mpdt.data.exchange.foreign import quality_name
from mpdt.data.exchange.manifest import KEY, Manifest
from mpdt.data.exchange.minari_claims import safe
from mpdt.data.exchange.selection import Run, Selection
from mpdt.data.spec.env import describe_env
from mpdt.errors import DataError
from mpdt.seeding import UNKNOWN_SEED_KEY, SeedKey

VERSION = "0.5.0"  # readers accept an exact list; all since 0.5.0 have this one in it
STEPS = ("observations", "actions", "rewards", "terminations", "truncations")
MAIN = "main_data.hdf5"


def write(selection: Selection, folder: Path, link: bool = False) -> None:
    """One set per task and quality below `folder`.

    Args:
        link: refer to the arrays of the dataset file by its absolute path instead of copying
            them; about 3 kB per episode. Whoever moves that file breaks the sets.
    Raises: OSError; DataError where a linked episode does not read back.
    """
    manifest = Manifest.of(selection).to_json()
    for run in selection.runs():
        name = set_id(selection, run)
        place = folder / name / "data"
        place.mkdir(parents=True)
        with hdf5.created(place / MAIN) as file:
            for number, i in enumerate(run.ids.tolist()):
                group = file.create_group(f"episode_{number}")
                _write_episode(group, selection, i, number, link)
        if link:
            _check_links(place / MAIN, selection, run)
        metadata = metadata_of(selection, run, name) | {KEY: manifest}
        size = sum(path.stat().st_size for path in place.iterdir())
        metadata["dataset_size"] = round(size / 1e6, 1)
        (place / "metadata.json").write_text(json.dumps(metadata), encoding="utf-8")


def set_id(selection: Selection, run: Run) -> str:
    """What Minari calls the set of one task and quality."""
    family, major = selection.header.family, selection.header.version.partition(".")[0]
    words = (family, run.task.name, f"{quality_name(run.quality)}-v{major}")
    return "/".join(["mpdt", *map(safe, words)])


def _write_episode(
    group: h5py.Group, selection: Selection, i: int, number: int, link: bool
) -> None:
    data, episode = selection.dataset, selection.episode(i)
    first, obs_first = int(data.episodes.start[i]), int(data.episodes.obs_start[i])
    for name in STEPS:
        if link:
            stored = getattr(data.steps, name)
            source = h5py.VirtualSource(data.path.resolve(), f"steps/{name}", stored.shape,
                                        stored.dtype)  # fmt: skip
            rows = (obs_first, episode.length + 1) if name == "observations" else \
                   (first, episode.length)  # fmt: skip
            hdf5.linked(group, name, source, slice(rows[0], sum(rows)))
        else:
            # Contiguous: h5py's own chunks would split the columns.
            group.create_dataset(name, data=getattr(episode, name))
    infos = group.create_group("infos")  # printing an episode fails without the group
    if episode.successes is not None:
        at_reset = np.zeros(1, bool)
        infos.create_dataset("success", data=np.concatenate([at_reset, episode.successes]))
    group.attrs["id"], group.attrs["total_steps"] = number, episode.length
    group.attrs.update(attributes_of(selection, i))


def attributes_of(selection: Selection, i: int) -> dict[str, Any]:
    """Seed and options of an episode of the file, as numpy has them: what starts it again."""
    data, episode = selection.dataset, selection.episode(i)
    options: dict[str, Any] = {
        "task": data.tasks.names[int(data.episodes.task[i])],
        "goal": episode.goal,
        "quality": quality_name(episode.quality),
        "progress": np.float32(episode.progress),
        "policy": episode.policy.hex(),
        "seed_key": np.array(episode.seed_key, np.uint32),
    }
    if selection.source_ids is not None:
        place = int(np.searchsorted(selection.ids, i))
        options["source"] = selection.source_ids[place]
    found = {f"options/{key}": value for key, value in options.items()}
    root = data.spec.get("seed")
    if isinstance(root, int) and episode.seed_key != UNKNOWN_SEED_KEY:
        found["seed"] = SeedKey(root, *episode.seed_key).env_seed()
    return found


def _check_links(path: Path, selection: Selection, run: Run) -> None:
    """A virtual dataset whose source is wrong reads as zeros; better to know it now."""
    with h5py.File(path, "r") as file:
        for number, i in enumerate(run.ids.tolist()):
            episode, group = selection.episode(i), file[f"episode_{number}"]
            for name in STEPS:
                if not np.array_equal(group[name][()], getattr(episode, name)):
                    raise DataError("links do not show the episodes", where=str(path),
                                    hint="export without --link")  # fmt: skip


def metadata_of(selection: Selection, run: Run, name: str) -> dict[str, Any]:
    data = selection.dataset
    env = describe_env(
        data.spec, data.family, run.task.name, data.definition
    )  # ours, whatever the file says
    family = data.contract()
    bound = {"observation": math.inf, "action": family.action_high}
    spaces = {
        f"{kind}_space": json.dumps({
            "type": "Box", "dtype": "float32", "shape": [size],
            "low": [-bound[kind]] * size, "high": [bound[kind]] * size,
        })
        for kind, size in (("observation", data.observation_size), ("action", data.action_size))
    }  # fmt: skip
    gym_name = safe(f"{data.family}-{run.task.name}")
    spec = EnvSpec(id=f"mpdt/{gym_name}-v0", entry_point=env["entry_point"], kwargs=env["kwargs"])
    needed = ("mpdt", *reversed(family.packages))
    low, high = run.task.references["random"].mean, run.task.references["expert"].mean
    return {
        "dataset_id": name,
        "total_episodes": len(run.ids),
        "total_steps": int(data.episodes.length[run.ids].sum()),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "minari_version": VERSION,
        **spaces,
        "env_spec": spec.to_json(),
        "requirements": [f"{p}=={data.packages[p]}" for p in needed if p in data.packages],
        "ref_min_score": None if math.isnan(low) else low,
        "ref_max_score": None if math.isnan(high) else high,
        "author": [],
        "author_email": [],
        "algorithm_name": quality_name(run.quality),
        "code_permalink": "",
        "description": f"{data.name} {data.version}, task {run.task.name}, {data.license}",
    }
