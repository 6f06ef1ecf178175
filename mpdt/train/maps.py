"""Maps: soft prompts as numbers (l, s) to be drawn, and their colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

MAPS = 10  # task prompts drawn, as in the rebuttal
BLUE, WHITE, RED = ((33.0, 102.0, 172.0), (247.0, 247.0, 247.0), (178.0, 24.0, 43.0))


def prompt_maps(weights: Path) -> dict[str, npt.NDArray[np.float32]]:
    """P_c and the first P_k of a trained run by name, (l, s) each; none for prompts of other kinds.

    Raises: MissingFileError, FormatError.
    """
    from mpdt.model.weights import load_weights

    _, tensors = load_weights(weights, kind="mpdt")
    if "prompts.task_v" not in tensors:
        return {}
    parts = tensors["prompts.task_v"][:MAPS] @ tensors["prompts.task_u"][:MAPS]
    maps = {"P_c": tensors["prompts.cross"]} | {f"P_{k}": part for k, part in enumerate(parts)}
    return {name: values.float().numpy() for name, values in maps.items()}


def map_pixels(values: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """(l, s) numbers as (l, s, 3) colours: blue below zero, white at it, red above.

    The scale ends at the 99th percentile of the absolute values.
    """
    size = float(np.quantile(np.abs(values), 0.99)) or 1.0
    share = np.clip(np.nan_to_num(values / size), -1, 1)[..., None]
    end = np.where(share > 0, RED, BLUE)
    pixels: npt.NDArray[np.uint8] = (WHITE + np.abs(share) * (end - WHITE)).round().astype(np.uint8)
    return pixels
