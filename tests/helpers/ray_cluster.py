"""A Ray cluster of several nodes on this machine, as a program of its own: a head and other nodes, of one CPU each.

It prints the cluster's address. Each line of its input kills a node with all that runs there. It ends with its input.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO

from helpers.paths import import_path


@dataclass(frozen=True)
class RayCluster:
    """One that runs."""

    address: str
    _lines: IO[str]

    def kill_node(self) -> None:
        """Kill one of its nodes, not the head, as a machine that loses its power."""
        self._lines.write("kill\n")
        self._lines.flush()


@contextmanager
def ray_cluster(nodes: int) -> Iterator[RayCluster]:
    """A cluster of so many nodes beside its head."""
    words = [sys.executable, "-m", "helpers.ray_cluster", str(nodes)]
    env = import_path() | {"RAY_USAGE_STATS_ENABLED": "0"}
    with subprocess.Popen(
        words, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        try:
            address = program.stdout.readline().strip()
            assert address, "the cluster has not started"
            yield RayCluster(address, program.stdin)
        finally:
            program.stdin.close()
            program.wait(timeout=60)


def _main(nodes: int) -> None:
    from ray.cluster_utils import Cluster

    store = 100 * 2**20
    head = {"num_cpus": 1, "include_dashboard": False, "no_monitor": True, "object_store_memory": store}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    there = [cluster.add_node(num_cpus=1, object_store_memory=store) for _ in range(nodes)]
    print(cluster.address, flush=True)
    for _ in sys.stdin:
        cluster.remove_node(there.pop(), allow_graceful=False)
    cluster.shutdown()


if __name__ == "__main__":
    _main(int(sys.argv[1]))
