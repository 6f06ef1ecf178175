"""The smoke version of an entry: every part of a collection, in a minute."""

from __future__ import annotations

import msgspec

from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts


def smoke(spec: DatasetSpec) -> DatasetSpec:
    """A tiny version with the same tasks: a minute of work, another name and version."""
    most = 4 if len(spec.resolve_tasks()) <= 15 else 2

    def few(counts: EpisodeCounts) -> EpisodeCounts:
        fields = EpisodeCounts.__struct_fields__
        return EpisodeCounts(**{quality: min(counts.of(quality), most) for quality in fields})

    rules = {
        name: msgspec.structs.replace(rule, episodes=min(rule.episodes, 2))
        for name, rule in spec.tta.items()
    }
    mark = "." if "+" in spec.version else "+"
    return msgspec.structs.replace(
        spec, name=f"{spec.name}-smoke", version=f"{spec.version}{mark}smoke",
        block=min(spec.block, 2), episodes=few(spec.episodes), tta=rules,
        reference=min(spec.reference, 2),
    )  # fmt: skip
