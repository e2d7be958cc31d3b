"""A batch on a Ray cluster: whoever is killed, each task is done once, and results are those of one machine."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest

from getagrip.clip import write_clip
from getagrip.io.plugins import install_command
from helpers.clusters import RayCluster, ray_cluster
from helpers.environment import Run, import_path
from helpers.folders import results_in
from helpers.scenes import SHORT, from_table, scene

COUNT = 18
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray: pip install -e '.[ray]'")


def start(out: Path, address: str) -> subprocess.Popen[str]:
    """A driver as a process, which prints what has become of the tasks."""
    code = (
        "from functools import partial; from pathlib import Path\n"
        "from getagrip.batch.clusters import RayExecutor; from helpers.jobs import drive\n"
        f"executor = partial(RayExecutor, None, {address!r})\n"
        f"print(*drive(Path({str(out)!r}), {COUNT}, 0.4, 1, executor), sep='\\n')"
    )
    words = [sys.executable, "-c", code]
    return subprocess.Popen(words, env=import_path(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(out: Path, count: int) -> None:
    """Wait until so many tasks are done."""
    end = time.monotonic() + 120.0
    while len(list(out.glob("task-??"))) < count:
        assert time.monotonic() < end
        time.sleep(0.05)


@needs_ray
@pytest.mark.slow
@pytest.mark.long
def test_whoever_is_killed_each_task_is_done_once_and_results_are_those_of_one_machine(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ray_cluster(nodes=1) as cluster:
        _a_node_and_then_the_driver_are_killed(cluster, tmp_path)
        monkeypatch.chdir(tmp_path)
        _results_are_the_same(cluster, tmp_path, run)  # on the node that is left


def _a_node_and_then_the_driver_are_killed(cluster: RayCluster, tmp_path: Path) -> None:
    driver = start(tmp_path, cluster.address)
    wait_for(tmp_path, 6)
    cluster.kill_node()
    wait_for(tmp_path, 12)
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    before = {path.name for path in tmp_path.glob("task-??")}
    assert len(before) < COUNT
    out, err = start(tmp_path, cluster.address).communicate(timeout=120)
    states = dict(line.split() for line in out.splitlines() if line.startswith("task-"))  # Ray may say something, too
    assert len(states) == COUNT, err
    assert set(states.values()) <= {"done", "kept"}
    assert {name for name, state in states.items() if state == "kept"} >= before
    runs = Counter((tmp_path / "runs").read_text().splitlines())
    assert len(runs) == COUNT
    again = {name for name, count in runs.items() if count > 1}
    assert len(again) <= 1 + 2  # what was at work on the node, and what the driver had given out


def _results_are_the_same(cluster: RayCluster, tmp_path: Path, run: Run) -> None:
    for n, category in enumerate(("can", "mug")):
        write_clip(*scene(category, n, SHORT), tmp_path / "clips" / category)
    write_clip(*from_table(), tmp_path / "whole")
    calls = [
        ["reconstruct", "clips", "--inits", "6", "--out", "{}"],
        ["bench", "clips", "--inits", "2", "--clips", "1", "--methods", "static", "--out", "{}/bench"],
        ["reconstruct", "whole", "--cut-grasps", "--inits", "2", "--out", "{}/found"],
    ]
    on_ray = ["--engine", "ray", "--address", cluster.address]
    for words in calls:
        assert run(*[word.format("here") for word in words], "--workers", "1")[0] == 0
    code = f"from getagrip.cli import main\nfor words in {calls}:\n"
    code += f"    assert main([word.format('there') for word in words] + {on_ray}) == 0"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env=import_path(), capture_output=True)
    kinds = "", "bench/results/static", "found"
    folders = [[folder for kind in kinds for folder in results_in(tmp_path / of / kind)] for of in ("here", "there")]
    pairs = list(zip(*folders, strict=True))
    assert len(pairs) == 4
    for here, there in pairs:
        assert here.name == there.name
        assert (here / "result.npz").read_bytes() == (there / "result.npz").read_bytes()
        records = [json.loads((folder / "result.json").read_text()) for folder in (here, there)]
        for record in records:
            del record["seconds"], record["clip_folder"]  # what they took, and of what was found, where its clip lies
        assert records[0] == records[1]
    found = [tmp_path / of / "found" / "clips" / "from-table.grasps.json" for of in ("here", "there")]
    assert found[0].read_bytes() == found[1].read_bytes()


def test_without_ray_the_call_says_how_to_get_it(
    clip_folder: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    status, _, err = run("reconstruct", clip_folder, "--out", tmp_path / "out", "--engine", "ray")
    assert status == 2
    assert err.startswith("getagrip: missing module 'ray' (")
    assert err.endswith(f"--engine ray needs it; {install_command('ray')}\n")


@needs_ray
@pytest.mark.slow
@pytest.mark.parametrize("address", ["127.0.0.1:{}", "ray://127.0.0.1:{}", "localhost:x", "nonsense"])
def test_an_address_that_does_not_answer_is_named(clip_folder: Path, tmp_path: Path, run: Run, address: str) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = address.format(free.getsockname()[1])
    call = ("reconstruct", clip_folder, "--out", tmp_path / "out", "--engine", "ray", "--address", address)
    status, _, err = run(*call)
    assert status == 2
    assert err.startswith("getagrip: --address must be the address of a Ray cluster")
    assert err.count("\n") == 1


def test_an_address_belongs_to_ray(clip_folder: Path, tmp_path: Path, run: Run) -> None:
    status, _, err = run("reconstruct", clip_folder, "--out", tmp_path / "out", "--address", "auto")
    assert status == 2
    assert err == "getagrip: --address cannot be used without --engine ray\n"
