"""Growth of a reconstruction's cost with the number of frames, initial poses and faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.reconstruct_speed import reconstruction
from benchmarks.store import Table, of_cells, slug
from benchmarks.timing import timed, typical
from getagrip.fitting.options import Options
from getagrip.geometry.mesh import Mesh, decimate, edge_length, subdivide_surface
from getagrip.result import Reconstruction
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

CATEGORY = "kettle"
FRAMES = (10, 20, 30, 50, 100, 200, 300)
INITIAL_POSES = (10, 20, 50, 100, 200, 400)
FACES = (200, 500, 1000, 2000, 5000, 10_000, 20_000)
REPEATS = 3


def tables() -> dict[str, Table]:
    """Measure."""
    long, long_masks = synthesise(CATEGORY, 0, SceneOptions(frames=max(FRAMES)))
    clip, masks = synthesise(CATEGORY, 0)
    area = float(clip.mesh.vertex_areas.sum())
    # Subdivided to as many vertices as the largest number of faces; ``decimate`` reduces it.
    fine = Mesh(*subdivide_surface(clip.mesh.vertices, clip.mesh.faces, edge_length(area, max(FACES))))
    curves: tuple[tuple[str, tuple[int, ...], Callable[[int], Callable[[], Reconstruction]]], ...] = (
        ("frames", FRAMES, lambda n: reconstruction(long, long_masks, Options(frames=n))),
        ("initial poses", INITIAL_POSES, lambda n: reconstruction(clip, masks, Options(inits=n))),
        ("faces", FACES, lambda n: reconstruction(replace(clip, mesh=decimate(fine, n)), masks)),
    )
    return {f"scaling-{slug(curve[0])}": _measure(*curve) for curve in curves}


def _measure(name: str, sizes: tuple[int, ...], call_at: Callable[[int], Callable[[], Reconstruction]]) -> Table:
    """Measure the cost against one size, other sizes at their defaults: the minimum CPU time of the repetitions."""
    seconds, stages = [], []
    for size in sizes:
        call = call_at(size)
        call()
        timing, results = timed(call, REPEATS)
        seconds.append(min(timing.cpu))
        stages.append(typical([result.seconds for result in results]))
    slopes = np.diff(np.log(seconds)) / np.diff(np.log(sizes))
    overall = np.log(seconds[-1] / seconds[0]) / np.log(sizes[-1] / sizes[0])
    texts = ["", *(f"{slope:.2f}" for slope in slopes)]
    rows = [
        [f"{size:,}", f"{1e3 * least:.0f}", slope, *(f"{1e3 * part:.0f}" for part in spent.values())]
        for size, least, slope, spent in zip(sizes, seconds, texts, stages, strict=True)
    ]
    found = f"cost grows as their number to the power {overall:.2f}, {slopes.max():.2f} at most between neighbours"
    return of_cells(f"Cost by number of {name}", [name, "CPU, ms", "power", *stages[0]], rows, [found])
