"""The blocks of a language model without the library they come from: all that acting needs.

Importing transformers takes longer than everything else a policy does before its first step. The
modules here carry the names that `blocks.py` reads and the parameter names of the library, and
do the same operations in the same order, so that both answer with the same bits.

    model of the library ── shape_of, parts_of ──> shape, tensors ── light_model ──> the same
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal

import msgspec
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mpdt.errors import BackboneError
from mpdt.model.weights import check_shapes

# Their table of angles is one for all lengths, so it can be carried as numbers.
_FIXED_ANGLES = ("default", "linear", "llama3", "yarn")


class ModelShape(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What of a model's configuration its blocks depend on; names as in the library."""

    model_type: Literal["gpt2", "llama"]
    hidden_size: int
    intermediate_size: int
    num_hidden_layers: int
    num_attention_heads: int
    num_key_value_heads: int
    head_dim: int
    max_position_embeddings: int
    epsilon: float
    """Of the norms."""
    activation: str
    scaling: tuple[float, ...]
    """Of the products of queries and keys, per block."""
    attention_bias: bool = True
    mlp_bias: bool = True
    angle_scaling: float = 1.0
    """Of cosines and sines."""


def shape_of(model: Any) -> ModelShape:
    """The shape of a GPT-2 or Llama of the library.

    Raises: BackboneError for one whose angles stretch with the length, or whose activation is not
        known here.
    """
    config = model.config
    gpt2 = config.model_type == "gpt2"
    activation = config.activation_function if gpt2 else config.hidden_act
    if activation not in _ACTIVATIONS:
        raise _not_carried(f"activation {activation}", ", ".join(_ACTIVATIONS))
    if not gpt2 and model.rotary_emb.rope_type not in _FIXED_ANGLES:
        raise _not_carried(f"angles of kind {model.rotary_emb.rope_type}", ", ".join(_FIXED_ANGLES))
    blocks = list(model.h if gpt2 else model.layers)
    own = [block.attn if gpt2 else block.self_attn for block in blocks]
    inner = blocks[0].mlp.c_fc.nf if gpt2 else config.intermediate_size
    heads = config.num_attention_heads
    return ModelShape(
        model_type=config.model_type,
        hidden_size=int(config.hidden_size),
        intermediate_size=int(inner),
        num_hidden_layers=len(blocks),
        num_attention_heads=int(heads),
        num_key_value_heads=int(heads if gpt2 else config.num_key_value_heads),
        head_dim=int(own[0].head_dim),
        max_position_embeddings=int(config.max_position_embeddings),
        epsilon=float(config.layer_norm_epsilon if gpt2 else config.rms_norm_eps),
        activation=str(activation),
        scaling=tuple(float(attention.scaling) for attention in own),
        attention_bias=gpt2 or bool(config.attention_bias),
        mlp_bias=gpt2 or bool(config.mlp_bias),
        angle_scaling=1.0 if gpt2 else float(model.rotary_emb.attention_scaling),
    )


def parts_of(model: Any, shape: ModelShape) -> dict[str, Tensor]:
    """The tensors a light model of that shape needs; trained additions are in them already."""
    tensors = {}
    for name in _empty(shape).state_dict():
        place, _, leaf = name.rpartition(".")
        # An attribute, not a parameter: what has an addition of low rank answers with the sum.
        tensors[name] = getattr(model.get_submodule(place), leaf).detach()
    return tensors


def light_model(shape: ModelShape, tensors: Mapping[str, Tensor]) -> nn.Module:
    """A model of that shape over these very tensors; nothing is copied.

    Raises: ShapeError for missing, unknown or misshapen tensors; BackboneError.
    """
    if shape.activation not in _ACTIVATIONS:
        raise _not_carried(f"activation {shape.activation}", ", ".join(_ACTIVATIONS))
    if len(shape.scaling) != shape.num_hidden_layers:
        raise _not_carried(f"{len(shape.scaling)} scalings", f"{shape.num_hidden_layers} blocks")
    model = _empty(shape)
    wanted = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    check_shapes(wanted, tensors, "language model")
    model.load_state_dict(dict(tensors), assign=True)
    return model.eval()


def _empty(shape: ModelShape) -> nn.Module:
    return _Gpt2(shape) if shape.model_type == "gpt2" else _Llama(shape)


def _not_carried(found: str, known: str) -> BackboneError:
    return BackboneError("the blocks of this language model cannot be carried",
                         where="language model", expected=known, found=found,
                         hint="leave the language model out: --without-backbone")  # fmt: skip


def _later(*sizes: int) -> nn.Parameter:
    """A shape without memory. torch's own layers fill theirs with numbers, or, where they have no
    memory either, import half a mathematics library to say that they would."""
    return nn.Parameter(torch.empty(sizes, device="meta"))


class _Linear(nn.Module):
    bias: nn.Parameter | None

    def __init__(self, wide: int, out: int, bias: bool) -> None:
        super().__init__()
        self.weight = _later(out, wide)
        self.register_parameter("bias", _later(out) if bias else None)

    def forward(self, x: Tensor) -> Tensor:
        return F.linear(x, self.weight, self.bias)


