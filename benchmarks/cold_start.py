"""Cost of a first start: CPU time to compile each kernel, with an empty cache: ``python -m benchmarks cold-start``.

Each group of kernels is compiled in a process of its own, as by ``compile_once``; a shared part counts for the first
kernel that calls it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile

from benchmarks.store import Table, of_cells
from getagrip.compiling import KERNEL_GROUPS

CHILD = """
import json, sys, time
import numba.core.event as events
from getagrip import compiling

open_, spent = [], {}


class Clock(events.Listener):
    def on_start(self, event):
        open_.append([time.process_time(), 0.0])

    def on_end(self, event):
        since, inner = open_.pop()
        took = time.process_time() - since
        if open_:
            open_[-1][1] += took
        function = event.data["dispatcher"].py_func
        ours = function.__module__.startswith("getagrip.")
        name = f"{function.__module__.removeprefix('getagrip.')}.{function.__name__}" if ours else "numba's own parts"
        spent[name] = spent.get(name, 0.0) + took - inner


events.register("numba:compile", Clock())
compiling.compile_modules(sys.argv[1:])
print(json.dumps({"all": time.process_time(), "kernels": spent}))
"""


def tables() -> dict[str, Table]:
    """Measure."""
    rows, total = [], 0.0
    for group in KERNEL_GROUPS:
        with tempfile.TemporaryDirectory() as empty:
            command = [sys.executable, "-c", CHILD, *group]
            environment = os.environ | {"NUMBA_CACHE_DIR": empty}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        measured = json.loads(done.stdout)
        total += measured["all"]
        spent = dict(sorted(measured["kernels"].items(), key=lambda one: -one[1]))
        spent["imports and the start of numba"] = measured["all"] - sum(spent.values())
        rows += [[group[0], name, f"{seconds:.2f}"] for name, seconds in spent.items()]
    rows += [["all", "all", f"{total:.2f}"], *_demos()]
    how = "an empty cache of kernels; one process per group. Then getagrip demo, from an empty cache and again"
    return {"cold-start": of_cells("A first start, by kernel", ["group", "kernel", "CPU, s"], rows, [how])}


def _demos() -> list[list[str]]:
    """Measure a first demo with an empty cache of kernels, and a second one."""
    rows = []
    with tempfile.TemporaryDirectory() as empty:
        for name in ("first", "again"):
            before = os.times()
            command = [sys.executable, "-m", "getagrip", "demo", "--out", os.path.join(empty, name)]
            subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": empty}, capture_output=True, check=True)
            after = os.times()
            spent = after.children_user + after.children_system - before.children_user - before.children_system
            rows.append(["getagrip demo", name, f"{spent:.2f}"])
    return rows
