"""Worker processes: run a function over blocks in spawned processes; the order never matters.

Used by `collect`, `calibrate` and `reference` on one machine; ray.py does the same on many.

    parent  --index-->  worker     one pipe per worker: a damaged worker cannot block a queue
    parent  <-result--  worker     the next index goes to whoever answered

Workers start with one BLAS and one OpenMP thread and one BLAS kernel, set before they import
numpy: threads in small matrix products only spin, and both may change the last bits. They ignore
Ctrl-C (the parent decides) and end at once when the parent is gone, also by SIGKILL.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from mpdt.errors import MpdtError

Item = TypeVar("Item")
Result = TypeVar("Result")

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


WORKER_ENVIRONMENT = dict.fromkeys(THREAD_VARIABLES, "1")
"""Of every process that simulates."""
if platform.machine() == "x86_64":
    # OpenBLAS has kernels per CPU type that differ in a last bit, which contacts amplify. This
    # one runs on every CPU with AVX2.
    WORKER_ENVIRONMENT["OPENBLAS_CORETYPE"] = "Haswell"


def pin_kernel() -> None:
    """Let this process compute as its workers do, so that `--workers 0` gives the same bits.

    OpenBLAS reads the variable when numpy is imported, so a program that did so before keeps the
    kernel that it has.
    """
    kernel = WORKER_ENVIRONMENT.get("OPENBLAS_CORETYPE")
    if kernel and "numpy" not in sys.modules:
        os.environ["OPENBLAS_CORETYPE"] = kernel


def default_workers() -> int:
    """Processor cores this process may use, at least 1."""
    return max(1, len(os.sched_getaffinity(0)))


def map_blocks(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Generator[Result, None, None]:
    """Results of `function` over `items`, in order of arrival.

    Args:
        function: picklable; each worker keeps its own copy, so it may cache simulators.
        items: picklable, each done exactly once.
        workers: number of processes; 0 runs in this process, for tests and debugging. The same
            bits only where `pin_kernel` came before numpy, as in `mpdt-data`.

    Raises: whatever `function` raised, with the worker's traceback as its cause; MpdtError if
    a worker died. Leaving the iterator early ends the workers.
    """
    if workers == 0:
        yield from map(function, items)
        return
    running = _WorkerProcesses(function, min(workers, len(items)))
    try:
        waiting = iter(items)
        for pipe in list(running.processes):
            running.send_next(pipe, waiting)
        for _ in range(len(items)):
            pipe, result = running.next_answer()
            running.send_next(pipe, waiting)
            yield result
    finally:
        running.terminate()


class _WorkerProcesses:
    """The processes of one `map_blocks` call, by the pipe that leads to each."""

    def __init__(self, function: Callable[[Any], Any], size: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.processes: dict[Connection, SpawnProcess] = {}
        with _worker_environment(), interrupts_held_back():
            for _ in range(size):
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(theirs, function), daemon=True)
                process.start()
                theirs.close()
                self.processes[ours] = process

    def send_next(self, pipe: Connection, waiting: Iterator[Any]) -> None:
        """Send the next item to a worker; with nothing left an empty task ends it."""
        task = tuple(islice(waiting, 1))
        try:
            pipe.send(task)
        except (BrokenPipeError, ConnectionResetError):
            # The worker died between two blocks; that loses nothing when no item is left.
            if task:
                raise self._death_of(pipe) from None

    def next_answer(self) -> tuple[Connection, Any]:
        while True:
            pipe = next(pipe for pipe in wait(list(self.processes)) if isinstance(pipe, Connection))
            try:
                error, text, result = pipe.recv()
            except (EOFError, ConnectionResetError):
                if self._ended_normally(pipe):
                    continue
                raise self._death_of(pipe) from None
            if error is not None:
                raise error from RuntimeError(f"in a worker process:\n{text}")
            return pipe, result

    def _ended_normally(self, pipe: Connection) -> bool:
        """True, and the worker is removed, if its exit code is 0."""
        self.processes[pipe].join(timeout=5)
        if self.processes[pipe].exitcode != 0:
            return False
        del self.processes[pipe]
        pipe.close()
        return True

    def _death_of(self, pipe: Connection) -> MpdtError:
        process = self.processes[pipe]
        process.join(timeout=5)
        return MpdtError(
            "a worker process died",
            where=f"process {process.pid}",
            found=f"exit code {process.exitcode}",
            hint="usually memory ran out: use fewer --workers; finished blocks are kept"
            if process.exitcode == -signal.SIGKILL
            else "finished blocks are kept; what it wrote on stderr may say why",
        )

    def terminate(self) -> None:
        for process in self.processes.values():
            process.terminate()
        for pipe, process in self.processes.items():
            process.join()
            pipe.close()


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """Main of a worker: answer (error, traceback, result) until an empty task or a closed pipe."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        if not task:
            return
        answer: tuple[BaseException | None, str, Any]
        try:
            answer = (None, "", function(task[0]))
        except Exception as error:  # noqa: BLE001  re-raised in the parent
            answer = (error, traceback.format_exc(), None)
        try:
            pipe.send(answer)
        except BrokenPipeError:
            return
        except Exception:  # noqa: BLE001  an error or result that cannot be pickled
            pipe.send((RuntimeError("answer cannot be pickled"), traceback.format_exc(), None))


def end_with_parent() -> None:
    """Main of a thread of a worker: the process ends when its parent is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


@contextmanager
def _worker_environment() -> Iterator[None]:
    """Spawned processes inherit the variables before they import anything."""
    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    os.environ.update(WORKER_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """A blocked signal mask is inherited, so Ctrl-C never reaches a worker."""
    # Starting the resource tracker unblocks the signal, so it has to run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
