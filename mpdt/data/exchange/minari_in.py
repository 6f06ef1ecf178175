"""Minari datasets in: sets of ours without loss, sets of others by rules.

Read with h5py and pyarrow, never through the package, which follows links out of a file and makes
the environment that a file names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from mpdt.data.episode import Episode
from mpdt.data.exchange import foreign
from mpdt.data.exchange.claims import Said
from mpdt.data.exchange.folder import files_below, left_out
from mpdt.data.exchange.foreign import Source, quality_code
from mpdt.data.exchange.incoming import Incoming
from mpdt.data.exchange.manifest import KEY, Manifest
from mpdt.data.exchange.minari import STEPS
from mpdt.data.exchange.minari_claims import goal_of, said_in, said_of_episode, seed_of
from mpdt.data.exchange.minari_sets import FORMS, files_of, main_file, notes_of, opened
from mpdt.data.exchange.treatment import RawEpisode, Rules, check_length
from mpdt.data.store.sources import EpisodeSource, FileHeader
from mpdt.errors import DataError, FormatError, ShapeError, UsageError
from mpdt.reading import decode_json, read_plain, refuse_other

_METADATA, _OF_NAMESPACES = "metadata.json", "namespace_metadata.json"


def read(paths: Sequence[Path], rules: Rules | None, name: str) -> Incoming:
    """Sets of ours without loss, or sets of others by `rules`, whichever lie below `paths`.

    Raises: UsageError, FormatError, DataError, ShapeError naming set and episode.
    """
    found = sets_below(paths)
    if not found:
        raise UsageError("no Minari dataset there", where=str(paths[0]),
                         expected="a folder with data/metadata.json in it")  # fmt: skip
    read = [path for folder, metadata in found.items() for path in files_of(folder, metadata)]
    named = [path for path in files_below(paths, ".json") if path.name == _OF_NAMESPACES]
    remarks = left_out(paths, read + named)
    if rules is None and all(KEY in metadata for metadata in found.values()):
        return _read_own(found, remarks)
    rules = foreign.given(rules)
    sources = []
    for folder, metadata in found.items():
        said = said_in(metadata, rules.family, str(folder)).settled(rules, str(folder))
        if not said.task:
            tasks = ", ".join(task.name for task in rules.family.tasks)
            raise UsageError("of which task?", where="--task", hint=f"one of: {tasks}")
        sources.append(
            Source(main_file(folder, metadata), rules.family.task(said.task),
                   quality_code(said.quality or "unknown"),
                   partial(foreign_episodes, folder, metadata, said, rules), said.license,
                   str(metadata.get("dataset_id", "")), notes_of(folder, metadata))
        )  # fmt: skip
    return foreign.incoming(sources, rules, name, remarks)


def sets_below(paths: Sequence[Path]) -> dict[Path, dict[str, Any]]:
    """The folders of sets, and what their metadata say. Raises: FormatError; StorageError."""
    known = {path.parent for path in files_below(paths, ".json") if path.name == _METADATA}
    # In an arrow set every episode has a folder and metadata of its own.
    return {folder: read_metadata(folder) for folder in sorted(known) if folder.parent not in known}


def read_metadata(folder: Path) -> dict[str, Any]:
    path = folder / _METADATA
    refuse_other(path, "the metadata of a Minari dataset", "text")
    content = read_plain(path)
    try:
        metadata = decode_json(content)
        form, episodes = metadata["data_format"], metadata["total_episodes"]
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError("not the metadata of a Minari dataset", where=str(path),
                          found=f"{type(error).__name__}: {error}"[:120]) from error  # fmt: skip
    if form not in FORMS or type(episodes) is not int or type(metadata.get(KEY, "")) is not str:
        raise FormatError("another storage format", where=str(path),
                          expected=f"data_format {' or '.join(FORMS)}",
                          found=str(form)[:40])  # fmt: skip
    found: dict[str, Any] = metadata
    return found


def foreign_episodes(
    folder: Path, metadata: dict[str, Any], said: Said, rules: Rules
) -> Iterator[RawEpisode]:
    rows = rules.horizon + 1
    with opened(folder, metadata) as stored:
        for number in range(metadata["total_episodes"]):
            episode = stored.episode(number)
            where, told = episode.where, episode.attributes
            said.and_also(said_of_episode(told, rules), where)
            if (length := episode.length()) is not None:
                check_length(length, rules, where)
            steps = {name: episode.array(name, rows) for name in STEPS}
            yield RawEpisode(**steps, successes=episode.successes(rows),
                             goal=goal_of(told, where), seed=seed_of(told))  # fmt: skip


def _read_own(found: dict[Path, dict[str, Any]], remarks: Sequence[str]) -> Incoming:
    manifests = {metadata[KEY]: folder for folder, metadata in found.items()}
    where = str(min(found))
    if len(manifests) != 1:
        raise FormatError("sets of several exports", where=where,
                          hint="import them one by one")  # fmt: skip
    manifest = Manifest.from_json(min(manifests), where)
    entries = [e for folder, metadata in found.items() 
               for e in _entries(folder, metadata, manifest.header)]  # fmt: skip
    if len(entries) != manifest.num_episodes:
        raise DataError("not all sets of the export are there", where=where,
                        expected=f"{manifest.num_episodes} episodes", found=str(len(entries)),
                        hint="copy the missing ones, or give --family and --task to import "
                             "these as foreign data")  # fmt: skip
    if (steps := sum(entry.num_steps for entry in entries)) != manifest.num_steps:
        raise DataError("not the steps of the export", where=where,
                        expected=str(manifest.num_steps), found=str(steps))  # fmt: skip
    rows = {task.name: row for row, task in enumerate(manifest.header.tasks)}
    try:
        entries.sort(key=lambda e: (rows[e.options["task"]], quality_code(e.options["quality"])))
        sources = [int(e.options["source"]) for e in entries if "source" in e.options]
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError("options of an episode are wrong", where=where,
                          found=f"{type(error).__name__}: {error}"[:120]) from error  # fmt: skip
    episodes = _own_episodes(found, entries, manifest, rows)
    source = EpisodeSource(episodes, len(entries), manifest.num_steps, sources or None)
    return manifest.incoming(source, remarks)


@dataclass(frozen=True)
class _Entry:
    """One episode of one of our sets."""

    folder: Path
    number: int
    options: dict[str, Any]
    num_steps: int


def _entries(folder: Path, metadata: dict[str, Any], header: FileHeader) -> Iterator[_Entry]:
    """Raises: ShapeError before anything is reserved for arrays of other sizes."""
    with opened(folder, metadata) as stored:
        for number in range(metadata["total_episodes"]):
            episode = stored.episode(number)
            sizes = [episode.shape(name) for name in STEPS[:3]]
            wanted = [(header.observation_size,), (header.action_size,), ()]
            if sizes != wanted:
                raise ShapeError("arrays of other sizes than the export says", where=episode.where,
                                 expected=str(wanted), found=str(sizes))  # fmt: skip
            options = {
                k.partition("/")[2]: v for k, v in episode.attributes.items() if "options/" in k
            }
            yield _Entry(folder, number, options, episode.length() or 0)


def _own_episodes(
    found: dict[Path, dict[str, Any]], entries: Sequence[_Entry], manifest: Manifest,
    rows: dict[str, int],
) -> Iterator[Episode]:  # fmt: skip
    for folder, some in groupby(entries, lambda entry: entry.folder):
        with opened(folder, found[folder]) as stored:
            for entry in some:
                episode, options = stored.episode(entry.number), entry.options
                rows_read = manifest.num_steps + 1
                key = [int(number) for number in options["seed_key"]]
                yield Episode(
                    **{name: episode.array(name, rows_read) for name in STEPS},
                    successes=episode.successes(rows_read),
                    task=manifest.header.tasks[rows[options["task"]]].index,
                    goal=np.asarray(options["goal"], np.float64),
                    quality=quality_code(options["quality"]),
                    progress=float(options["progress"]), policy=bytes.fromhex(options["policy"]),
                    seed_key=(key[0], key[1], key[2], key[3], key[4]),
                )  # fmt: skip