class _LayerNorm(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.weight, self.bias = _later(shape.hidden_size), _later(shape.hidden_size)
        self._epsilon = shape.epsilon

    def forward(self, x: Tensor) -> Tensor:
        return F.layer_norm(x, self.weight.shape, self.weight, self.bias, self._epsilon)


class _Positions(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.weight = _later(shape.max_position_embeddings, shape.hidden_size)

    def forward(self, positions: Tensor) -> Tensor:
        return F.embedding(positions, self.weight)


class _Llama(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.config = shape
        self.layers = nn.ModuleList(_LlamaBlock(shape, s) for s in shape.scaling)
        self.norm = _RootMeanSquare(shape)
        self.rotary_emb = _Angles(shape)

    def get_input_embeddings(self) -> None:
        """No words are looked up."""


class _LlamaBlock(nn.Module):
    def __init__(self, shape: ModelShape, scaling: float) -> None:
        super().__init__()
        self.self_attn = _LlamaAttention(shape, scaling)
        self.mlp = _GatedMlp(shape)
        self.input_layernorm = _RootMeanSquare(shape)
        self.post_attention_layernorm = _RootMeanSquare(shape)


class _LlamaAttention(nn.Module):
    """The projections; `blocks.attend` does the rest."""

    def __init__(self, shape: ModelShape, scaling: float) -> None:
        super().__init__()
        self.head_dim, self.scaling = shape.head_dim, scaling
        asking = shape.num_attention_heads * shape.head_dim
        asked, bias = shape.num_key_value_heads * shape.head_dim, shape.attention_bias
        self.q_proj = _Linear(shape.hidden_size, asking, bias)
        self.k_proj = _Linear(shape.hidden_size, asked, bias)
        self.v_proj = _Linear(shape.hidden_size, asked, bias)
        self.o_proj = _Linear(asking, shape.hidden_size, bias)


class _GatedMlp(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        width, inner, bias = shape.hidden_size, shape.intermediate_size, shape.mlp_bias
        self.gate_proj = _Linear(width, inner, bias)
        self.up_proj = _Linear(width, inner, bias)
        self.down_proj = _Linear(inner, width, bias)
        self._activation = _ACTIVATIONS[shape.activation]

    def forward(self, x: Tensor) -> Tensor:
        gated: Tensor = self.down_proj(self._activation(self.gate_proj(x)) * self.up_proj(x))
        return gated


class _RootMeanSquare(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.weight = _later(shape.hidden_size)
        self._epsilon = shape.epsilon

    def forward(self, x: Tensor) -> Tensor:
        wide = x.to(torch.float32)
        wide = wide * torch.rsqrt(wide.pow(2).mean(-1, keepdim=True) + self._epsilon)
        return self.weight * wide.to(x.dtype)


class _Angles(nn.Module):
    """Cosines and sines of positions; the frequencies are float32 whatever the weights are."""

    inv_freq: Tensor

    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.register_buffer("inv_freq", torch.empty(shape.head_dim // 2, device="meta"))
        self._scaling = shape.angle_scaling

    def forward(self, like: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
        angles = positions[..., None].float() * self.inv_freq
        angles = torch.cat([angles, angles], dim=-1)
        cos, sin = angles.cos() * self._scaling, angles.sin() * self._scaling
        return cos.to(like.dtype), sin.to(like.dtype)


class _Gpt2(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.config = shape
        self.wpe = _Positions(shape)
        self.h = nn.ModuleList(_Gpt2Block(shape, scaling) for scaling in shape.scaling)
        self.ln_f = _LayerNorm(shape)

    def get_input_embeddings(self) -> None:
        """No words are looked up."""


class _Gpt2Block(nn.Module):
    def __init__(self, shape: ModelShape, scaling: float) -> None:
        super().__init__()
        self.ln_1 = _LayerNorm(shape)
        self.attn = _Gpt2Attention(shape, scaling)
        self.ln_2 = _LayerNorm(shape)
        self.mlp = _Mlp(shape)


class _Gpt2Attention(nn.Module):
    """The projections; `blocks.attend` does the rest."""

    def __init__(self, shape: ModelShape, scaling: float) -> None:
        super().__init__()
        self.head_dim, self.scaling, self.split_size = shape.head_dim, scaling, shape.hidden_size
        self.c_attn = _Transposed(shape.hidden_size, 3 * shape.hidden_size)
        self.c_proj = _Transposed(shape.hidden_size, shape.hidden_size)


class _Mlp(nn.Module):
    def __init__(self, shape: ModelShape) -> None:
        super().__init__()
        self.c_fc = _Transposed(shape.hidden_size, shape.intermediate_size)
        self.c_proj = _Transposed(shape.intermediate_size, shape.hidden_size)
        self._activation = _ACTIVATIONS[shape.activation]

    def forward(self, x: Tensor) -> Tensor:
        changed: Tensor = self.c_proj(self._activation(self.c_fc(x)))
        return changed


class _Transposed(nn.Module):
    """A linear layer whose weight is (in, out), as GPT-2's are stored."""

    def __init__(self, wide: int, out: int) -> None:
        super().__init__()
        self.weight = _later(wide, out)
        self.bias = _later(out)

    def forward(self, x: Tensor) -> Tensor:
        flat = torch.addmm(self.bias, x.reshape(-1, x.shape[-1]), self.weight)
        return flat.view(*x.shape[:-1], flat.shape[-1])


def _gelu_new(x: Tensor) -> Tensor:
    """Written out as the library does: the fused one rounds differently."""
    return 0.5 * x * (1.0 + torch.tanh(math.sqrt(2.0 / math.pi) * (x + 0.044715 * x.pow(3.0))))


def _gelu_tanh(x: Tensor) -> Tensor:
    return F.gelu(x, approximate="tanh")


_ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "gelu": F.gelu, "gelu_new": _gelu_new, "gelu_pytorch_tanh": _gelu_tanh, "relu": F.relu,
    "silu": F.silu,
}  # fmt: skip
