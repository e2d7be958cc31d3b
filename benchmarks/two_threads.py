"""What a second thread gains for a clip that is waited for: ``reconstruct`` with one and with two, in turn."""

from __future__ import annotations

from dataclasses import replace
from statistics import median

import numpy as np

from benchmarks.problem import CLIPS, make
from benchmarks.store import Table, of_cells
from benchmarks.timing import timed
from getagrip.geometry.mesh import Mesh
from getagrip.result import Reconstruction
from getagrip.timelines.reconstruct import reconstruct

REPEATS = 9


def tables() -> dict[str, Table]:
    """Measure."""
    rows = []
    for category, seed in CLIPS:
        problem = make(category, seed)

        def call(threads: int, problem=problem) -> Reconstruction:
            mesh = Mesh(problem.clip.mesh.vertices, problem.clip.mesh.faces)  # has no tables yet
            return reconstruct(replace(problem.clip, mesh=mesh), problem.masks, threads=threads)

        same = np.array_equal(call(1).T_hand_obj, call(2).T_hand_obj)
        one, two = list[float](), list[float]()
        for _ in range(REPEATS):
            one += timed(lambda: call(1))[0].wall
            two += timed(lambda: call(2))[0].wall
        ratio = median(b / a for a, b in zip(one, two, strict=True))
        times = [f"{1e3 * median(wall):.0f}" for wall in (one, two)]
        rows.append([problem.clip.name, *times, f"{ratio:.2f}", "yes" if same else "no"])
    header = ["clip", "one thread, wall ms", "two, wall ms", "ratio", "the same to the bit"]
    return {"two-threads": of_cells("Two threads for one clip", header, rows)}
