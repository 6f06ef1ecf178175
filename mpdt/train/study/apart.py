"""Cells of a study side by side: each in a process of its own, or as a task of a Ray cluster.

    parent  ── one cell ──>  process or task: `run_study` of that cell, resumable like any other
    parent  <─ where it is, in the end its outcome ──

Cells know nothing of each other and each has the threads of its settings, so their numbers are
those of one after another. A process that dies (memory, kill -9) makes its own cell `failed`, by
name; the others go on, and the same command goes on with that cell from its checkpoint. With Ray a
lost task is begun again elsewhere; data, runs and results lie where every node sees them.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Literal

from mpdt.data.workers.processes import end_with_parent, interrupts_held_back
from mpdt.errors import UsageError
from mpdt.train.run.progress import Progress
from mpdt.train.run.stop import Stopped, StopRequest
from mpdt.train.study.live import Live
from mpdt.train.study.recipes import Cell
from mpdt.train.study.study import Outcome, Places, configure, inspect_cell, run_study

_LOOK_EVERY_S = 1.0
GOES_ON = "the same command goes on"


@dataclass(frozen=True)
class Engine:
    """Where cells run.

    Args:
        workers: processes at once; 1 = this one. Ray has as many tasks as the cluster has cores.
        address: of a Ray cluster, see `map_blocks_ray`.
    Raises: UsageError for what does not go together.
    """

    kind: Literal["processes", "ray"] = "processes"
    workers: int = 1
    address: str | None = None

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UsageError("no cell could run", where="--workers", expected="1 or more",
                             found=str(self.workers))  # fmt: skip
        if self.address is not None and self.kind != "ray":
            raise UsageError("an address without a cluster", where="--address",
                             found=self.address, hint="add --engine ray")  # fmt: skip


def run_cells(
    cells: Sequence[Cell], places: Places, engine: Engine, stop: StopRequest,
    quiet: bool = False, restart: bool = False,
) -> Iterator[Outcome]:  # fmt: skip
    """`run_study`, `run_apart` or `run_on_ray`, as the engine says."""
    if engine.kind == "processes" and engine.workers == 1:
        yield from run_study(cells, places, Progress(quiet, stop), restart)
        return
    with Live(quiet).shown() as live:
        if engine.kind == "ray":
            yield from run_on_ray(cells, places, stop, live, restart, address=engine.address)
        else:
            yield from run_apart(cells, places, stop, live, restart, workers=engine.workers)


def run_apart(
    cells: Sequence[Cell], places: Places, stop: StopRequest, live: Live, restart: bool = False,
    *, workers: int = 2,
) -> Iterator[Outcome]:  # fmt: skip
    """Outcomes as they come: first of what needs no run, then of what was run, `workers` at once.

    Raises: Stopped after a signal, once every cell has saved what it had.
    """
    waiting = yield from _to_do(cells, places, restart)
    running: dict[Connection, _Child] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                child = _Child.start(waiting.pop(0), places, restart)
                running[child.pipe] = child
                live.say(f"{child.cell.name} begins, process {child.process.pid}")
            for pipe in wait(list(running), _LOOK_EVERY_S):
                assert isinstance(pipe, Connection)
                if (outcome := running[pipe].hear(live)) is not None:
                    running.pop(pipe).process.join()
                    pipe.close()
                    yield outcome
            live.show({child.cell.name: child.line for child in running.values()})
            stop.check()
    finally:
        for child in running.values():
            child.process.terminate()  # it saves what it has
        for child in running.values():
            child.process.join()


def run_on_ray(
    cells: Sequence[Cell], places: Places, stop: StopRequest, live: Live, restart: bool = False,
    *, address: str | None = None,
) -> Iterator[Outcome]:  # fmt: skip
    """As `run_apart`, as many at once as the cluster has cores for.

    Raises: SimulatorError without Ray or cluster; Stopped after a signal, when cells that run go
        on from their last checkpoint by the same command.
    """
    from mpdt.data.workers.ray import RETRIES, cancel, connect

    there = Places(*(p.resolve() for p in (places.data, places.runs, places.results)))
    waiting = yield from _to_do(cells, there, restart)
    if not waiting:
        return
    ray = connect(address)
    try:
        board = ray.remote(num_cpus=0, max_restarts=-1)(_Board).remote()
        task = ray.remote(max_retries=RETRIES, retry_exceptions=False)(_task)
        flying = {
            task.options(num_cpus=max(1, configure(cell).threads)).remote(
                cell, there, restart, board): cell
            for cell in waiting
        }  # fmt: skip
        lines: dict[str, str] = {}
        heard = 0
        try:
            while flying:
                done, _ = ray.wait(list(flying), num_returns=1, timeout=_LOOK_EVERY_S)
                for one in done:
                    yield _landed(ray, one, flying.pop(one), there)
                with suppress(ray.exceptions.RayError):  # it moves with the node that it is on
                    lines, said = ray.get(board.read.remote(heard), timeout=_LOOK_EVERY_S)
                    heard += len(said)
                    for text in said:
                        live.say(text)
                names = {cell.name for cell in flying.values()}
                live.show({name: line for name, line in lines.items() if name in names})
                stop.check()
        finally:
            cancel(ray, flying)
    finally:
        ray.shutdown()


def _to_do(
    cells: Sequence[Cell], places: Places, restart: bool
) -> Generator[Outcome, None, list[Cell]]:
    """Yields the outcomes of cells that need no run, returns the others."""
    waiting = []
    for cell in cells:
        outcome = inspect_cell(cell, places, restart)
        if outcome.state == "to do":
            waiting.append(cell)
        else:
            yield outcome
    return waiting


@dataclass(frozen=True)
class _Said:
    """A line of its own, beside those that show where a cell is."""

    text: str


class _Telling(Progress):
    """Sends its lines to the parent."""

    def __init__(self, name: str, send: Callable[[str | _Said], None], stop: StopRequest) -> None:
        super().__init__(stop=stop)
        self._name, self._send = name, send

    def say(self, text: str) -> None:
        for line in text.splitlines():
            self._send(_Said(f"{self._name}  {line}"))

    def write(self, line: str, last: bool) -> None:
        self._send(line)


@dataclass
class _Child:
    """A process with one cell."""

    cell: Cell
    process: SpawnProcess
    pipe: Connection
    line: str = ""

    @classmethod
    def start(cls, cell: Cell, places: Places, restart: bool) -> _Child:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        with interrupts_held_back():  # Ctrl-C is for the parent, which decides
            process = context.Process(
                target=_work, args=(theirs, cell, places, restart), name=cell.name
            )
            process.start()
        theirs.close()
        return cls(cell, process, ours)

    def hear(self, live: Live) -> Outcome | None:
        """Take what it sent; its outcome, if that was it or nothing more can come."""
        try:
            said = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            return Outcome(self.cell, "failed", _death(self.process.exitcode))
        if isinstance(said, Outcome):
            return said
        if isinstance(said, _Said):
            live.say(said.text)
        else:
            self.line = said
        return None


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        why = " (memory usually)" if -code == signal.SIGKILL else ""
        return f"its process was ended by {signal.Signals(-code).name}{why}; {GOES_ON}"
    return f"its process ended with exit code {code}; {GOES_ON}"


def _work(pipe: Connection, cell: Cell, places: Places, restart: bool) -> None:
    """Main of a cell's process."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    # A signal to the whole process group reaches it twice: the parent passes it on.
    with suppress(Stopped, BrokenPipeError), StopRequest().listening(patient=True) as stop:
        pipe.send(_outcome(cell, places, restart, _Telling(cell.name, pipe.send, stop)))


