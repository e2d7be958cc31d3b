"""Measure how often texture tells front from back: ``python -m benchmarks.texture SCANS`` (``results/texture.json``).

SCANS is a folder of textured .obj scans. Each is filmed (``synthetic.filmed``): hand and masks are exact, images are
not: light, blur, noise and compression. The search's result is compared with the truth before and after the texture,
and so are results that were turned on purpose, by half about each principal axis. Turned ones count where the masks are
met nearly as well, that is, where no silhouette tells. Then the colours are made plain, missing, or those of another
scan: results must stay as they are.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from benchmarks import store
from benchmarks.timing import circumstances
from getagrip.clip import read_clip, write_clip
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.solver.solve import minimise
from getagrip.fitting.stages.texture import prefer_texture
from getagrip.geometry import se3
from getagrip.synthetic.filmed import (
    GRASP_FRAMES,
    REACH_FRAMES,
    SEEDS,
    FilmedClip,
    draw_look,
    make_filmed_scene,
    read_scan,
)
from getagrip.synthetic.scene import ground_truth_masks
from getagrip.synthetic.video import render_video

CLIPS_PER_SCAN = 2
RIGHT_DEG = 45.0
"""Rotation from the truth, mean over frames, below which front and back are right [degrees]."""
ALIKE = 1.5
"""Energy of a turned pose, relative to the search's, up to which no silhouette tells them apart."""
REFIT = 128, 8
"""Resolution [px] and iterations of the fit of a turned pose."""
COLUMNS = (
    store.Column("results", "results"),
    store.Column("before", "front and back right before", "%"),
    store.Column("after", "after", "%"),
    store.Column("mended", "mended"),
    store.Column("lost", "lost"),
    store.Column("contradicted", "contradicted"),
    store.Column("seconds", "CPU of the texture", "s", 2),
    store.Column("share", "share of the search's CPU", "%", 0),
)


@dataclass(frozen=True)
class Trial:
    """A result before and after the texture."""

    before: float
    after: float
    correlation: float
    against: float
    seconds: float
    search_seconds: float


def filmed_problem(clip: FilmedClip, folder: Path) -> tuple[Problem, MethodResult, float]:
    """Film a scan, and search without its texture; also return the search's CPU time [s]."""
    scene, colours = make_filmed_scene(clip)
    look, rows = draw_look(clip.split, clip.seed, colours), np.arange(REACH_FRAMES, REACH_FRAMES + GRASP_FRAMES)
    pictures = [image for n, image in enumerate(render_video(scene, scene.clip.size, clip.seed, look)) if n in rows]
    part = replace(scene.clip.take(rows), scale="known")
    assert part.truth is not None
    if part.mesh.colours is None:
        part = replace(part, mesh=replace(part.mesh, colours=painted(colours)))
    part = replace(part, mesh=replace(part.mesh, vertices=part.truth.scale * part.mesh.vertices))
    part = replace(part, truth=replace(part.truth, scale=1.0))
    problem = prepare_problem(
        read_clip(write_clip(part, ground_truth_masks(scene).take(rows), folder, images=pictures)), Options()
    )
    since = time.process_time()
    found = METHODS[problem.options.method].fit(problem, lambda stage: None)
    return problem.as_found(found), found, time.process_time() - since


def painted(colours: ndarray | None) -> UInt8[ndarray, "V 3"]:
    """Return a scan's colours as bytes."""
    assert colours is not None
    return np.asarray(np.round(255.0 * colours), np.uint8)


