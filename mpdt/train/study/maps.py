"""Maps: soft prompts as numbers (l, s) to be drawn, their colours, and what a study keeps of them.

runs/STUDY/CELL/weights.safetensors  ──>  results/STUDY/CELL.prompts.safetensors  ──>  maps
                                          (P_c and the first P_k alone, float16, about 50 KB)
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from torch import Tensor

    from mpdt.model.weights import WeightsHeader

MAPS = 10  # task prompts drawn, as in the rebuttal
KEPT = ".prompts.safetensors"
NAMES = ("prompts.cross", "prompts.task_v", "prompts.task_u")
SHADES = 8
BLUE, WHITE, RED = ((33.0, 102.0, 172.0), (247.0, 247.0, 247.0), (178.0, 24.0, 43.0))


def prompt_maps(weights: Path, run: str = "") -> dict[str, npt.NDArray[np.float32]]:
    """P_c and the first P_k of a trained run by name, (l, s) each; none for prompts of other kinds.

    Args:
        weights: of a run, or as `keep_prompts` wrote them.
        run: hash of the training they have to be of; "" = any.
    Raises: MissingFileError, FormatError.
    """
    _, tensors = _task_prompts(weights, run)
    if not tensors:
        return {}
    cross, v, u = (tensors[name].float() for name in NAMES)
    maps = {"P_c": cross} | {f"P_{k}": part for k, part in enumerate(v @ u)}
    return {name: values.numpy() for name, values in maps.items()}


def keep_prompts(weights: Path, path: Path) -> bool:
    """Write what `prompt_maps` draws to a small file; False, and no file, if there are none.

    Raises: MissingFileError, FormatError, StorageError.
    """
    from mpdt.model.weights import WeightsHeader, save_weights

    header, tensors = _task_prompts(weights)
    if tensors:
        halves = {name: tensor.half() for name, tensor in tensors.items()}
        save_weights(path, halves, WeightsHeader(kind="prompts", hashes=header.hashes))
    return bool(tensors)


def _task_prompts(weights: Path, run: str = "") -> tuple[WeightsHeader, dict[str, Tensor]]:
    """Header; `NAMES`, of the first tasks, or nothing where prompts are of another kind."""
    from mpdt.model.weights import load_weights

    header, tensors = load_weights(weights, hashes={"run": run} if run else None)
    if not set(NAMES) <= set(tensors):
        return header, {}
    cross, v, u = (tensors[name] for name in NAMES)
    return header, dict(zip(NAMES, (cross, v[:MAPS], u[:MAPS]), strict=True))


def map_pixels(values: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """(l, s) numbers as (l, s, 3) colours: blue below zero, white at it, red above.

    The scale ends at the 99th percentile of the absolute values, in `SHADES` to both sides: noise
    does not compress, and more of them cannot be told apart.
    """
    size = float(np.quantile(np.abs(values), 0.99)) or 1.0
    share = (np.clip(np.nan_to_num(values / size), -1, 1) * SHADES).round()[..., None] / SHADES
    end = np.where(share > 0, RED, BLUE)
    pixels: npt.NDArray[np.uint8] = (WHITE + np.abs(share) * (end - WHITE)).round().astype(np.uint8)
    return pixels
