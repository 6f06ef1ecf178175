"""Checkpoint of a run: everything to go on from, as one file of tensors with a JSON header.

    checkpoint.safetensors    policy/...   optimizer/<parameter>/...   observations/...  returns/...
      of SAC as well          entropy   replay/...   rows/episodes     an optimizer each for three
    header                    `Progress`: counters, learning curve, whose run it is

stable-baselines3 keeps its state as pickles, and whoever loads a pickle runs what is in it. So
none of its loaders is ever called: the model is built anew and these numbers are put into it.
Used by pretrain.py, sac.py and snapshots.py.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from mpdt.disk import disk, write_bytes
from mpdt.errors import FormatError

FORMAT = "mpdt-pretrain/1"
NAME = "checkpoint.safetensors"
PICKLES = ("checkpoint.zip", "normalize.pkl")
"""What versions before this one left; nothing opens them."""

Arrays = dict[str, NDArray[Any]]
_MOMENTS = ("exp_avg", "exp_avg_sq")  # of Adam, each of its parameter's shape
_STATISTICS = {"observations": "obs_rms", "returns": "ret_rms"}
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class Point(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The learning curve at one snapshot; no mean return before the first episode has ended."""

    step: int
    mean_return: float | None
    wall_s: float


class Progress(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The header of a checkpoint.

    Args:
        run: what the run was started with; another one cannot go on from here.
        num_timesteps: environment steps done.
        updates: passes over the data so far.
        episodes: return and length of the latest episodes, whose mean is shown.
    """

    run: dict[str, Any]
    num_timesteps: int
    updates: int
    episodes: list[tuple[float, int]]
    curve: list[Point]
    format: str = FORMAT


def save_checkpoint(work: Path, model: Any, run: dict[str, Any], curve: list[Point]) -> None:
    """Atomic. Raises: StorageError."""
    progress = Progress(
        run=run,
        num_timesteps=int(model.num_timesteps),
        updates=int(model._n_updates),
        episodes=[(float(info["r"]), int(info["l"])) for info in model.ep_info_buffer],
        curve=curve,
    )
    header = {"mpdt": msgspec.json.encode(progress).decode()}
    write_bytes(work / NAME, save(_arrays(model), header))


def load_checkpoint(work: Path, run: dict[str, Any]) -> tuple[Progress, Arrays] | None:
    """The checkpoint in `work`, or None where there is none.

    Raises: FormatError for a file that is no checkpoint, is one of another run, or was left by
        a version that kept pickles; StorageError.
    """
    with disk(work):
        old = [name for name in PICKLES if (work / name).exists()]
        there = (work / NAME).exists()
    if old:
        raise _unusable(work / old[0], "a checkpoint of an earlier version, which is never loaded",
                        found="a pickle, which could run code")  # fmt: skip
    if not there:
        return None
    path = work / NAME
    with disk(path):
        try:
            with safe_open(path, framework="np") as file:
                text = (file.metadata() or {}).get("mpdt", "")
                arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            progress = msgspec.json.decode(text, type=Progress)
        except (SafetensorError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise _unusable(path, "not a checkpoint", found=str(error)[:160]) from error
    if progress.format != FORMAT or not progress.curve:
        raise _unusable(path, "not a checkpoint", found=f"format {progress.format[:40]!r}")
    for key in run.keys() | progress.run.keys():
        if run.get(key) != progress.run.get(key):
            raise _unusable(path, "the checkpoint of another run", expected=f"{key} {run.get(key)}",
                            found=str(progress.run.get(key))[:80])  # fmt: skip
    return progress, arrays


def restore(model: Any, progress: Progress, arrays: Arrays, path: Path) -> None:
    """Put the state into `model`, just built with the same settings, and its env.

    Raises: FormatError unless there is exactly what the model has, in its shapes, all finite.
    """
    import torch

    if _is_sac(model):
        _set_place(model.replay_buffer, arrays, path)
    wanted, found = _shapes(_arrays(model, moments=bool(progress.updates))), _shapes(arrays)
    for name in sorted(wanted.keys() | found.keys()):
        if wanted.get(name) != found.get(name):
            raise _unusable(path, f"other tensors than this network has: {name[:80]}",
                            expected=wanted.get(name, "nothing"),
                            found=found.get(name, "nothing"))  # fmt: skip
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise _unusable(path, f"numbers that are not finite: {name}")
    policy = model.policy
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    policy.load_state_dict({name: tensors[f"policy/{name}"] for name in policy.state_dict()})
    for word, (parameters, optimizer) in _optimizers(model).items():
        state = {
            i: {name: tensors[f"{word}/{i}/{name}"] for name in ("step", *_MOMENTS)}
            for i in range(len(parameters))
            if progress.updates
        }
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": state, "param_groups": groups})
    if _is_sac(model):
        _restore_experience(model, arrays)
        if "entropy" in tensors:
            model.log_ent_coef.data.copy_(tensors["entropy"])
    for name, attribute in _STATISTICS.items():
        statistics = getattr(model.get_env(), attribute)
        statistics.mean, statistics.var = arrays[f"{name}/mean"], arrays[f"{name}/var"]
        statistics.count = float(arrays[f"{name}/count"])
    model.num_timesteps, model._n_updates = progress.num_timesteps, progress.updates
    episodes = [{"r": r, "l": length} for r, length in progress.episodes]
    model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # no task here has success


def _arrays(model: Any, moments: bool = False) -> Arrays:
    """State of policy, optimizers and running statistics; `moments`: where none are yet, zeros."""
    found: Arrays = {
        f"policy/{name}": value.detach().numpy()
        for name, value in model.policy.state_dict().items()
    }
    for word, (parameters, optimizer) in _optimizers(model).items():
        state = optimizer.state_dict()["state"]
        for i, parameter in enumerate(parameters):
            empty = np.zeros(tuple(parameter.shape), np.float32)
            own = {name: value.numpy() for name, value in state.get(i, {}).items()}
            if not own and moments:
                own = {"step": np.zeros((), np.float32)} | dict.fromkeys(_MOMENTS, empty)
            found |= {f"{word}/{i}/{name}": value for name, value in own.items()}
    for name, attribute in _STATISTICS.items():
        statistics = getattr(model.get_env(), attribute)
        for field in ("mean", "var", "count"):
            found[f"{name}/{field}"] = np.asarray(getattr(statistics, field), np.float64)
    return found | _experience(model) if _is_sac(model) else found


def _is_sac(model: Any) -> bool:
    return hasattr(model, "replay_buffer")


def _optimizers(model: Any) -> dict[str, tuple[list[Any], Any]]:
    """Parameters and their optimizer, by the word that its tensors' names begin with."""
    policy = model.policy
    if not _is_sac(model):
        return {"optimizer": (list(policy.parameters()), policy.optimizer)}
    found = {
        f"optimizer/{name}": (list(part.parameters()), part.optimizer)
        for name, part in (("actor", policy.actor), ("critic", policy.critic))
    }
    if model.ent_coef_optimizer is not None:
        found["optimizer/entropy"] = ([model.log_ent_coef], model.ent_coef_optimizer)
    return found


def _experience(model: Any) -> Arrays:
    """Of SAC: what it has seen, how many episodes its rows have begun, the weight of entropy."""
    buffer = model.replay_buffer
    found: Arrays = {f"replay/{name}": getattr(buffer, name)[: buffer.size()] for name in _REPLAY}
    found["replay/place"] = np.array([buffer.pos, buffer.full], np.int64)
    found["rows/episodes"] = model.get_env().venv.episodes
    if model.log_ent_coef is not None:
        found["entropy"] = model.log_ent_coef.detach().numpy()
    return found


def _set_place(buffer: Any, arrays: Arrays, path: Path) -> None:
    """Where the next transition goes; with it the shapes of what is kept are known."""
    place = arrays.get("replay/place", np.zeros(0))
    sound = place.shape == (2,) and place.dtype == np.int64
    if not (sound and 0 <= place[0] < buffer.buffer_size and place[1] in (0, 1)):
        raise _unusable(path, "no place in the replay buffer", found=str(place.tolist())[:80])
    buffer.pos, buffer.full = int(place[0]), bool(place[1])


def _restore_experience(model: Any, arrays: Arrays) -> None:
    buffer = model.replay_buffer
    for name in _REPLAY:
        getattr(buffer, name)[: buffer.size()] = arrays[f"replay/{name}"]
    model.get_env().venv.episodes = np.maximum(arrays["rows/episodes"], 0)


def _shapes(arrays: Arrays) -> dict[str, str]:
    return {name: f"{array.shape} {array.dtype}" for name, array in arrays.items()}


def _unusable(path: Path, what: str, **said: str) -> FormatError:
    hint = "begin anew: the same command with --no-resume"
    return FormatError(what, where=str(path), hint=hint, **said)