def turned(problem: Problem, found: MethodResult) -> Iterator[MethodResult]:
    """Yield the result turned by half about each principal axis, where the masks are met nearly as well."""
    assert found.motion is not None
    assert found.energy_of is not None
    T_cam_hand, frames = problem.clip.hand.T_cam_hand, np.arange(len(problem.clip))
    turns = np.concatenate([np.eye(3)[None], se3.exp_so3(np.pi * problem.surface.axes)])
    motion = found.motion.take(np.zeros(4, int)).rotated(turns)
    fitted = minimise(motion, found.energy_of(problem)(REFIT[0], frames), T_cam_hand, REFIT[1])
    for k in np.flatnonzero(fitted.energy <= ALIKE * fitted.energy[0]):
        alone = fitted.motion.take(np.array([k]))
        terms = {name: float(value[k]) for name, value in fitted.terms.items()}
        if k:
            yield replace(found, motion=alone, poses=alone.poses(), energy=fitted.energy[[k]], terms=terms)


def off(problem: Problem, found: MethodResult) -> float:
    """Return the rotation of a result from the truth, mean over frames [degrees]."""
    truth = problem.clip.truth
    assert truth is not None
    R = problem.clip.hand.T_cam_hand[:, :3, :3] @ found.poses.R[0]
    return float(np.degrees(se3.angle_between(R, truth.T_cam_obj[:, :3, :3])).mean())


def trial(problem: Problem, found: MethodResult, searched: float) -> Trial:
    """Let texture decide about a result."""
    since = time.process_time()
    after = prefer_texture(problem, found)
    spent = time.process_time() - since
    vote = after.texture
    return Trial(off(problem, found), off(problem, after), vote.correlation, vote.against, spent, searched)


def row(label: str, trials: list[Trial]) -> store.Row:
    """Make the row of some results."""
    right = np.array([[one.before < RIGHT_DEG, one.after < RIGHT_DEG] for one in trials])
    return {
        "label": label,
        "results": float(len(trials)),
        "before": 100.0 * float(right[:, 0].mean()),
        "after": 100.0 * float(right[:, 1].mean()),
        "mended": float(np.sum(~right[:, 0] & right[:, 1])),
        "lost": float(np.sum(right[:, 0] & ~right[:, 1])),
        "contradicted": float(sum(one.against > 10.0 for one in trials)),
        "seconds": float(np.mean([one.seconds for one in trials])),
        "share": 100.0 * sum(one.seconds for one in trials) / sum(one.search_seconds for one in trials),
    }


def main(folder: Path) -> None:
    """Measure all scans of a folder."""
    made = circumstances("python -m benchmarks.texture SCANS")
    scans = sorted(folder.rglob("*.obj"))
    by = defaultdict[str, list[Trial]](list)
    for n, scan in enumerate(scans):
        for seed in SEEDS["train"][:CLIPS_PER_SCAN]:
            clip = FilmedClip(f"scan-{scan.parent.name}", seed, "train", "right", "front", True, scan)
            with TemporaryDirectory() as place:
                problem, found, searched = filmed_problem(clip, Path(place) / "clip")
                starts = {"the search's": [found], "turned by half": [*turned(problem, found)]}
                mesh = problem.clip.mesh
                other = read_scan(scans[n - 1])
                assert mesh.colours is not None
                assert other.colours is not None
                paint = {
                    "": mesh.colours,
                    ", plain colours": np.full_like(mesh.colours, 150),
                    ", without colours": None,
                    ", colours of another scan": mesh.coloured_like(
                        other.vertices - other.centre + mesh.centre, other.colours
                    ).colours,
                }
                for words, colours in paint.items():
                    of = replace(problem, clip=replace(problem.clip, mesh=replace(mesh, colours=colours)))
                    for kind, some in starts.items():
                        for start in some:
                            one = trial(of, start, searched)
                            by[kind + words].append(one)
                            print(clip.name, kind + words, one, flush=True)
    rows = [row(label, trials) for label, trials in by.items() if trials]
    notes = (
        f"{len(scans)} scans, {CLIPS_PER_SCAN} clips each of {GRASP_FRAMES} frames, exact hands and masks",
        f"right: rotated by less than {RIGHT_DEG:g} degrees from the truth, symmetries of the shape not counted",
    )
    print(store.write("texture", store.Table("Texture tells front from back", made, COLUMNS, rows, notes=notes)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
