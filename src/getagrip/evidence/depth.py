"""Depth images: ``depth``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.checks.check import Check, percent
from getagrip.checks.evidence import Evidence
from getagrip.clip import Clip, Modality
from getagrip.clip.depth import DEPTH, INVERSE, UNIT, Depth, behind_usually
from getagrip.clip.depth_files import depth_file, read_depth, write_depth
from getagrip.fitting.energy import Term, Terms
from getagrip.geometry.mesh import decimate

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.energy.depth import DepthSamples
    from getagrip.fitting.problem import Problem

WEIGHT = 0.004
"""Energy per squared deviation of an independent sample [area of the masks]: what a nat of the masks weighs for objects
of the hand's size, and less for smaller ones, whose contact with the hand counts less as well."""
FACES = {64: 200, 128: 500, 256: 500}
"""Most faces of the object at each resolution."""
MOST = {64: 40, 128: 60, 256: 100}
"""Samples of a body in a frame, at each resolution."""
OFF = 1.6
"""Usual deviation of depth from the surfaces that were found, its warp apart, at most [in what it may err by]; 0.4 to 1
on training clips, 1 to 3.6 for depth of another clip."""
WARPED = 0.03
"""Usual warp over object and hand, at most [share of the distance]: at most 0.021 on training clips, 0.05 to 0.16 where
depth is warped by 30 %, but for one of 36."""


def hand_ratio(it: Evidence) -> float:
    """Measure how many times as far away metric depth shows the hand as it is given."""
    depth = DepthImages().of(it.clip)
    if depth is None or depth.source.scale != "metric":
        return np.nan
    from getagrip.fitting.depth_samples import hand_ratio_of, samples_of

    return hand_ratio_of(samples_of(it.clip, it.masks, depth, MOST[64]))


def is_of_another_unit(depth: Depth, samples: DepthSamples) -> bool:
    """Return whether metric depth shows the hand so far away, or so near, that it is not used."""
    from getagrip.fitting.depth_samples import hand_ratio_of

    return depth.source.scale == "metric" and bool(abs(np.log(hand_ratio_of(samples))) > np.log(UNIT))  # not of NaN


def around(it: Evidence) -> float:
    """Measure how many times as far away as the object what is around it is in depth images."""
    depth = DepthImages().of(it.clip)
    return np.nan if depth is None else behind_usually(depth, it.masks, it.clip.size)


def missing(it: Evidence) -> float:
    """Measure the share of the visible surface of object and hand that has no depth."""
    return _shares(it)[0]


def elsewhere(it: Evidence) -> float:
    """Measure the share of the surface's depth that is far behind or before the rest."""
    return _shares(it)[1]


def _shares(it: Evidence) -> tuple[float, float]:
    depth = DepthImages().of(it.clip)
    if depth is None:
        return np.nan, np.nan
    from getagrip.fitting.depth_samples import shares_of

    return shares_of(it.clip, it.masks, depth)


def misfit(it: Evidence) -> float:
    """Measure how far depth is off the surfaces that were found, its own scale and warp apart, in what it may err by.

    NaN of depth that is not used.
    """
    return _off(it)[0]


def warp(it: Evidence) -> float:
    """Measure how far depth is found to be warped over object and hand [share of the distance]; NaN as ``misfit``."""
    return _off(it)[1]


def _off(it: Evidence) -> tuple[float, float]:
    depth = DepthImages().of(it.clip)
    if depth is None or it.T_hand_obj is None:
        return np.nan, np.nan
    from getagrip.fitting.depth_samples import deviation_at, samples_of

    samples = samples_of(it.clip, it.masks, depth, MOST[128])
    if is_of_another_unit(depth, samples) or not samples.weight.any():
        return np.nan, np.nan
    return deviation_at(it.clip, samples, depth.source, it.T_hand_obj, it.scale)


class DepthImages(Modality[Depth]):
    """Distances of the object's and the hand's visible surface."""

    name = DEPTH
    input_checks = (
        Check(
            "depth-unit", hand_ratio, low=1.0 / UNIT, high=UNIT,
            fault="depth images show the hand {value} times as far away as it is given, and were not used",
            advice="check the depth's unit and scale, and the hand's distance",
        ),
        Check(
            "depth-inverse", around, low=INVERSE,
            fault="depth images show what is around the object {value} times as far away, and were not used",
            advice="are these disparities (inverse depth)? Import depth",
        ),
        Check(
            "depth-missing", missing, high=0.9, serious=False, shown=percent,
            fault="{value} of the visible surface of object and hand have no depth", advice="is it of this clip?",
        ),
        Check(
            "depth-elsewhere", elsewhere, high=0.25, serious=False, shown=percent,
            fault="{value} of the depth on object and hand is far behind or before the rest",
            advice="is it of this clip, aligned to its images and of the same field of view?",
        ),
    )  # fmt: skip
    result_checks = (
        Check(
            "depth-misfit",
            misfit,
            high=OFF,
            serious=False,
            fault="depth is off the surfaces that were found by {value} times what it may err by, and counted little",
            advice="is it of this clip? A wrong hand or mesh is off likewise",
        ),
        Check(
            "depth-warped",
            warp,
            high=WARPED,
            serious=False,
            shown=percent,
            fault="depth is warped by {value} over hand and object",
            advice="of a network's it was left out; is it of this clip, and of a network that knows such scenes?",
        ),
    )

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
        from getagrip.fitting.depth_samples import errors_of, samples_of
        from getagrip.fitting.energy.depth import DepthTerm, Solid

        clip, centre = problem.clip, problem.clip.mesh.centre

        @cache
        def samples(most: int) -> DepthSamples:
            return samples_of(clip, problem.masks, depth, most)

        inverse = behind_usually(depth, problem.masks, clip.size) < INVERSE
        if inverse or is_of_another_unit(depth, samples(MOST[64])):
            return None
        meshes = {level: decimate(clip.mesh, faces) for level, faces in FACES.items()}
        solids = {level: Solid.of(mesh.vertices[None] - centre, mesh.faces) for level, mesh in meshes.items()}
        hand = Solid.of(clip.hand.vertices, clip.hand.faces)
        errors, weight = errors_of(depth.source), WEIGHT * float(problem.observation.area.mean())

        def terms(level: int, index: Int[ndarray, "n"]) -> Sequence[Term]:
            some = samples(MOST[level]).take(index)
            return [DepthTerm(solids[level], hand.take(index), some, errors, weight)]

        return Terms(object=terms)
