"""YAML text without its traps: numbers are numbers, words are words, no key twice.

Stock PyYAML follows YAML 1.1: `1e-4` is text, `on` and `no` are booleans, `0755` is octal,
`12:30` is 750, and of a repeated key the last one silently wins. Here the core schema of YAML
1.2 holds, and a repeated key is an error; so are aliases.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from mpdt.errors import SpecError

MAX_NESTING = 20


class _Loader(yaml.SafeLoader):
    """SafeLoader with the scalars of YAML 1.2; collects repeated keys instead of losing them.

    Aliases, with which half a kilobyte says a billion values, and deep nesting are refused.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.repeated: list[tuple[str, int]] = []
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        self._depth += 1
        refused = ""
        if getattr(event, "anchor", None) is not None:
            refused = "anchors and aliases (& and *) are not read: write the value out"
        elif self._depth > MAX_NESTING:
            refused = f"nested deeper than {MAX_NESTING}"
        if refused:
            raise yaml.composer.ComposerError(None, None, refused, event.start_mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_scalar(self, node: Any) -> Any:
        value = super().construct_scalar(node)
        if isinstance(value, str) and any("\ud800" <= char <= "\udfff" for char in value):
            raise yaml.constructor.ConstructorError(
                None, None, "half of a character that takes two", node.start_mark
            )
        return value

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        if isinstance(node, yaml.MappingNode):
            seen = set()
            for key_node, _ in node.value:
                key = getattr(key_node, "value", None)
                if isinstance(key, str) and key in seen:
                    self.repeated.append((key, key_node.start_mark.line + 1))
                if isinstance(key, str):
                    seen.add(key)
        return super().construct_mapping(node, deep)


# A table of its own: that of SafeLoader is shared by the whole process.
_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", "~nN\0"),
    ("int", r"[-+]?(0|[1-9][0-9]*)", "-+0123456789"),
    ("float", r"[-+]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", "-+."),
):
    _letters = ["" if letter == "\0" else letter for letter in _first]
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), _letters
    )


def load_yaml(text: str, where: str) -> Any:
    """The value of one YAML document: dicts, lists, text, numbers, booleans, None.

    Raises: SpecError for text that is not YAML, Python tags, and repeated keys (all of them,
        with line numbers).
    """
    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        value = loader.get_single_data()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{where}, line {mark.line + 1}" if mark else where
        problem = getattr(error, "problem", None) or str(error).partition("\n")[0]
        raise SpecError(f"not valid YAML: {problem}", where=place) from error
    except (ValueError, OverflowError) as error:  # a number of thousands of digits, a date
        raise SpecError(f"not valid YAML: {error}", where=where) from error
    finally:
        if loader is not None:
            loader.dispose()
    if loader.repeated:
        found = ", ".join(f"'{key}' in line {line}" for key, line in loader.repeated)
        raise SpecError("repeated key", where=where, found=found,
                        hint="YAML would keep the last one and drop the others")  # fmt: skip
    return value


class _Dumper(yaml.SafeDumper):
    """Quotes exactly the text that `_Loader` would read as something else, such as `12e34`."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers


def dump_yaml(value: Any) -> str:
    """YAML text with one form per value: keys sorted, blocks outside, `{a: 1}` for the last level.

    `load_yaml` reads the same value back (tuples as lists).
    """
    text: str = yaml.dump(
        value, Dumper=_Dumper, sort_keys=True, default_flow_style=None, width=100,
        allow_unicode=True,
    )  # fmt: skip
    return text
