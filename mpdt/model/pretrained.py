"""Published weights into a model: all of them, or one error that says what does not fit.

The library fills what it does not find with random numbers, other ones at every load, and says
so in a report that nobody reads. Here a tensor that is missing, unknown or misshapen is the end;
only heads, which are never used, and blocks behind the chosen depth may be left out.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import torch

from mpdt.errors import BackboneError

_HEADS = ("lm_head.", "score.", "classifier.", "qa_outputs.", "multiple_choice_head.")
_BLOCK = re.compile(r"(?:^|\.)(?:h|layers)\.(\d+)\.")
_MOST_TEXT = 2**24  # bytes of a configuration or an index; published ones have thousands


def load_whole(source: str | None, config: Any, blocks: int, where: str, **how: Any) -> Any:
    """The model without head, float32, every number of it from the weights. Runs no code of theirs.

    Args:
        source: folder or hub id; None with `state_dict` in `how`.
        blocks: how many the weights have; the configuration may keep fewer.
        how: what else `from_pretrained` takes.
    Raises: BackboneError for tensors that do not fit; whatever the library raises.
    """
    from transformers import MODEL_MAPPING

    options = {"dtype": torch.float32, "trust_remote_code": False, "use_safetensors": True, **how}
    # Misshapen ones are listed instead of being raised without their names.
    model, found = MODEL_MAPPING[type(config)].from_pretrained(
        source, config=config, output_loading_info=True, ignore_mismatched_sizes=True, **options
    )
    kept = int(config.num_hidden_layers)
    unknown = sorted(
        name for name in found["unexpected_keys"] if not _may_be_left_out(name, kept, blocks)
    )
    for name, stored, wanted in sorted(found["mismatched_keys"]):
        raise _misfit(where, name, str(tuple(wanted)), str(tuple(stored)))
    for name in sorted(found["missing_keys"]):
        raise _misfit(where, name, "in the weights", _instead(unknown))
    for name in unknown:
        raise _misfit(where, name, "no such tensor", "in the weights")
    for message in found["error_msgs"]:
        raise BackboneError("cannot read this language model", where=where, found=str(message))
    return model


def check_declared(folder: Path, config: Any, where: str) -> None:
    """Compare what a configuration says with the bytes that are there, before it is believed.

    Raises: BackboneError for weights that are missing, or smaller than the matrices they hold.
    """
    stored = sum(file.stat().st_size for file in folder.glob("*.safetensors") if file.is_file())
    width, inner = int(config.hidden_size), getattr(config, "intermediate_size", None)
    matrices = int(config.num_hidden_layers) * max(width, int(inner or width))
    # A number takes a byte at least, and every block has such a matrix.
    least = width * max(int(config.vocab_size), matrices)
    if stored < least:
        raise BackboneError(
            "the weights are smaller than the configuration says", where=where,
            expected=f"at least {least:,} bytes of safetensors", found=f"{stored:,}",
            hint="copy the folder again, with its model.safetensors",
        )  # fmt: skip


def check_text(folder: Path, where: str) -> None:
    """Raises: BackboneError for a configuration or an index too large to be one."""
    for file in folder.glob("*.json"):
        if file.is_file() and file.stat().st_size > _MOST_TEXT:
            raise BackboneError(f"{file.name} is too large", where=where,
                                expected=f"at most {_MOST_TEXT:,} bytes",
                                found=f"{file.stat().st_size:,}")  # fmt: skip


def _may_be_left_out(name: str, kept: int, blocks: int) -> bool:
    block = _BLOCK.search(name)
    cut = block is not None and kept <= int(block[1]) < blocks
    return cut or name.startswith(_HEADS)


def _instead(unknown: list[str]) -> str:
    return f"'{unknown[0]}' and {len(unknown) - 1} more" if unknown else "nothing"


def _misfit(where: str, name: str, expected: str, found: str) -> BackboneError:
    hint = "save the model whole, with save_pretrained, or take another one"
    if "_orig_mod." in found or "_orig_mod." in name:
        hint = "this was saved from a compiled model: save its `_orig_mod` with save_pretrained"
    return BackboneError(f"tensor '{name}' does not fit this language model", where=where,
                         expected=expected, found=found, hint=hint)  # fmt: skip