def _outcome(cell: Cell, places: Places, restart: bool, progress: Progress) -> Outcome:
    """Of a run. Whatever else goes wrong in one fails that cell, and the others go on."""
    try:
        (outcome,) = run_study([cell], places, progress, restart)
    except Stopped:
        raise
    except Exception as error:  # noqa: BLE001
        told = str(error).splitlines() or [""]
        return Outcome(cell, "failed", f"{type(error).__name__}: {told[0]}")
    return outcome


class _Board:
    """An actor that keeps the latest line of every cell, and whatever was said."""

    def __init__(self) -> None:
        self._lines: dict[str, str] = {}
        self._said: list[str] = []

    def put(self, name: str, line: str | _Said) -> None:
        if isinstance(line, _Said):
            self._said.append(line.text)
        else:
            self._lines[name] = line

    def read(self, heard: int) -> tuple[dict[str, str], list[str]]:
        """Where every cell is, and what was said behind the first `heard`."""
        return self._lines, self._said[heard:]


def _task(cell: Cell, places: Places, restart: bool, board: Any) -> Outcome:
    """Main of a cell's task. What was begun before its node was lost is gone on with."""

    def send(line: str | _Said) -> None:
        board.put.remote(cell.name, line)

    return _outcome(cell, places, restart, _Telling(cell.name, send, StopRequest()))


def _landed(ray: Any, done: Any, cell: Cell, places: Places) -> Outcome:
    try:
        outcome: Outcome = ray.get(done)
    except ray.exceptions.RayError as error:
        told = str(error).strip().splitlines() or [type(error).__name__]
        return Outcome(cell, "failed", f"Ray gave up on it: {told[0]}; {GOES_ON}")
    if outcome.state == "done" and not places.result(cell).exists():
        note = f"its result is not here: every node must see {places.results}"
        return replace(outcome, state="failed", note=note)
    return outcome
