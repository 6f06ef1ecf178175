"""What a file says of one's own family, so that it can be read where the family is not."""

from __future__ import annotations

from typing import Any

from mpdt.data.spec.family import stored_family
from mpdt.data.spec.rules import plain_problems
from mpdt.data.store import layout
from mpdt.data.store.tree import Tree
from mpdt.errors import FormatError

NAME = "definition"


def read_definition(tree: Tree) -> dict[str, Any]:
    """Empty for a family that mpdt ships. Nothing of it is imported.

    Raises: FormatError for what `spec.family.definition` does not write.
    """
    if NAME not in tree.attributes("") and NAME not in tree.arrays:
        return {}
    found = tree.json("", NAME)
    try:
        problems = plain_problems(stored_family(found))
    except ValueError as error:
        problems = [str(error)]
    if problems:
        raise FormatError("its definition of the family is not as the format has it",
                          where=tree.where, found=problems[0][:160],
                          hint=layout.FOREIGN_HINT)  # fmt: skip
    return found
