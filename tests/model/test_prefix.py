from __future__ import annotations

import torch

from mpdt.model.prefix import NO_PREFIX, PrefixCache


def test_rows_repeat_next_to_each_other_and_can_be_chosen() -> None:
    """Two rows, one block, one head, one position, width one: keys 1 and 2, values 3 and 4."""
    keys = torch.tensor([1.0, 2.0]).reshape(2, 1, 1, 1).requires_grad_()
    cache = PrefixCache((keys,), (torch.tensor([3.0, 4.0]).reshape(2, 1, 1, 1),), 1)
    twice = cache.repeat(2)
    assert twice.keys[0].flatten().tolist() == [1, 1, 2, 2]
    assert twice.values[0].flatten().tolist() == [3, 3, 4, 4]
    assert cache.select(torch.tensor([1, 0, 1])).values[0].flatten().tolist() == [4, 3, 4]
    twice.keys[0].sum().backward()
    assert keys.grad is not None and keys.grad.flatten().tolist() == [2, 2]
    assert cache.repeat(1) is cache and NO_PREFIX.repeat(3).length == 0


def test_growing_a_model_cache_leaves_the_prefix() -> None:
    keys = torch.ones(1, 1, 2, 4)
    prefix = PrefixCache((keys,), (keys,), 2)
    grown, _ = prefix.as_model_cache().update(2 * keys, 2 * keys, 0)
    assert grown[0, 0, :, 0].tolist() == [1, 1, 2, 2]
    assert prefix.keys[0].shape[2] == 2
    assert PrefixCache.of_model_cache(prefix.as_model_cache()) == prefix
