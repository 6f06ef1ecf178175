"""From plain values to typed structs, with every mistake named by its full key."""

from __future__ import annotations

import types
import typing
from typing import Any

import msgspec

from mpdt.data.spec.entry import Problem
from mpdt.errors import nearest


def build(kind: type[Any], value: Any, key: str, problems: list[Problem]) -> Any:
    """`value` as `kind`, a msgspec struct; mistakes go into `problems` and None comes back."""
    before = len(problems)
    fields = collect(kind, value, key, problems)
    return kind(**fields) if len(problems) == before else None


def collect(kind: type[Any], value: Any, key: str, problems: list[Problem]) -> dict[str, Any]:
    """The good fields of `value`; mistakes go into `problems`.

    Unlike msgspec itself, which stops at the first mistake, it looks at every field.
    """
    if not isinstance(value, dict):
        problems.append((key, f"expected a block of keys, found {_show(value)}", ""))
        return {}
    hints = typing.get_type_hints(kind)
    allowed = kind.__struct_fields__
    fields: dict[str, Any] = {}
    for name, item in value.items():
        path, before = f"{key}.{name}" if key else str(name), len(problems)
        if name not in allowed:
            what = f"unknown key '{name}' {nearest(str(name), allowed)}".rstrip()
            problems.append((key, what, f"allowed: {', '.join(allowed)}"))
            continue
        good = _field(hints[name], item, path, problems)
        if len(problems) == before:
            fields[name] = good
    for field in msgspec.structs.fields(kind):
        if field.required and field.name not in value:
            problems.append((key, f"missing key '{field.name}'", ""))
    return fields


def _field(hint: Any, value: Any, path: str, problems: list[Problem]) -> Any:
    if isinstance(hint, types.UnionType) and isinstance(value, dict):  # `Struct | None`
        hint = next((kind for kind in typing.get_args(hint) if _is_struct(kind)), hint)
    if _is_struct(hint):
        return build(hint, value, path, problems)
    if typing.get_origin(hint) is dict:
        if not isinstance(value, dict):
            problems.append((path, f"expected a block of keys, found {_show(value)}", ""))
            return None
        of = typing.get_args(hint)[1]
        items = ((str(name), item) for name, item in value.items())
        return {name: _field(of, item, f"{path}.{name}", problems) for name, item in items}
    try:
        return msgspec.convert(value, hint, strict=True)
    except msgspec.ValidationError:
        what = f"expected {_describe(hint)}, found {_show(value)}"
        problems.append((path, what, _trap(hint, value)))
        return None


def _is_struct(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, msgspec.Struct)


def _show(value: Any) -> str:
    names = {str: "text", bool: "boolean", int: "number", float: "number", list: "list"}
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a block of keys"
    return f"{names.get(type(value), type(value).__name__)} {value!r}"


def _describe(hint: Any) -> str:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return " or ".join(map(repr, args))
    if origin is typing.Union or origin is types.UnionType:
        return " or ".join(_describe(arg) for arg in args if arg is not msgspec.UnsetType)
    if origin is tuple:
        return f"a list of {_describe(args[0])}"
    names = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}
    names[type(None)] = "nothing"
    return names.get(hint, str(hint))


def _trap(hint: Any, value: Any) -> str:
    wanted = typing.get_args(hint) or (hint,)
    if str in wanted and isinstance(value, int | float):
        return f'put it in quotes: "{value}"'
    if bool in wanted and isinstance(value, str) and value.lower() in ("on", "off", "yes", "no"):
        return "write true or false"
    if int in wanted and isinstance(value, float) and value.is_integer():
        return f"write {int(value)}"
    return ""
