"""hash: every digest from the bytes, content and spec hash, and with --locked the lock's."""

from __future__ import annotations

import numpy as np

from mpdt.data.lock.file import LockEntry, run_text
from mpdt.data.lock.fingerprint import digests_by_run, is_as_locked, lost_runs
from mpdt.data.spec.change import changed_keys
from mpdt.data.spec.entry import spec_hash
from mpdt.data.store.dataset import Dataset
from mpdt.data.store.digest import content_hash
from mpdt.data.store.digests import Labels, array_digests
from mpdt.data.store.origin import damaged_hint
from mpdt.data.store.seal import seal_holds
from mpdt.data.store.tables import TtaSet
from mpdt.data.verify.finding import Fault, Finding, judge
from mpdt.data.verify.material import Chunk, Material, Track
from mpdt.data.verify.streaming import Faults
from mpdt.data.workers.threads import Ahead
from mpdt.errors import quoted


class HashCheck:
    """StepCheck `hash`.

    Args:
        lock: the lock file's words for messages, and its entry of this data set; None = the lock
            is not asked.
    """

    id = "hash"

    def __init__(self, material: Material, lock: tuple[str, LockEntry | None] | None) -> None:
        self._material, self._lock = material, lock
        self._labels = Labels(material.dataset)
        self._faults, self._num_digests = Faults(), 0
        self._ahead = Ahead[tuple[Track, Chunk, list[int]]]()

    def look(self, track: Track, chunk: Chunk) -> None:
        """Begins to hash: what is found is added later, in the order of the chunks."""
        for found in self._ahead.give(self._wrong, track, chunk):
            self._add(*found)

    def _wrong(self, track: Track, chunk: Chunk) -> tuple[Track, Chunk, list[int]]:
        """Episodes of the chunk whose bytes are others. In a thread of its own."""
        table, labels = track.table, self._labels
        ids = range(chunk.first, chunk.last)
        arrays = [
            ("observations", chunk.observations), ("actions", chunk.actions),
            ("rewards", chunk.rewards), ("terminations", chunk.terminations),
            ("truncations", chunk.truncations),
        ]  # fmt: skip
        if chunk.successes is not None:
            arrays.append(("successes", chunk.successes))
        texts = [labels.tta(table, i) if isinstance(table, TtaSet) else labels.episode(i)
                 for i in ids]  # fmt: skip
        digests = array_digests(arrays, chunk.lengths.tolist(), texts)
        found = np.frombuffer(digests, np.uint8).reshape(-1, 32)
        wrong = np.flatnonzero((found != table.digest[chunk.first : chunk.last]).any(axis=1))
        return track, chunk, (wrong + chunk.first).tolist()

    def _add(self, track: Track, chunk: Chunk, wrong: list[int]) -> None:
        self._faults.add("other bytes than the digest says", track, wrong)
        self._num_digests += chunk.last - chunk.first

    def finding(self) -> Finding:
        for found in self._ahead.rest():
            self._add(*found)
        self._ahead.stop()
        data = self._material.dataset
        faults = self._faults.all()
        if content_hash(data.content_header(), data.episodes.digest) != data.content_hash:
            faults.append(Fault("the content hash does not fit the digests"))
        if spec_hash(data.spec) != data.spec_hash:
            faults.append(Fault("the spec hash does not fit the spec"))
        if not seal_holds(self._material.path):
            faults.append(Fault("the seal is broken: something outside the episodes was changed"))
        for name, tta in data.tta.items():
            finite = np.isfinite(tta.preset_return).all()  # else `tta` tells
            if finite and tta.content_hash not in _tta_hashes(self._material, tta):
                faults.append(Fault("the hash of the set does not fit it", track=f"tta {name}"))
        hint = damaged_hint(self._material.path, data) if faults else ""
        compared = ""
        if self._lock is not None:
            locked, compared = _lock_faults(self._material, *self._lock)
            if locked and not faults:
                hint = "mpdt-data lock shows the states; mpdt-data collect NAME --locked remakes it"
                hint = hint.replace("NAME", quoted(data.name))
            faults += locked
        text = f"{self._num_digests:,} digests, content {data.content_hash[:8]}{compared}"
        return judge(self.id, faults, text, hint)


def _lock_faults(material: Material, path: str, entry: LockEntry | None) -> tuple[list[Fault], str]:
    """What the lock says against this file; and what it says for it."""
    data = material.dataset
    if entry is None:
        return [Fault(f"{path} has no entry {data.name}")], ""
    if changes := changed_keys(entry.spec, dict(data.spec)):
        same = entry.version == data.version
        but = f"but version is still {data.version}" if same else f"locked is {entry.version}"
        hashes = f"locked spec {entry.hashes.spec[:8]}, found {data.spec_hash[:8]}"
        return [Fault(f"the spec differs from {path} ({'; '.join(changes)}), {but}: {hashes}")], ""
    if data.parent:
        if data.parent == entry.hashes.content:
            return _cut_faults(data, path, entry), f", cut out of what {path} holds"
        return [Fault(f"cut out of {data.parent[:8]}, but {path} holds "
                      f"{entry.hashes.content[:8]}")], ""  # fmt: skip
    if is_as_locked(data, entry):
        return [], f" = {path}"
    runs = lost_runs(data, entry)
    where = f" in {', '.join(runs[:3])}" if runs else ""
    return [Fault(f"not what {path} holds: content {data.content_hash[:8]}, locked "
                  f"{entry.hashes.content[:8]}, other episodes{where}")], ""  # fmt: skip


def _cut_faults(data: Dataset, path: str, entry: LockEntry) -> list[Fault]:
    """Whole runs of a cut-out are compared; of a part of one there is no hash."""
    wrong, partly = [], []
    for task, runs in digests_by_run(data).items():
        for run, digests in runs.items():
            locked = entry.runs.get(task, {}).get(run, "")
            place = f"{task}/{run}"
            if run.startswith("tta-") and run not in entry.runs.get(task, {}):
                continue  # a set that was added later
            if int(locked.partition(" ")[0] or 0) == len(digests) // 32:
                wrong += [place] * (run_text(digests) != locked)
            elif int(locked.partition(" ")[0] or 0) < len(digests) // 32:
                wrong.append(place)
            else:
                partly.append(place)
    if wrong:
        return [Fault(f"not what {path} holds: other episodes in {', '.join(wrong[:3])}")]
    if partly:
        return [Fault(f"holds some episodes of {', '.join(partly[:3])}; {path} can only prove all "
                      "of them", is_doubt=True)]  # fmt: skip
    return []


def _tta_hashes(material: Material, tta: TtaSet) -> set[str]:
    """What the set's own hash may be.

    Its preset returns count with all the digits somebody typed, and the file keeps a float32:
    0.1 may have been 0.1 or, in a copy of a copy, that float32 itself.
    """
    data = material.dataset
    presets = {
        data.tasks.names[row]: value
        for row, value in zip(tta.task.tolist(), tta.preset_return, strict=True)
    }
    found = set()
    for typed in (True, False):
        values = {
            name: float(str(value)) if typed else float(value) for name, value in presets.items()
        }
        identity = data.content_header() | {"rule": dict(tta.rule), "preset_return": values}
        found.add(content_hash(identity, tta.digest))
    return found
