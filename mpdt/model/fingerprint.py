"""Fingerprint of a trained policy: what acts the same has the same, in memory or out of a file."""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from torch import Tensor

from mpdt.model.policy import PromptPolicy
from mpdt.model.returns import ReturnTable

_RETURNS = ("scale", "low", "high", "target")


@torch.no_grad()
def fingerprint(policy: PromptPolicy, prompts: Tensor, returns: ReturnTable, window: int) -> bytes:
    """SHA-256 (32 bytes) over the language model's fingerprint and all trained numbers.

    Args:
        prompts: (n, l, s), one per task.
        returns: n rows.
    """
    backbone = policy.backbone
    state = hashlib.sha256(
        f"window {window}, {backbone.num_layers} blocks of {backbone.fingerprint}, "
        f"{backbone.dtype}, {policy.inputs.settings}, {policy.head}\n".encode()
    )
    parts = {f"policy.{name}": value for name, value in policy.own_state().items()}
    parts |= {f"returns.{name}": getattr(returns, name) for name in _RETURNS}
    for name, tensor in sorted({**parts, "prompts": prompts}.items()):
        array = np.ascontiguousarray(tensor.detach().cpu().float().numpy())
        state.update(f"{name} {array.shape}\n".encode())
        state.update(array.tobytes())
    return state.digest()
