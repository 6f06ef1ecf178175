"""References in a file: one row of the task table, as cells and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np

from mpdt.data.reference import REFERENCE_POLICIES, Reference, References, Source
from mpdt.data.store.layout import REFERENCE_FIELDS
from mpdt.errors import FormatError, ShapeError


def reference_cells(references: References, action_size: int) -> dict[str, Any]:
    """One task's cells of the reference columns of `/tasks`, by column.

    Raises: ShapeError for a constant action of another size.
    """
    cells = {
        f"ref_{name}{suffix}": _cell(getattr(references[name], field))
        for name in REFERENCE_POLICIES
        for field, suffix, _ in REFERENCE_FIELDS
    }
    action = references.constant_action or (np.nan,) * action_size
    if len(action) != action_size:
        raise ShapeError("wrong constant action", where="ref_constant_action",
                         expected=f"{action_size} numbers", found=str(len(action)))  # fmt: skip
    return cells | {"ref_constant_action": action}


def references_of(values: Mapping[str, Any], row: int, where: str) -> References:
    """What `reference_cells` put into row `row` of the columns `values`.

    Raises: FormatError for a source of a reference that is none.
    """

    def reference(name: str) -> Reference:
        cells = {field: values[f"ref_{name}{end}"][row] for field, end, _ in REFERENCE_FIELDS}
        if cells["source"] not in get_args(Source):
            raise FormatError(f"/tasks/ref_{name}_source is no word of the format", where=where,
                              expected=", ".join(filter(None, get_args(Source))),
                              found=ascii(cells["source"])[:60])  # fmt: skip
        if np.isnan(cells["success"]):
            cells["success"] = None
        return Reference(**{field: _plain(cell) for field, cell in cells.items()})

    found = {name: reference(name) for name in REFERENCE_POLICIES}
    action = values["ref_constant_action"][row]
    chosen = tuple(float(number) for number in action) if np.isfinite(action).all() else ()
    return References({name: ref for name, ref in found.items() if ref.is_known}, chosen)


def _cell(value: Any) -> Any:
    return np.nan if value is None else value


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
