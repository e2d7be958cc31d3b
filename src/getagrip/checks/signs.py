"""Signs that a result is right or wrong: numbers that are known without ground truth.

Each is on a scale on which it is about linear in the logarithm of the odds that the result is right (``calibration``):
what may be many times larger in one clip than in another is a logarithm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks import mesh_form
from getagrip.checks.solved import Solved

ELSEWHERE = 0.03
"""A candidate that is farther apart than this is another solution [diameters]."""
LARGEST_GAP = 0.7
"""Where there is no other solution, and at most: logarithm of the factor between two energies."""
ALIKE = 0.1
"""Candidates count by exp(-(E - E_best) / (ALIKE E_best))."""
FARTHEST = 0.03
"""A region that does not touch counts as at most so far [m]."""


@dataclass(frozen=True)
class Sign:
    """Something that is known about a result."""

    name: str
    measure: Callable[[Solved], float]
    """NaN where it cannot be known."""
    direction: int
    """1: the more, the more probable is a right result, if it says anything; -1: the less probable; 0: not known
    beforehand."""
    meaning: str
    """What it is, in words."""


def energy_gap(it: Solved) -> float:
    """How much more energy the best other solution has: square root of the logarithm of the factor."""
    times = it.energy_times[it.apart > ELSEWHERE]
    factor = np.log(times.min()) if len(times) else LARGEST_GAP
    return float(np.sqrt(np.clip(factor, 0.0, LARGEST_GAP)))


def spread(it: Solved) -> float:
    """How far apart candidates are, weighted by their energies [diameters]."""
    weight = np.exp(-(it.energy_times - 1.0) / ALIKE)
    return float(weight @ it.apart / weight.sum())


def contact_gap(it: Solved) -> float:
    """How far regions of the hand are from the object, mean over regions and frames, in its diameters."""
    return _logarithm(np.clip(it.region_distance, 0.0, FARTHEST).mean() / it.diameter, 3e-3)


def contact_depth(it: Solved) -> float:
    """How deep they are in the object, likewise."""
    return _logarithm(np.maximum(-it.region_distance, 0.0).mean() / it.diameter, 3e-3)


def hand_overlap(it: Solved) -> float:
    """Overlap of the drawn hand and its own pixels; 0 where these are not known."""
    return 0.0 if np.isnan(it.hand_overlap) else it.hand_overlap


def view_range(it: Solved) -> float:
    """Largest rotation of the object before the camera between two frames [rad]."""
    R = (it.clip.hand.T_cam_hand @ it.poses)[:, :3, :3]
    cosine = (np.einsum("aij,bij->ab", R, R).min() - 1.0) / 2.0
    return _logarithm(float(np.arccos(np.clip(cosine, -1.0, 1.0))), 0.05)


def _miss(overlap: float) -> float:
    return _logarithm(1.0 - overlap, 1e-3)


def _logarithm(value: float | Float[ndarray, ""], least: float) -> float:
    """Of a number that is never below zero, and hardly counts below ``least``."""
    return float(np.log(max(float(value), 0.0) + least))


def _turned(it: Solved) -> float:
    return _logarithm(0.0 if it.axis is None else float(np.ptp(it.axis.angle)), 0.05)


SIGNS: tuple[Sign, ...] = (
    Sign("energy-gap", energy_gap, 1, "energy of the best other solution above that of the best"),
    Sign("spread", spread, -1, "distance between solutions of similar energy"),
    Sign("mask-miss", lambda it: _miss(float(np.nanmean(it.overlaps))), -1, "mean 1 - IOU"),
    Sign("worst-miss", lambda it: _miss(float(np.nanmin(it.overlaps))), -1, "1 - IOU of the worst frame"),
    Sign("contact-gap", contact_gap, -1, "distance of the hand's contact regions from the object"),
    Sign("contact-depth", contact_depth, 0, "depth of the hand's contact regions in the object"),
    Sign("off-axis-shift", lambda it: _logarithm(it.off_axis[0] / it.diameter, 2e-3), -1, "shifts besides the hinge"),
    Sign("off-axis-turn", lambda it: _logarithm(it.off_axis[1], 5e-3), -1, "turns besides the hinge"),
    Sign("turn-range", _turned, 0, "range of the angle about the axis"),
    Sign("hand-shift", lambda it: _logarithm(it.hand_moved[0] / it.diameter, 5e-3), -1, "how far the hand was moved"),
    Sign("hand-turn", lambda it: _logarithm(it.hand_moved[1], 0.02), -1, "how far the hand was turned"),
    Sign("hand-overlap", hand_overlap, 1, "overlap of the hand with its own pixels"),
    Sign("no-hand-pixels", lambda it: float(np.isnan(it.hand_overlap)), -1, "1 where the hand's pixels are not given"),
    Sign("scale-free", lambda it: float(it.clip.scale == "free"), -1, "1 where the object's size is not known"),
    Sign("object-size", lambda it: _logarithm(it.diameter / it.hand_size, 0.01), 0, "size of the object by the hand's"),
    Sign("pixels", lambda it: _logarithm(np.sqrt(it.mask_area.mean()), 1.0), 1, "root of the masks' mean area"),
    Sign("view-range", view_range, 1, "how much the object turns before the camera"),
    Sign("thickness", lambda it: float(mesh_form.extents(it.clip.mesh)[0]), 0, "least by largest extent of the mesh"),
    Sign("width", lambda it: float(mesh_form.extents(it.clip.mesh)[1]), 0, "middle by largest extent of the mesh"),
)


def read_signs(it: Solved) -> dict[str, float]:
    """Every sign of a result, by its name."""
    return {sign.name: float(sign.measure(it)) for sign in SIGNS}
