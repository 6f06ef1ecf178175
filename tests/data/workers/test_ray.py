"""Blocks as Ray tasks: a real local cluster of two nodes, one of which is killed half-way."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from typing import Any

import pytest

from mpdt.data.workers.ray import map_blocks_ray
from mpdt.errors import MpdtError, SimulatorError

pytest.importorskip("ray", reason="pip install 'mpdt[ray]'")
pytestmark = pytest.mark.slow


@pytest.fixture
def cluster() -> Iterator[Any]:
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    yield cluster
    cluster.shutdown()


def test_every_item_once_and_a_lost_node_loses_nothing(cluster: Any) -> None:
    node = cluster.add_node(num_cpus=1)
    results = map_blocks_ray(math.factorial, list(range(40)), cluster.address)
    found = [next(results) for _ in range(3)]
    cluster.remove_node(node, allow_graceful=False)
    found += results
    assert sorted(found) == sorted(map(math.factorial, range(40)))


def test_errors_come_home_and_threads_are_one(cluster: Any) -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        list(map_blocks_ray(math.sqrt, [1.0, -1.0], cluster.address))
    assert list(map_blocks_ray(os.getenv, ["OMP_NUM_THREADS"], cluster.address)) == ["1"]


def test_no_cluster_is_one_clear_error() -> None:
    with pytest.raises(SimulatorError, match="no Ray cluster answers"):
        list(map_blocks_ray(math.sqrt, [1.0], "127.0.0.1:1"))


def hold_a_lot(gigabytes: int) -> int:
    held = b"x" * (gigabytes << 30)
    time.sleep(30)
    return len(held)


def test_a_block_that_has_too_much_memory_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that has a gigabyte to give; its worker takes three. Ray would go on for ever."""
    from ray.cluster_utils import Cluster

    monkeypatch.setattr("mpdt.data.workers.ray.MEMORY_RETRIES", 1)
    monkeypatch.delenv("RAY_task_oom_retries", raising=False)
    memory = pytest.importorskip("psutil").virtual_memory()
    most = 1 - (memory.available - (1 << 30)) / memory.total
    limits = {"memory_usage_threshold": most, "memory_monitor_refresh_ms": 200}
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": limits}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        with pytest.raises(MpdtError, match=r"Ray gave up on a block.*low on memory"):
            list(map_blocks_ray(hold_a_lot, [3], cluster.address))
    finally:
        cluster.shutdown()
