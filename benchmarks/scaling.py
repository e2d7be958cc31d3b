"""Growth of a reconstruction's cost with the number of frames, initial poses and faces, and with the images' size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.reconstruct_speed import in_fresh_process, reconstruction
from benchmarks.store import Table, of_cells, slug
from benchmarks.timing import timed, typical
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.fitting.options import Options
from getagrip.geometry.mesh import Mesh, decimate, edge_length, subdivide_surface
from getagrip.result import Reconstruction
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

CATEGORY = "kettle"
FRAMES = (10, 20, 30, 50, 100, 200, 300)
INITIAL_POSES = (10, 20, 50, 100, 200, 400)
FACES = (200, 500, 1000, 2000, 5000, 10_000, 20_000)
IMAGE_SIZES = (640, 480), (1920, 1080), (3840, 2160)
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


def pixels() -> dict[str, Table]:
    """Measure reading and reconstruction of one scene in images of several sizes, and the memory of a new process."""
    rows, first = [], 0.0
    with TemporaryDirectory() as scratch:
        for width, height in IMAGE_SIZES:
            scene = SceneOptions(size=(width, height), focal=SceneOptions.focal * height / SceneOptions.size[1])
            folder = write_clip(*synthesise(CATEGORY, 0, scene), Path(scratch) / f"{width}x{height}")
            least, masks = [], read_masks(read_clip(folder))
            for call in (lambda at=folder: read_masks(read_clip(at)), reconstruction(read_clip(folder), masks)):
                call()
                least.append(min(timed(call, REPEATS)[0].cpu))
            first = first or sum(least)
            memory = in_fresh_process(folder)["memory"]
            milliseconds = [f"{1e3 * part:.0f}" for part in least]
            rows.append([f"{width} x {height}", *milliseconds, f"{sum(least) / first:.2f}", f"{memory:.0f}"])
    header = ["images", "reading, CPU ms", "reconstruction, CPU ms", "both, to the first", "memory, MB"]
    how = ["memory: the peak of a new process, imports included"]
    return {"scaling-pixels": of_cells("Cost by size of the images", header, rows, how)}


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
