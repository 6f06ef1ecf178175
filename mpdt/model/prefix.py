"""What stands before the tokens: keys and values a soft prompt left behind, or adapters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor


@dataclass(frozen=True)
class PrefixCache:
    """Keys and values of soft prompts, per block (rows, key heads, l, head width).

    adapters (rows, L, 2, r, s): weights of a bottleneck behind every block (HDT), or None.
    """

    keys: tuple[Tensor, ...]
    values: tuple[Tensor, ...]
    length: int
    adapters: Tensor | None = None

    def repeat(self, times: int) -> PrefixCache:
        """Row i becomes rows i*times … (i+1)*times - 1. Gradients add up over the copies."""
        if times == 1:
            return self
        keys = tuple(k.repeat_interleave(times, dim=0) for k in self.keys)
        values = tuple(v.repeat_interleave(times, dim=0) for v in self.values)
        own = None if self.adapters is None else self.adapters.repeat_interleave(times, dim=0)
        return PrefixCache(keys, values, self.length, own)

    def select(self, rows: Tensor) -> PrefixCache:
        """The cache of the given rows, in that order; rows may repeat."""
        keys = tuple(k.index_select(0, rows) for k in self.keys)
        values = tuple(v.index_select(0, rows) for v in self.values)
        own = None if self.adapters is None else self.adapters.index_select(0, rows)
        return PrefixCache(keys, values, self.length, own)

    @classmethod
    def of_model_cache(cls, cache: Any) -> PrefixCache:
        """What a model wrote into a `DynamicCache`; gradients stay attached."""
        keys = tuple(layer.keys for layer in cache.layers)
        values = tuple(layer.values for layer in cache.layers)
        return cls(keys, values, int(keys[0].shape[2]))

    def as_model_cache(self) -> Any:
        """A `DynamicCache` over the same tensors. Growing it concatenates, and leaves them be."""
        from transformers import DynamicCache
        from transformers.cache_utils import DynamicLayer

        cache = DynamicCache()
        for keys, values in zip(self.keys, self.values, strict=True):
            layer = DynamicLayer()
            layer.keys, layer.values = keys, values
            layer.dtype, layer.device = keys.dtype, keys.device
            layer.is_initialized = True
            cache.layers.append(layer)
        return cache


NO_PREFIX = PrefixCache((), (), 0)
