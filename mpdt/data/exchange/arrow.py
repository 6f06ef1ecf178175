"""numpy matrices as Arrow columns of vectors, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def column(array: NDArray[Any]) -> Any:
    """(N,) as plain values; (N, D) as `fixed_size_list[D]`, (N, 32) bytes as `binary[32]`."""
    if array.ndim == 1:
        return pa.array(array)
    rows, width = array.shape
    if array.dtype == np.uint8:
        buffers = [None, pa.py_buffer(np.ascontiguousarray(array))]
        return pa.FixedSizeBinaryArray.from_buffers(pa.binary(width), rows, buffers)
    values = pa.array(np.ascontiguousarray(array).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(values, width)


def array(table: Any, name: str, dtype: str) -> NDArray[Any]:
    """What `column` was made of.

    Raises: KeyError; ValueError for nulls or another type than `dtype`.
    """
    found = table.column(name).combine_chunks()
    if isinstance(found, pa.ChunkedArray):
        found = pa.concat_arrays(found.chunks) if found.num_chunks else pa.array([], found.type)
    if found.null_count:
        raise ValueError(f"column {name} has empty cells")
    if pa.types.is_fixed_size_binary(found.type):
        width = found.type.byte_width
        data = b"".join(found.to_pylist())
        return np.frombuffer(data, np.uint8).reshape(-1, width)
    width = 0
    if pa.types.is_fixed_size_list(found.type):
        width = found.type.list_size
        found = found.flatten()
        if found.null_count:
            raise ValueError(f"column {name} has empty cells")
    values: NDArray[Any] = found.to_numpy(zero_copy_only=False)
    if values.dtype != np.dtype(dtype):
        raise ValueError(f"column {name} is {found.type}, not {np.dtype(dtype)}")
    return values.reshape(-1, width) if width else values
