"""From facts and tensors that were read to a policy that acts; what does not fit is an error.

Sizes are compared with the tensors that were read before memory is asked for; the blocks are
built without any.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mpdt.data.spec.tasks import Family
from mpdt.errors import BackboneError, FormatError
from mpdt.model.backbone import Backbone, load_backbone
from mpdt.model.light import light_model
from mpdt.model.policy import PromptPolicy
from mpdt.model.returns import ReturnTable
from mpdt.model.weights import check_shapes
from mpdt.train.bundle.format import (
    ACTING,
    BACKBONE,
    IN_CONFIG,
    OWN,
    POLICY,
    TRAINED,
    BundleConfig,
    Contents,
    Returns,
)

_TRAINED = {
    "cross": "ls", "task_v": "Nlr", "task_u": "Nrs", "parts": "Nls",
    "layers": "Ls", "net.0.weight": "s", "net.0.bias": "s", "net.1.weight": "ss",
    "net.1.bias": "s", "net.3.weight": "qs", "net.3.bias": "q",
}  # fmt: skip
"""Axes of what training changes of prompts: N own tasks, l rows, width s, rank r, L blocks."""


@dataclass(frozen=True)
class Bundle:
    """A bundle in memory; nothing on the disk is needed any more.

    Attributes:
        prompts: per set (n, l, s), in the order of its tasks.
        trained: tensors that training changed of the prompts.
    """

    config: BundleConfig
    family: Family
    policy: PromptPolicy
    prompts: Mapping[str, Tensor]
    trained: Mapping[str, Tensor]

    def returns(self, name: str) -> ReturnTable:
        """What is asked of the tasks of a set."""
        return table_of(next(one for one in self.config.prompts if one.name == name).returns)


def built(contents: Contents, family: Family) -> Bundle:
    """The policy of these contents. Raises: MpdtError for what does not fit each other."""
    config, tensors = contents.config, contents.tensors
    parts = {
        start: {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}
        for start in (TRAINED, ACTING, POLICY, BACKBONE)
    }
    known = sum(len(part) for part in parts.values())
    if known != len(tensors):
        raise FormatError("tensors of no part of a policy", found=str(len(tensors) - known))
    policy = _policy(config, parts[POLICY], _backbone(config, parts[BACKBONE]))
    _check_prompts(config, policy, parts[ACTING])
    _check_trained(config, policy, parts)
    return Bundle(config, family, policy, parts[ACTING], parts[TRAINED])


def _backbone(config: BundleConfig, parts: Mapping[str, Tensor]) -> Backbone:
    facts, dtype = config.backbone, getattr(torch, config.backbone.dtype)
    if facts.shape is None:
        if parts:
            raise FormatError(
                "blocks of a language model that were left out", found=str(len(parts))
            )
        backbone = load_backbone(facts.name, facts.depth, facts.dtype, facts.seed)
        if backbone.fingerprint != facts.fingerprint:
            raise BackboneError(
                "the language model of that name is another one", where=facts.name,
                expected=f"weights {facts.fingerprint[:12]} {facts.revision}".strip(),
                found=backbone.fingerprint[:12], hint="take a bundle that holds its blocks",
            )  # fmt: skip
        backbone.drop_words()
    else:
        blocks = {name.split(".")[1] for name in parts if name.split(".")[0] in ("h", "layers")}
        if len(blocks) != facts.shape.num_hidden_layers:
            raise FormatError("blocks of the language model",
                              expected=str(facts.shape.num_hidden_layers),
                              found=str(len(blocks)))  # fmt: skip
        for name, tensor in parts.items():
            # Frequencies lose their meaning in bfloat16.
            wanted = torch.float32 if name.endswith("inv_freq") else dtype
            if tensor.dtype != wanted:
                raise FormatError(f"tensor 'backbone.{name}'", expected=str(wanted),
                                  found=str(tensor.dtype))  # fmt: skip
        model = light_model(facts.shape, parts)
        # Marked as in training: torch multiplies by weights that may be trained in another way,
        # and rounds otherwise.
        backbone = Backbone(
            facts.name, model, dtype, frozen=facts.trained != "all", whole=facts.fingerprint
        )
    backbone.reads_adapters = config.reads_adapters
    return backbone


def _policy(
    config: BundleConfig, state: Mapping[str, Tensor], backbone: Backbone
) -> PromptPolicy:  # fmt: skip
    mean, std = (
        np.array(column, np.float32) for column in (config.statistics.mean, config.statistics.std)
    )
    _check_sizes(config, state)
    policy = PromptPolicy(
        backbone, config.inputs, config.head, mean, std, config.family.action_size
    )
    own = {
        name: tuple(value.shape)
        for name, value in policy.own_state().items()
        if name not in IN_CONFIG and not name.startswith("backbone.")
    }
    check_shapes(own, state, "policy")
    _check_float32(state)
    policy.load_state_dict(dict(state), strict=False, assign=True)
    return policy


def _check_sizes(config: BundleConfig, state: Mapping[str, Tensor]) -> None:
    """Of what would be made before its tensors are looked at. Raises: FormatError."""
    time, hidden = state.get("inputs.time"), config.head.hidden or 0
    rows = 0 if time is None or time.dim() != 2 else len(time)
    if rows != config.inputs.time_table:
        raise FormatError("rows of the time table", expected=str(config.inputs.time_table),
                          found=str(rows))  # fmt: skip
    sizes = {size for name, value in state.items() if name.startswith("head.")
             for size in value.shape}  # fmt: skip
    if hidden and hidden not in sizes:
        raise FormatError("width of the head", expected=str(hidden), found=str(sorted(sizes)))


def _check_prompts(
    config: BundleConfig, policy: PromptPolicy, prompts: Mapping[str, Tensor]
) -> None:
    _check_float32(prompts)
    width, backbone = policy.backbone.width, policy.backbone
    shapes = {}
    for one in config.prompts:
        found = prompts.get(one.name)
        length = found.shape[1] if found is not None and found.dim() == 3 else 0
        shapes[one.name] = (len(one.tasks), length, width)
        if not config.reads_adapters:
            tokens = config.window * config.inputs.tokens_per_step
            backbone.check_room(length, tokens)
        elif length % (2 * backbone.num_layers):
            raise FormatError(f"adapters '{one.name}' for another number of blocks")
    check_shapes(shapes, prompts, "prompts")


def _check_trained(
    config: BundleConfig, policy: PromptPolicy, parts: Mapping[str, Mapping[str, Tensor]]
) -> None:
    """Whoever begins from this policy copies them row by row. Raises: FormatError, ShapeError."""
    own = next((len(one.tasks) for one in config.prompts if one.name == OWN), 0)
    sizes = {"N": own, "L": policy.backbone.num_layers, "s": policy.backbone.width}
    acting = parts[ACTING].get(OWN)
    if acting is not None and not config.reads_adapters:
        sizes["l"] = acting.shape[1]
    inputs = policy.own_state()
    shapes: dict[str, tuple[int, ...]] = {}
    _check_float32(parts[TRAINED])
    for name, tensor in parts[TRAINED].items():
        if name in inputs and name.startswith("inputs."):  # of demonstrations
            shapes[name] = tuple(inputs[name].shape)
        elif name in _TRAINED and len(_TRAINED[name]) == tensor.dim():
            letters = zip(_TRAINED[name], tensor.shape, strict=True)
            shapes[name] = tuple(sizes.setdefault(letter, size) for letter, size in letters)
    check_shapes(shapes, parts[TRAINED], "trained prompts")


def _check_float32(tensors: Mapping[str, Tensor]) -> None:
    for name, tensor in tensors.items():
        if tensor.dtype != torch.float32:
            raise FormatError(f"tensor '{name}'", expected="float32", found=str(tensor.dtype))


def table_of(returns: Returns) -> ReturnTable:
    """Numbers as a table. Raises: DataError for a range or a scale that is none."""
    columns = (getattr(returns, field) for field in Returns.__struct_fields__)
    return ReturnTable(*(torch.tensor(column, dtype=torch.float32) for column in columns))
