"""Engine: who does the missing blocks of a collection. The bytes do not depend on it.

Processes     spawned on this machine; they write their parts themselves
RayCluster    tasks on any node; parts come back through Ray, or lie in a folder all nodes see
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from mpdt.data.collect.job import Job
from mpdt.data.collect.parts import PartsFolder
from mpdt.data.collect.plan import Block
from mpdt.data.collect.runner import BlockReport, BlockRunner, bundled
from mpdt.data.store import provenance
from mpdt.data.workers.processes import default_workers, map_blocks
from mpdt.data.workers.ray import map_blocks_ray
from mpdt.disk import write_bytes
from mpdt.errors import SimulatorError, UsageError

DECISIVE_PACKAGES = ("mpdt", "python", "numpy", "mujoco", "metaworld")
DECISIVE_MACHINE = ("arch", "cpu", "blas")


class Engine(Protocol):
    """Does blocks; each part is whole in `folder` before its report is handed out."""

    def reports(
        self, job: Job, folder: PartsFolder, blocks: Sequence[Block]
    ) -> Generator[BlockReport, None, None]: ...


@dataclass(frozen=True)
class Processes:
    """`workers` spawned processes; None = one per core, 0 = in this process."""

    workers: int | None = None

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 0:
            raise UsageError("a negative number of workers", found=str(self.workers))

    def reports(
        self, job: Job, folder: PartsFolder, blocks: Sequence[Block]
    ) -> Generator[BlockReport, None, None]:
        workers = default_workers() if self.workers is None else self.workers
        bundles = bundled(job.plan, blocks, workers)
        with closing(map_blocks(BlockRunner(job, folder).together, bundles, workers)) as done:
            for reports in done:
                yield from reports


@dataclass(frozen=True)
class RayCluster:
    """Ray tasks, see `workers/ray.py`.

    Args:
        address: of a running cluster; None starts one on this machine.
        shared_folder: every node sees the parts folder under the same path, so parts are
            written where they are made. Otherwise they come back through Ray's object store.
    """

    address: str | None = None
    shared_folder: bool = False

    def reports(
        self, job: Job, folder: PartsFolder, blocks: Sequence[Block]
    ) -> Generator[BlockReport, None, None]:
        """Raises: SimulatorError for a node whose versions or CPU give other bytes."""
        worker = NodeWorker(job, folder if self.shared_folder else None)
        here = decisive_versions()
        for finished in map_blocks_ray(worker, blocks, self.address):
            if finished.versions != here:
                name = next(key for key in here if finished.versions.get(key) != here[key])
                raise SimulatorError(
                    "a node of the cluster would make other bytes",
                    where=name,
                    expected=here[name],
                    found=finished.versions.get(name, "nothing"),
                    hint="use nodes of one CPU type with the same packages",
                )
            if finished.content is not None:
                write_bytes(folder.part(finished.report.block).path, finished.content)
            yield finished.report


def decisive_versions() -> dict[str, str]:
    """What the bytes of a block depend on beside spec and policies; parts never mix them."""
    packages, machine = provenance.packages(), provenance.machine()
    found = {name: packages[name] for name in DECISIVE_PACKAGES if name in packages}
    return found | {name: machine[name] for name in DECISIVE_MACHINE}


@dataclass(frozen=True)
class FinishedBlock:
    """A finished block as a node sends it back; `content` are the bytes of its part, or None."""

    report: BlockReport
    versions: dict[str, str]
    content: bytes | None


@dataclass(eq=False)
class NodeWorker:
    """What runs on a node: simulate a block and hand over its part."""

    job: Job
    folder: PartsFolder | None
    _runner: BlockRunner | None = field(default=None, repr=False)

    def __call__(self, block: Block) -> FinishedBlock:
        if self._runner is None:
            self._runner = BlockRunner(self.job, self.folder or self._own_folder())
        report = self._runner(block)
        part = self._runner.folder.part(block).path
        content = None
        if self.folder is None:
            content = part.read_bytes()
            part.unlink()
        return FinishedBlock(report, decisive_versions(), content)

    def _own_folder(self) -> PartsFolder:
        place = tempfile.mkdtemp(prefix="mpdt-")
        weakref.finalize(self, shutil.rmtree, place, ignore_errors=True)
        folder = PartsFolder(Path(place) / "x")
        (folder.path / "blocks").mkdir(parents=True)
        return folder
