"""The formats: which can be read, which written, and what each of them loses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpdt.data.exchange import (
    d4rl,
    lerobot,
    lerobot_in,
    minari,
    minari_arrow,
    minari_in,
    mtdiff,
    npz,
    ogbench,
    parquet,
    promptdt,
)
from mpdt.data.exchange.folder import refuse_existing
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.selection import Selection
from mpdt.data.exchange.treatment import Rules
from mpdt.disk import appearing, holding
from mpdt.errors import UsageError, unknown_name


@dataclass(frozen=True)
class Format:
    """One format.

    Args:
        read: paths, rules (None for a format that describes itself) and a name for the file.
        write: a selection into an empty folder.
        lost: what an export leaves out; "" = importing it again gives the same content hash.
    """

    read: Callable[[Sequence[Path], Rules | None, str], Incoming] | None
    write: Callable[[Selection, Path], None] | None
    lost: str = ""


FORMATS: dict[str, Format] = {
    "minari": Format(minari_in.read, minari.write),
    "minari-arrow": Format(None, minari_arrow.write),
    "parquet": Format(parquet.read, parquet.write),
    "npz": Format(npz.read, npz.write),
    "d4rl": Format(d4rl.read, d4rl.write, d4rl.LOST),
    "lerobot": Format(lerobot_in.read, lerobot.write, lerobot.LOST),
    "ogbench": Format(None, ogbench.write, ogbench.LOST),
    "promptdt": Format(promptdt.read, promptdt.write, promptdt.LOST),
    "mtdiff": Format(mtdiff.read, None),
}


def read(name: str, paths: Sequence[Path], rules: Rules | None, file_name: str) -> Incoming:
    """What the files hold, ready for `incoming.store`.

    Raises: UsageError for an unknown format; otherwise as the format's own `read`.
    """
    readers = {key: known.read for key, known in FORMATS.items() if known.read}
    if name not in readers:
        raise unknown_name("format", name, readers, where="--from")
    if rules is not None and name in ("npz", "parquet"):
        raise UsageError(f"{name} is read only where mpdt wrote it", where="--family",
                         hint="leave out --family and what goes with it")  # fmt: skip
    return readers[name](paths, rules, file_name)


def write(name: str, selection: Selection, target: Path, link: bool = False) -> str:
    """Export to a new folder `target`; returns what the format has no room for.

    Args:
        link: minari only, see there.
    Raises: UsageError for an unknown format; DataError if `target` exists; BusyError if another
            process writes or wrote there meanwhile; StorageError.
    """
    writers = {key: known.write for key, known in FORMATS.items() if known.write}
    if name not in writers:
        raise unknown_name("format", name, writers, where="--to")
    if link and name != "minari":
        raise UsageError(f"{name} has no links", where="--link", hint="only minari has")
    with holding(target):
        refuse_existing(target)
        with appearing(target) as folder:
            if link:
                minari.write(selection, folder, link=True)
            else:
                writers[name](selection, folder)
    return FORMATS[name].lost
