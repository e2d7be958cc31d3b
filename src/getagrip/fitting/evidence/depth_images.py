"""Depth images (``depth``): distances of the visible surfaces of object and hand, their checks and their term."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.checks.check import Check, format_percent
from getagrip.checks.evidence import Evidence
from getagrip.clip import Clip, Modality
from getagrip.clip.depth import (
    DEPTH_KEY,
    MAX_DEPTH_RATIO,
    MIN_SURROUNDINGS_DEPTH_RATIO,
    Depth,
    depth_file,
    median_surroundings_depth_ratio,
    read_depth,
    write_clip_depth,
)
from getagrip.fitting.energy import Term, Terms
from getagrip.geometry.mesh import decimate

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.energy.depth_term import DepthSamples
    from getagrip.fitting.problem import Problem

DEPTH_WEIGHT = 0.004
"""Energy per squared deviation of an independent sample [area of the masks]: a nat of the masks for objects of the
hand's size, and less for smaller ones, whose contact with the hand counts less as well."""
MAX_DEPTH_MESH_FACES = {64: 200, 128: 500, 256: 500}
"""Maximum number of faces of the object at each resolution."""
MAX_DEPTH_SAMPLES = {64: 40, 128: 60, 256: 100}
"""Maximum number of samples of a body in a frame, at each resolution."""
MAX_DEPTH_MISFIT = 1.6
"""Maximum deviation of depth from the solved surfaces, without its warp [standard deviations]; 0.4 to 1 on training
clips, 1 to 3.6 for depth of another clip."""
MAX_DEPTH_WARP = 0.03
"""Maximum warp over object and hand [fraction of the distance]: 0.021 on training clips, 0.05 to 0.16 where depth is
warped by 30 %, but for one of 36."""


def hand_depth_ratio(it: Evidence) -> float:
    """Measure the ratio of the hand's distance in metric depth to its input distance."""
    depth = DepthImages().of(it.clip)
    if depth is None or depth.source.scale != "metric":
        return np.nan
    from getagrip.fitting.energy.depth_term import median_hand_depth_ratio, sample_depth

    return median_hand_depth_ratio(sample_depth(it.clip, it.masks, depth, MAX_DEPTH_SAMPLES[64]))


def has_depth_unit_mismatch(depth: Depth, samples: DepthSamples) -> bool:
    """Return whether metric depth shows the hand at a distance beyond ``MAX_DEPTH_RATIO``, and is not used."""
    from getagrip.fitting.energy.depth_term import median_hand_depth_ratio

    off = abs(np.log(median_hand_depth_ratio(samples)))
    return depth.source.scale == "metric" and bool(off > np.log(MAX_DEPTH_RATIO))  # not of NaN


def measure_background_ratio(it: Evidence) -> float:
    """Measure the ratio of the surroundings' distance to the object's in depth images."""
    depth = DepthImages().of(it.clip)
    return np.nan if depth is None else median_surroundings_depth_ratio(depth, it.masks, it.clip.size)


def depth_fractions(it: Evidence) -> tuple[float, float]:
    """Measure the fraction of the visible surface without depth, and of its depth far behind or before the rest."""
    depth = DepthImages().of(it.clip)
    if depth is None:
        return np.nan, np.nan
    from getagrip.fitting.energy.depth_term import missing_and_outlier_fractions

    return missing_and_outlier_fractions(it.clip, it.masks, depth)


def depth_misfit(it: Evidence) -> tuple[float, float]:
    """Measure depth's deviation from the solved surfaces [standard deviations], and its warp [fraction of distance].

    The deviation is without depth's scale and warp. NaN of depth that is not used.
    """
    depth = DepthImages().of(it.clip)
    if depth is None or it.T_hand_obj is None:
        return np.nan, np.nan
    from getagrip.fitting.energy.depth_term import depth_deviation_at, sample_depth

    samples = sample_depth(it.clip, it.masks, depth, MAX_DEPTH_SAMPLES[128])
    if has_depth_unit_mismatch(depth, samples) or not samples.weight.any():
        return np.nan, np.nan
    return depth_deviation_at(it.clip, samples, depth.source, it.T_hand_obj, it.scale)


class DepthImages(Modality[Depth]):
    """Distances of the object's and the hand's visible surface."""

    name = DEPTH_KEY
    input_checks = (
        Check(
            "depth-unit", hand_depth_ratio, low=1.0 / MAX_DEPTH_RATIO, high=MAX_DEPTH_RATIO,
            fault="depth images show the hand at {value} times its input distance, and were not used",
            advice="check the depth's unit and scale, and the hand's distance",
        ),
        Check(
            "depth-inverse", measure_background_ratio, low=MIN_SURROUNDINGS_DEPTH_RATIO,
            fault="depth images show the object's surroundings at {value} times its distance, and were not used",
            advice="are these disparities (inverse depth)? Import depth",
        ),
        Check(
            "depth-missing", lambda it: depth_fractions(it)[0], high=0.9, serious=False, shown=format_percent,
            fault="{value} of the visible surface of object and hand have no depth", advice="is it of this clip?",
        ),
        Check(
            "depth-elsewhere", lambda it: depth_fractions(it)[1], high=0.25, serious=False, shown=format_percent,
            fault="{value} of the depth on object and hand is far behind or before the rest",
            advice="is it of this clip, aligned to its images and of the same field of view?",
        ),
    )  # fmt: skip
    result_checks = (
        Check(
            "depth-misfit", lambda it: depth_misfit(it)[0], high=MAX_DEPTH_MISFIT, serious=False,
            fault="depth deviates from the solved surfaces by {value} standard deviations, and counted little",
            advice="is it of this clip? A wrong hand or mesh has the same effect",
        ),
        Check(
            "depth-warped", lambda it: depth_misfit(it)[1], high=MAX_DEPTH_WARP, serious=False, shown=format_percent,
            fault="depth is warped by {value} over hand and object",
            advice="a network's warp was left out; is the depth of this clip, and does the network know such scenes?",
        ),
    )  # fmt: skip

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [name for frame in frames if (name := depth_file(folder, frame)) is not None]

    def read(self, clip: Clip) -> Depth | None:
        return read_depth(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        depth = self.of(clip)
        if depth is not None:
            write_clip_depth(clip, depth, folder)

    def terms(self, problem: Problem) -> Terms | None:
        depth = self.of(problem.clip)
        if depth is None:
            return None
        from getagrip.fitting.energy.depth_term import DepthTerm, Solid, depth_errors_of, sample_depth

        clip, centre = problem.clip, problem.clip.mesh.centre

        @cache
        def samples(most: int) -> DepthSamples:
            return sample_depth(clip, problem.masks, depth, most)

        inverse = median_surroundings_depth_ratio(depth, problem.masks, clip.size) < MIN_SURROUNDINGS_DEPTH_RATIO
        if inverse or has_depth_unit_mismatch(depth, samples(MAX_DEPTH_SAMPLES[64])):
            return None
        meshes = {level: decimate(clip.mesh, faces) for level, faces in MAX_DEPTH_MESH_FACES.items()}
        solids = {level: Solid.of(mesh.vertices[None] - centre, mesh.faces) for level, mesh in meshes.items()}
        hand = Solid.of(clip.hand.vertices, clip.hand.faces)
        errors, weight = depth_errors_of(depth.source), DEPTH_WEIGHT * float(problem.observation.area.mean())

        def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
            some = samples(MAX_DEPTH_SAMPLES[level]).take(index)
            return [DepthTerm(solids[level], hand.take(index), some, errors, weight)]

        return Terms(object=terms)
