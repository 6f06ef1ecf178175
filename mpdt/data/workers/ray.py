"""The same blocks on many machines: `map_blocks` as Ray tasks. Needs the extra `mpdt[ray]`.

    driver   collect, its lock, its progress bar        the only one that writes plan and file
      |  block numbers, a few per core in flight
      v
    tasks    on any node; one process keeps its simulators from task to task
      |  shared folder: the part is written where it happens, the report comes back
      '  object store:  the part's bytes come back too, and the driver writes them

A node that dies takes its running tasks along; Ray starts those blocks again elsewhere. They
are pure functions of their seeds, so the bytes are the same.
"""

from __future__ import annotations

import itertools
import os
import socket
import uuid
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from mpdt.data.workers.processes import WORKER_ENVIRONMENT
from mpdt.errors import MpdtError, SimulatorError

Item = TypeVar("Item")
Result = TypeVar("Result")

PER_CORE = 2
"""Tasks in flight per core: one runs, one waits, so that no core idles between blocks."""

RETRIES = 20
"""Of one block whose node or process was lost. More losses than that end the run."""

MEMORY_RETRIES = 2
"""Of a task whose worker had more memory than its node; Ray itself tries for ever."""

ANSWER_S = 5.0
"""How long a cluster may take to answer at all."""

_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
_SETTINGS = b"\x04"  # type of the frame that each side sends first; RFC 9113, section 3.4

_functions: dict[str, Callable[[Any], Any]] = {}
"""In a worker process: the one function of the latest run, with what it has built so far."""


def map_blocks_ray(
    function: Callable[[Item], Result], items: Sequence[Item], address: str | None = None
) -> Generator[Result, None, None]:
    """As `processes.map_blocks`, on a Ray cluster.

    Args:
        function: picklable; each worker process keeps its own copy.
        address: of a running cluster, `auto` for the one of this machine; None starts a local
            one that ends with this call.

    Raises: what `function` raised; SimulatorError without Ray or cluster; MpdtError if Ray
        itself gives up. Leaving the iterator early cancels what is in flight.
    """
    ray = connect(address)
    run = uuid.uuid4().hex  # names the function in the workers; nothing stored depends on it
    try:
        shared = ray.put(function)
        # Ray repeats a task of a lost node, never one whose function raised.
        task = ray.remote(num_cpus=1, max_retries=RETRIES, retry_exceptions=False)(_work)
        cores = int(ray.cluster_resources().get("CPU", 1))
        waiting = iter(items)

        def start(count: int) -> list[Any]:
            return [task.remote(run, [shared], item) for item in itertools.islice(waiting, count)]

        flying = start(PER_CORE * max(1, cores))
        try:
            while flying:
                (done, *_), flying = ray.wait(flying, num_returns=1)
                flying += [
                    task.remote(run, [shared], item) for item in itertools.islice(waiting, 1)
                ]
                yield _result(ray, done)
        finally:
            cancel(ray, flying)
    finally:
        ray.shutdown()


def cancel(ray: Any, flying: Iterable[Any]) -> None:
    """End tasks that nobody waits for any more."""
    for left in flying:
        with suppress(ray.exceptions.RayError):
            ray.cancel(left, force=True)


def connect(address: str | None) -> Any:
    """The package, connected to a cluster: see `map_blocks_ray`. Raises: SimulatorError."""
    os.environ.setdefault("RAY_task_oom_retries", str(MEMORY_RETRIES))  # read when it connects
    try:
        import ray
    except ImportError as error:
        raise SimulatorError(
            "the engine 'ray' needs Ray", hint="pip install 'mpdt[ray]'"
        ) from error
    # Set before a worker imports numpy; see processes.py.
    runtime = {"env_vars": WORKER_ENVIRONMENT}
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is None:
        options["include_dashboard"] = False
    try:
        if address and ":" in address:
            _ask(address)
        ray.init(address=address, runtime_env=runtime, **options)
    except (OSError, RuntimeError, ValueError) as error:
        raise SimulatorError(
            "no Ray cluster answers",
            where=address or "this machine",
            found=str(error).splitlines()[0],
            hint="ray start --head, then --address auto; or leave --address out",
        ) from error
    return ray


def _ask(address: str) -> None:
    """Whether a server that speaks gRPC, hence HTTP/2, is there: Ray itself would try for a minute.

    Raises: OSError where nobody answers, or something else does; ValueError for no address.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_S) as there:
        if os.environ.get("RAY_USE_TLS") == "1":  # it says nothing in plain words
            return
        there.sendall(_PREFACE)
        if there.recv(9)[3:4] != _SETTINGS:
            raise ConnectionError("something answers that is no Ray cluster")


def _work(run: str, shared: list[Any], item: Any) -> Any:
    if run not in _functions:
        import ray

        _functions.clear()
        _functions[run] = ray.get(shared[0])  # outside a list Ray would fetch it for every task
    return _functions[run](item)


def _result(ray: Any, done: Any) -> Any:
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except ray.exceptions.RayError as error:
        raise MpdtError(
            "Ray gave up on a block",
            found=str(error).splitlines()[0],
            hint="run the same command again: finished blocks are kept",
        ) from error
