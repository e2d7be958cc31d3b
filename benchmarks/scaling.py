"""How the cost of a reconstruction grows with frames, initial poses and faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.reconstruct_speed import reconstruction
from benchmarks.store import Table, of_cells, slug
from benchmarks.timing import timed, typical
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.fitting.options import Options
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.result import Reconstruction

CATEGORY = "kettle"
FRAMES = (10, 20, 30, 50, 100, 200, 300)
INITIAL_POSES = (10, 20, 50, 100, 200, 400)
FACES = (200, 500, 1000, 2000, 5000, 10_000, 20_000)
REPEATS = 3


@dataclass(frozen=True)
class Curve:
    """Cost against one size, everything else as by default."""

    name: str
    sizes: tuple[int, ...]
    seconds: list[float]
    """Processor time, the least of the repetitions."""
    stages: list[dict[str, float]]
    """The median of processor time by stage."""


def tables() -> dict[str, Table]:
    """Measure."""
    long, long_masks = synthesise(CATEGORY, 0, SceneOptions(frames=max(FRAMES)))
    clip, masks = synthesise(CATEGORY, 0)
    fine = _subdivided(clip.mesh, max(FACES))
    curves = [
        _measure("frames", FRAMES, lambda n: reconstruction(long, long_masks, Options(frames=n))),
        _measure("initial poses", INITIAL_POSES, lambda n: reconstruction(clip, masks, Options(inits=n))),
        _measure("faces", FACES, lambda n: reconstruction(replace(clip, mesh=decimate(fine, n)), masks)),
    ]
    return {f"scaling-{slug(curve.name)}": _table(curve) for curve in curves}


def _measure(name: str, sizes: tuple[int, ...], call_at: Callable[[int], Callable[[], Reconstruction]]) -> Curve:
    seconds, stages = [], []
    for size in sizes:
        call = call_at(size)
        call()
        timing, results = timed(call, REPEATS)
        seconds.append(min(timing.cpu))
        stages.append(typical([result.seconds for result in results]))
    return Curve(name, sizes, seconds, stages)


def _subdivided(mesh: Mesh, faces: int) -> Mesh:
    """The same surface in at least ``faces`` faces: all are split in four until there are enough."""
    import trimesh

    vertices, triangles = mesh.vertices, mesh.faces
    while len(triangles) < faces:
        vertices, triangles = trimesh.remesh.subdivide(vertices, triangles)  # type: ignore[no-untyped-call]
    return Mesh(np.asarray(vertices), np.asarray(triangles, dtype=np.int64))


def _table(curve: Curve) -> Table:
    slopes = np.diff(np.log(curve.seconds)) / np.diff(np.log(curve.sizes))
    overall = np.log(curve.seconds[-1] / curve.seconds[0]) / np.log(curve.sizes[-1] / curve.sizes[0])
    texts = ["", *(f"{slope:.2f}" for slope in slopes)]
    rows = [
        [f"{size:,}", f"{1e3 * seconds:.0f}", slope, *(f"{1e3 * part:.0f}" for part in spent.values())]
        for size, seconds, slope, spent in zip(curve.sizes, curve.seconds, texts, curve.stages, strict=True)
    ]
    found = f"cost grows as their number to the power {overall:.2f}, {slopes.max():.2f} at most between neighbours"
    header = [curve.name, "CPU, ms", "power", *curve.stages[0]]
    return of_cells(f"Cost by number of {curve.name}", header, rows, [found])
