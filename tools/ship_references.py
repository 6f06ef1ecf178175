"""Put measured references into the package: only of experts that today's entries meet.

    mpdt-data reference mt50 --horizons 200,500 -o measured.json
    python tools/ship_references.py measured.json

What is shipped already stays, but for experts whose weights, noise or script are no longer
those of any entry of datasets.yaml. Prints what entries still miss, and what is not precise.
"""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path

import msgspec

from mpdt.data.sim.measure import PRECISION, RULE
from mpdt.data.sim.portions import expert_ladder, kind_of
from mpdt.data.sim.record import (
    Entry,
    Place,
    constant_names,
    expert_name,
    load_entries,
    place_of,
    save_entries,
)
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.tasks import get_family
from mpdt.errors import MpdtError


def main(paths: list[Path]) -> None:
    target = Path(str(resources.files("mpdt.data.weights"))) / "references.json"
    book: dict[Place, Entry] = {}
    for path in (target, *paths):
        for place, entry in load_entries(path).items():
            before = book.get(place)
            same = before is not None and before.versions == entry.versions
            scores = before.scores | entry.scores if before and same else entry.scores
            book[place] = msgspec.structs.replace(entry, scores=scores)
    wanted = wanted_scores()
    kept = {}
    for place, entry in book.items():
        experts = {name for name in wanted.get(place, ()) if kind_of(name) == "expert"}
        scores = {
            name: score for name, score in entry.scores.items()
            if kind_of(name) != "expert" or name in experts
        }  # fmt: skip
        kept[place] = msgspec.structs.replace(entry, scores=scores)
    missing = [
        (place, name) for place, names in wanted.items()
        for name in sorted(names) if place not in kept or name not in kept[place].scores
    ]  # fmt: skip
    save_entries(target, kept.values(), RULE)
    print(f"{target}: {len(kept)} entries, {sum(len(e.scores) for e in kept.values())} scores")
    print(f"missing: {len(missing)} of {sum(map(len, wanted.values()))} scores that entries meet")
    for scene, horizon in sorted({place[:2] for place, _ in missing}):
        count = sum(place[:2] == (scene, horizon) for place, _ in missing)
        print(f"   {scene} {horizon}: {count} scores")
    for place, entry in sorted(kept.items()):
        for line in imprecise(entry):
            print("  ", *place[:2], line)


def wanted_scores() -> dict[Place, set[str]]:
    """By place, the scores that some entry of datasets.yaml looks for."""
    wanted: dict[Place, set[str]] = {}
    for spec in load_catalog().specs.values():
        try:
            ladder = expert_ladder(spec)
        except MpdtError as error:
            print(f"{spec.name}: {error}")
            continue
        for task in spec.resolve_tasks():
            names = wanted.setdefault(place_of(spec, task, spec.horizon), {"random"})
            names |= {expert_name(ladder, task)}
            names |= set(constant_names(get_family(spec.family).action_size))
    return wanted


def imprecise(entry: Entry) -> list[str]:
    """Scores whose error is over PRECISION of the span to any of the entry's experts."""
    found = []
    for expert in (name for name in entry.scores if kind_of(name) == "expert"):
        span = abs(entry.scores[expert].mean - entry.scores["random"].mean)
        own = (s for s in entry.scores.items() if kind_of(s[0]) != "expert" or s[0] == expert)
        found += [
            f"{name[:15]} {score.error / span:.1%} of the span after {score.episodes} episodes"
            for name, score in own
            if score.error > PRECISION * span
        ]
    return found


if __name__ == "__main__":
    main([Path(word) for word in sys.argv[1:]])
