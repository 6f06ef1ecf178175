"""What runs are called: by their data, where nobody says."""

from __future__ import annotations

import re
import unicodedata
from glob import has_magic
from pathlib import Path

from mpdt.data.store.reader import parse_ref

MOST_LETTERS = 120  # most disks end at 255


def fitting_name(stem: str) -> str:
    """A name for a run on that file: `my data` -> `my-data`, `Übung 3` -> `Ubung-3`."""
    plain = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode("ascii")
    fitting = re.sub(r"[^A-Za-z0-9_.+]+", "-", plain)[: MOST_LETTERS // 2].strip("-_.+")
    return fitting or "run"


def name_of_data(ref: str) -> str:
    """What a run on FILE or FILE:slice is called: `data/ml10.h5` -> `ml10`; of several files
    `a-b`, of more than three `a-and-3-more`, of a pattern its folder."""
    path, _ = parse_ref(ref)
    if path.exists():
        return fitting_name(path.resolve().name if path.is_dir() else path.stem)
    words = [Path(word) for word in str(path).split(",") if word]
    stems = [word.parent.name if has_magic(word.name) else word.stem for word in words]
    if len(stems) > 3:
        return fitting_name(f"{stems[0]}-and-{len(stems) - 1}-more")
    return fitting_name("-".join(stems))
