"""Depth images: ``depth``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks, Modality
from getagrip.clip.depth import DEPTH, Depth, DepthSource
from getagrip.clip.depth_files import depth_file, read_depth, write_depth
from getagrip.clip.sampling import frame_indices
from getagrip.fitting.energy import Term, Terms
from getagrip.geometry import se3
from getagrip.geometry.depth import depth_and_face
from getagrip.geometry.mesh import decimate

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.energy.depth import DepthErrors, DepthSamples
    from getagrip.fitting.problem import Problem

WEIGHT = 0.004
"""Energy per squared deviation of an independent sample [area of the masks]."""
INDEPENDENT = 6.0
"""Independent samples of each body in a frame: its errors are smooth."""
FEWEST = 20
"""Samples of a body in a frame below which each counts as one of so many."""
EVERY = 2
"""One sample in so many of a row, and of a column, is used; the others tell where borders are."""
FACES = {64: 200, 128: 500, 256: 500}
"""Most faces of the object at each resolution."""
MOST = {64: 40, 128: 60, 256: 100}
"""Samples of a body in a frame, at each resolution."""
FAR = 0.25
"""Samples beyond the middle of their body by more are of something else [share of the distance]."""


class DepthImages(Modality[Depth]):
    """Distances of the object's and the hand's visible surface."""

    name = DEPTH

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [name for frame in frames if (name := depth_file(folder, frame)) is not None]

    def read(self, clip: Clip) -> Depth | None:
        return read_depth(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        depth = self.of(clip)
        if depth is not None:
            write_depth(clip, depth, folder)

    def terms(self, problem: Problem) -> Terms | None:
        depth = self.of(problem.clip)
        if depth is None:
            return None
        from getagrip.fitting.energy.depth import DepthTerm, Solid

        clip, centre = problem.clip, problem.clip.mesh.centre
        meshes = {level: decimate(clip.mesh, faces) for level, faces in FACES.items()}
        solids = {level: Solid.of(mesh.vertices[None] - centre, mesh.faces) for level, mesh in meshes.items()}
        hand = Solid.of(clip.hand.vertices - clip.hand.vertices.mean(axis=(0, 1)), clip.hand.faces)
        errors, weight = errors_of(depth.source), WEIGHT * float(problem.observation.area.mean())

        @cache
        def samples(most: int) -> DepthSamples:
            return samples_of(clip, problem.masks, depth, most)

        def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
            some = samples(MOST[level]).take(index)
            return [DepthTerm(solids[level], hand.take(index), some, errors, weight)]

        return Terms(object=terms)


def errors_of(source: DepthSource) -> DepthErrors:
    """Return what depth of a source may err by."""
    from getagrip.fitting.energy.depth import DepthErrors

    sensor, free = source.source == "sensor", 1.0
    return DepthErrors(
        noise=source.assumed_error,
        clip=free if source.scale != "metric" else 0.004 if sensor else 0.08,
        frame=free if source.scale == "frame" else 0.001 if sensor else 0.012,
        relief=0.02 if sensor else 0.15,
        apart=0.003 if sensor else 0.008,
    )


def samples_of(clip: Clip, masks: Masks, depth: Depth, most: int) -> DepthSamples:
    """Return at most so many samples on the visible pixels of each of object and hand, but none at their borders."""
    from getagrip.fitting.energy.depth import DepthSamples

    given = np.full(depth.z.shape, np.inf)
    side = depth.z.shape[1]
    for n, (K, vertices) in enumerate(
        zip(depth.intrinsics(clip), se3.transform(clip.hand.T_cam_hand, clip.hand.vertices), strict=True)
    ):
        given[n] = depth_and_face(vertices, clip.hand.faces, K, (side, side))[0]
    bodies = [body[:, ::EVERY, ::EVERY] for body in bodies_of(clip, masks, depth, np.isfinite(given))]
    depth, given = depth.thinned(EVERY), given[:, ::EVERY, ::EVERY]
    parts = [[_part(body[n], depth.z[n], most) for body in bodies] for n in range(len(depth))]
    on_object = np.array([len(part[0]) for part in parts])
    used = on_object + [len(part[1]) for part in parts]
    shape = (len(depth), max(1, used.max()))
    place, (log_z, weight, relief, of_given) = np.zeros((*shape, 2), int), (np.zeros(shape) for _ in range(4))
    for n, part in enumerate(parts):
        end = used[n]
        place[n, :end] = np.concatenate(part)
        rows, columns = place[n, :end].T
        log_z[n, :end] = np.log(depth.z[n, rows, columns])
        relief[n, :end] = log_z[n, :end] - log_z[n, :end].mean() if end else 0.0
        of_given[n, :end] = np.log(given[n, rows, columns])
        weight[n, :end] = np.repeat([INDEPENDENT / max(len(one), FEWEST) for one in part], [len(one) for one in part])
    of_given[~np.isfinite(of_given)] = np.nan
    K = depth.intrinsics(clip)
    fxfycxcy = np.stack([K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]], axis=1)
    return DepthSamples(fxfycxcy, len(depth.z[0]), place, on_object, used, log_z, relief, weight, of_given)


def bodies_of(
    clip: Clip, masks: Masks, depth: Depth, drawn: Bool[ndarray, "T n n"]
) -> tuple[Bool[ndarray, "T n n"], Bool[ndarray, "T n n"]]:
    """Return which samples show the object and which the hand, without those at borders.

    Without masks of the hand, the ignored pixels that the given hand covers (``drawn``) are taken for it.
    """
    seen, hidden = depth.of_masks(masks.object, clip.size), depth.of_masks(masks.ignore, clip.size)
    hand = hidden & drawn if masks.hand is None else depth.of_masks(masks.hand, clip.size)
    return _inside(seen & ~(hidden & hand)), _inside(hand & ~seen)


def _inside(masks: Bool[ndarray, "T n n"]) -> Bool[ndarray, "T n n"]:
    return np.stack([cv2.erode(m.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool) for m in masks])


def _part(mask: Bool[ndarray, "n n"], z: Float[ndarray, "n n"], most: int) -> Int[ndarray, "m 2"]:
    """Return rows and columns of a body's samples that have depth near that of most."""
    place = np.argwhere(mask & (z > 0.0))
    if len(place):
        found = z[tuple(place.T)]
        place = place[np.abs(np.log(found / np.median(found))) < FAR]
    return place[frame_indices(len(place), most)] if len(place) else place
