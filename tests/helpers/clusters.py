"""Slurm's commands as scripts, as far as submitit uses them: the tasks of an array are processes of this machine.

What they cannot show: queues, other machines, Slurm's own limits.

A Ray cluster of several nodes on this machine, as a program of its own: a head and other nodes, of one CPU each.

It prints the cluster's address. Each line of its input kills a node with all that runs there. It ends with its input.

An object store on this machine: moto's S3 server as a program of its own.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from helpers.environment import import_path

SBATCH = r"""
import os, re, subprocess, sys
script = open(sys.argv[-1]).read()
array = re.search(r"--array='?0-(\d+)%", script)
tasks = [f"_{task}" for task in range(int(array[1]) + 1)] if array else [""]
if "REFUSED" in os.environ:
    sys.exit("sbatch: error: invalid partition specified: none")
jobs = os.path.join(HERE, "jobs")
os.makedirs(jobs, exist_ok=True)
job = str(len(os.listdir(jobs)) + 1)
os.makedirs(os.path.join(jobs, job))
open(os.path.join(jobs, job, "script"), "w").write(script)
for task in tasks:
    state = os.path.join(jobs, job, job + task)
    open(state, "w").write("RUNNING")
    env = os.environ | {
        "SLURM_JOB_ID": job, "SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1", "SLURM_NODEID": "0",
        "SLURM_JOB_NODELIST": "here", "SLURM_PROCID": "0", "SLURM_LOCALID": "0",
    }
    if array:
        env |= {"SLURM_ARRAY_JOB_ID": job, "SLURM_ARRAY_TASK_ID": task[1:]}
    ends = f'bash {jobs}/{job}/script && echo COMPLETED > {state} || echo NODE_FAIL > {state}'
    null = subprocess.DEVNULL
    subprocess.Popen(["bash", "-c", ends], env=env, stdin=null, stdout=null, stderr=null, start_new_session=True)
print("Submitted batch job", job)
"""
SRUN = """
import os, sys
words = sys.argv[1:]
while words[0].startswith("--"):
    words = words[1 if words[0] == "--unbuffered" else 2:]
os.execv(words[0], words)
"""
SACCT = """
import os
print("JobID|State|NodeList")
jobs = os.path.join(HERE, "jobs")
for job in os.listdir(jobs):
    for task in os.listdir(os.path.join(jobs, job)):
        if task != "script":
            print(f"{task}|{open(os.path.join(jobs, job, task)).read().strip()}|here")
"""
COMMANDS = {"sbatch": SBATCH, "srun": SRUN, "sacct": SACCT, "scancel": ""}


def write_slurm(folder: Path) -> Path:
    """Write the commands into a new folder, which belongs into ``PATH``."""
    folder.mkdir()
    for name, code in COMMANDS.items():
        (folder / name).write_text(f"#!{sys.executable}\nHERE = {str(folder)!r}\n{code}")
        (folder / name).chmod(0o755)
    return folder


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
    words = [sys.executable, "-m", "helpers.clusters", str(nodes)]
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

BUCKET = "bucket"


@contextmanager
def s3_server() -> Iterator[dict[str, str]]:
    """The environment in which s3:// means this server, which has an empty bucket."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    env = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1", "MOTO_ALLOW_NONEXISTENT_REGION": "1",
    }  # fmt: skip
    words = [sys.executable, "-m", "moto.server", "-p", str(port)]
    with subprocess.Popen(words, env=os.environ | env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            end = time.monotonic() + 60.0
            while not _listens(port):
                assert time.monotonic() < end, "the server has not started"
                time.sleep(0.1)
            yield env
        finally:
            server.terminate()


def _listens(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0
