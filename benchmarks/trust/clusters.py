"""One dataset by processes and by a Ray cluster that loses a node half-way: one content hash.

    python benchmarks/trust/clusters.py [--json FILE]        needs: pip install 'mpdt[ray]'

The cluster is two real Ray nodes on this machine, one core each. Parts come back through Ray's
object store in one run and are written into a shared folder in the other; the second node is
killed, not stopped, once a quarter of the blocks is done.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec
from ray.cluster_utils import Cluster

from mpdt.data.collect.collect import Progress, collect
from mpdt.data.collect.engine import RayCluster
from mpdt.data.collect.job import make_job
from mpdt.data.spec.catalog import load_catalog
from mpdt.data.spec.entry import DatasetSpec, EpisodeCounts


def small_spec() -> DatasetSpec:
    spec = load_catalog().get("cheetah_dir")
    counts = EpisodeCounts(random=100, medium=100, expert=200, history=200)
    return msgspec.structs.replace(spec, name="clusters", block=10, episodes=counts)


def by_cluster(spec: DatasetSpec, target: Path, shared_folder: bool) -> dict[str, Any]:
    head = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    node: Any = cluster.add_node(num_cpus=1)
    killed_at = 0

    def kill_one(progress: Progress) -> None:
        nonlocal node, killed_at
        if node is not None and progress.done_blocks * 4 >= progress.num_blocks:
            cluster.remove_node(node, allow_graceful=False)
            node, killed_at = None, progress.done_blocks

    began = time.monotonic()
    try:
        engine = RayCluster(cluster.address, shared_folder)
        data = collect(make_job(spec), target, engine=engine, on_progress=kill_one).dataset
    finally:
        cluster.shutdown()
    seconds = round(time.monotonic() - began, 1)
    return {"content": data.content_hash, "killed_after_blocks": killed_at, "seconds": seconds}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    spec = small_spec()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began = time.monotonic()
        wanted = collect(make_job(spec), folder / "processes.h5", workers=2).dataset.content_hash
        seconds = round(time.monotonic() - began, 1)
        result: dict[str, Any] = {"processes": {"content": wanted, "seconds": seconds}}
        for way, shared in (("object store", False), ("shared folder", True)):
            found = by_cluster(spec, folder / f"{way}.h5", shared)
            result[f"ray, {way}"] = found
            print(f"{way}: {found}", flush=True)
            if found["content"] != wanted:
                raise SystemExit(f"FAIL: content {found['content']}, expected {wanted}")
    print("PASS", json.dumps(result))
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
