"""Claims: what a source says of its episodes counts; whoever says otherwise is told of both.

in the file    attributes of HDF5, metadata.json, the manifest of an export of ours
in its name    where names of the format carry task and quality
--task, --quality, --license    what the sources do not say
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from mpdt.data.episode import QUALITY_CODES
from mpdt.data.exchange.treatment import Rules
from mpdt.data.spec.tasks import FAMILIES
from mpdt.data.store.licence import UNKNOWN
from mpdt.errors import DataError, quoted

_OPTIONS = {"family": "--family", "task": "--task", "quality": "--quality", "license": "--license"}


@dataclass(frozen=True)
class Said:
    """What is said of all episodes of a source: family, task, quality, license; "" = nothing.

    Args:
        by: who says it: `its attributes`, `its name`.
    """

    family: str = ""
    task: str = ""
    quality: str = ""
    license: str = ""
    by: str = ""
    others: tuple[Said, ...] = ()
    """Who else says something, the same."""

    @classmethod
    def of(cls, values: Mapping[str, Any], by: str) -> Said:
        """From texts under these names; whatever is no text says nothing."""
        found = {key: _text(values[key]) for key in _OPTIONS if key in values}
        return _said(found, by)

    def and_also(self, other: Said, where: str) -> Said:
        """Both together. Raises: DataError where they contradict each other."""
        found = {}
        for key in _OPTIONS:
            one, two = getattr(self, key), getattr(other, key)
            if one and two and one != two:
                raise DataError(f"the source says two things about its {key}", where=where,
                                found=f"{one} in {self.who(key)}, {two} in {other.who(key)}",
                                hint="ask whoever made it, and mend the one that is wrong"
                                )  # fmt: skip
            found[key] = one or two
        return _said(found, others=(self, other))

    def who(self, key: str) -> str:
        """Who says what is said under `key`."""
        told = [one.who(key) for one in self.others if getattr(one, key)]
        return " and ".join(told) or self.by

    def settled(self, rules: Rules, where: str) -> Said:
        """What holds of the source, with what `rules` say where it says nothing itself.

        `--quality unknown` takes a claim back and contradicts none.

        Raises: DataError naming both sides where they contradict each other.
        """
        given = {
            "family": rules.family.name,
            "task": rules.task or "",
            "quality": rules.quality or "",
            "license": "" if rules.license == UNKNOWN else rules.license,
        }
        for key, option in _OPTIONS.items():
            own, asked = getattr(self, key), given[key]
            if key == "quality" and asked == "unknown":
                continue
            if own not in ("", "unknown", UNKNOWN) and asked and own != asked:
                raise DataError(f"the source says another {key} than {option}", where=where,
                                expected=asked, found=f"{own} in {self.who(key)}",
                                hint=_hint(key, option, own))  # fmt: skip
        asked_for = _said(given, "the command line")
        if rules.quality == "unknown":
            return replace(self, quality="unknown").and_also(asked_for, where)
        known = {
            key: "" if (text := getattr(self, key)) in ("unknown", UNKNOWN) else text
            for key in _OPTIONS
        }
        return _said(known, self.by, self.others).and_also(asked_for, where)


def named(stem: str, by: str) -> Said:
    """What a name of the form `<family>-<task>-<quality>` says; nothing for another form."""
    head, _, quality = stem.rpartition("-")
    if quality in (*QUALITY_CODES, "unknown"):
        for family in FAMILIES.values():
            for task in family.tasks:
                if head == f"{family.name}-{task.name}":
                    return Said(family.name, task.name, quality, by=by)
    return Said()


def _said(texts: Mapping[str, str], by: str = "", others: tuple[Said, ...] = ()) -> Said:
    family, task, quality, licence = (texts.get(key, "") for key in _OPTIONS)
    return Said(family, task, quality, licence, by, others)


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""


def _hint(key: str, option: str, own: str) -> str:
    if key == "family":
        return (
            f"--family {quoted(own)}"
            if own in FAMILIES
            else "import it with the others of its kind"
        )
    return f"leave out {option}; if the source is wrong, mend it there"
