"""Found segments as a timeline against each found grasp by itself: ``python -m benchmarks.found_timelines CLIPS [N]``.

CLIPS is what ``import dexycb --timelines`` has written; every N-th sequence (8) of the training subjects is taken, its
segments removed. Exact hands and masks, and strong noise of both. The table goes into
its page, docs/results-timelines.md.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import page
from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.clip.segment_files import with_segments
from getagrip.datasets.synthetic.noise import NOISE, perturbed
from getagrip.datasets.tracks import subject_of
from getagrip.experiments.stamp import stamp
from getagrip.experiments.timeline_scores import segment_scores
from getagrip.fitting.options import Options
from getagrip.metrics.symmetry import Symmetries, find_symmetries
from getagrip.result import Reconstruction
from getagrip.segmentation.cut import segment_list
from getagrip.segmentation.found import FoundSegments, find_segments
from getagrip.timelines.reconstruct import reconstruct

LEVELS = ("none", "strong")
KINDS = ("static", "between", "grasp")
HEADINGS = ("noise", "", "found grasps", *(f"true: {kind}" for kind in KINDS), "s")
Poses = Float[ndarray, "T 4 4"]


def poses(clip: Clip, result: Reconstruction) -> tuple[Poses, Poses]:
    """The object and the hand in the camera frame."""
    hand = clip.hand.T_cam_hand if result.T_cam_hand is None else result.T_cam_hand
    return hand @ result.T_hand_obj, hand


def alone(clip: Clip, masks: Masks, found: FoundSegments) -> tuple[Poses, Poses]:
    """Each stable grasp by itself; not a number elsewhere."""
    T_cam_obj, T_cam_hand = np.full((len(clip), 4, 4), np.nan), clip.hand.T_cam_hand.copy()
    for first, last in found.grasps:
        rows = np.arange(first, last + 1)
        part = replace(clip.take(rows), segments=())
        T_cam_obj[rows], T_cam_hand[rows] = poses(part, reconstruct(part, masks.take(rows)))
    return T_cam_obj, T_cam_hand


def together(clip: Clip, masks: Masks, found: FoundSegments) -> tuple[Poses, Poses]:
    """The whole interaction, before a camera that is guessed to stand still."""
    return with_plane(replace(clip, world=None), masks, found)


def with_plane(clip: Clip, masks: Masks, found: FoundSegments) -> tuple[Poses, Poses]:
    """The whole interaction, where the camera's pose and the plane of the table are known."""
    whole = with_segments(clip, segment_list(clip, found))
    return poses(whole, reconstruct(whole, masks))


WAYS: dict[str, Callable[[Clip, Masks, FoundSegments], tuple[Poses, Poses]]] = {
    "alone": alone, "together": together, "together + plane": with_plane,
}  # fmt: skip


def right(clip: Clip, symmetries: Symmetries, found: tuple[Poses, Poses]) -> list[tuple[str, bool, float]]:
    """Of each segment of the clip: its kind, whether it is right up to symmetries, and its mean ADD [diameters]."""
    return [(s.kind, s.right_sym, s.add_sym) for s in segment_scores(clip, symmetries, *found)]


def main(clips: Path, every: int) -> None:
    """Put the table into its page."""
    names = sorted(folder.name for folder in clips.iterdir() if (folder / "clip.json").is_file())
    training = sorted({subject_of(name) for name in names})[::3]
    names = [name for name in names if subject_of(name) in training][::every]
    rows: list[list[str]] = []
    for level in LEVELS:
        scores = {(way, of): list[tuple[str, bool, float]]() for way in WAYS for of in ("found", "true")}
        seconds = dict.fromkeys(WAYS, 0.0)
        for name in names:
            true = read_clip(clips / name)
            clip, masks = perturbed(true, read_masks(true), NOISE[level], [0, *name.encode()])
            clip = replace(clip, segments=())
            found = find_segments(replace(clip, world=None), masks)
            symmetries = find_symmetries(clip.mesh)
            grasps = tuple(one.segment for one in found.segments if one.segment.state == "grasp")
            for way, motion in WAYS.items():
                since = time.process_time()
                moved = motion(clip, masks, found)
                seconds[way] += time.process_time() - since
                these = right(replace(clip, segments=grasps), symmetries, moved)
                print(level, name, way, *(f"{100 * add:.1f} %" for _, _, add in these), file=sys.stderr)
                scores[way, "found"] += these
                scores[way, "true"] += right(true, symmetries, moved) if way != "alone" else []
        for way in WAYS:
            kinds = [scores[way, "found"], *([r for r in scores[way, "true"] if r[0] == kind] for kind in KINDS)]
            rows.append([level, way, *map(cell, kinds), f"{seconds[way] / len(names):.1f}"])
    about = f"{len(names)} sequences; {Options().inits} initial poses; made {stamp()}"
    page.write("found-timelines", f"{page.table(HEADINGS, rows)}\n\n{about}.")


def cell(scores: list[tuple[str, bool, float]]) -> str:
    """How many are right, and the median error."""
    if not scores:
        return "–"
    return f"{sum(ok for _, ok, _ in scores)} of {len(scores)}, {100 * np.median([add for *_, add in scores]):.1f} %"


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 8)
