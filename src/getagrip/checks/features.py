"""Signs that a result is right or wrong: numbers that are known without ground truth.

Each is on a scale on which it is about linear in the logarithm of the odds that the result is right (``calibration``):
what may be many times larger in one clip than in another is a logarithm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.results import SolvedEvidence
from getagrip.clip.depth import DEPTH_KEY, Depth
from getagrip.geometry import se3

MIN_DISTINCT_DISTANCE = 0.03
"""A candidate that is farther apart than this is another solution [diameters]."""
MAX_ENERGY_GAP = 0.7
"""Largest energy gap, also where there is no other solution: logarithm of the factor between two energies."""
MAX_SOLUTION_DISTANCE = 0.5
"""A solution counts as at most so far [diameters]."""
MIN_SOLUTION_PROBABILITY = 1e-2
"""Solutions less probable than this do not count, each by the most probable one."""
UNSEEN_HAND_MISFIT = 0.4
"""Differing pixels of a hand of which none is seen."""
DEFAULT_JOINT_ERROR = 0.15
"""Error of a given hand's joints, where none are seen [shares of its box]."""
MIN_HAND_SPREAD = 0.01
"""Less of a hand's spread hardly counts [diameters]."""
MAX_CONTACT_GAP_M = 0.03
"""A region that does not touch counts as at most so far [m]."""


@dataclass(frozen=True)
class Feature:
    """Something that is known about a result."""

    name: str
    measure: Callable[[SolvedEvidence], float]
    direction: int
    """1: the more, the more probable is a right result; -1: the less probable."""


def energy_gap(it: SolvedEvidence) -> float:
    """Compare the energy of the best other solution: square root of the logarithm of the factor."""
    times = it.energy_times[it.apart > MIN_DISTINCT_DISTANCE]
    factor = np.log(times.min()) if len(times) else MAX_ENERGY_GAP
    return float(np.sqrt(np.clip(factor, 0.0, MAX_ENERGY_GAP)))


def solution_spread(it: SolvedEvidence) -> float:
    """Measure the spread of the other solutions, in diameters, weighted by the probability that each energy implies.

    Energies that differ by that of one frame count as a factor of e; solutions that are hardly probable do not count.
    """
    probable = np.exp(-(it.energy_times - 1.0) * len(it.clip))
    counts = np.flatnonzero(probable >= MIN_SOLUTION_PROBABILITY)
    off = np.array([min(it.vertices_apart(int(k)), MAX_SOLUTION_DISTANCE) for k in counts])
    return _log_offset(probable[counts] @ off / probable[counts].sum(), 3e-3)


def contact_gap(it: SolvedEvidence) -> float:
    """Measure the distance between regions of the hand and the object.

    It is the mean over regions and frames, in the object's diameters.
    """
    return _log_offset(np.clip(it.region_distance, 0.0, MAX_CONTACT_GAP_M).mean() / it.diameter, 3e-3)


def size_shift(it: SolvedEvidence) -> float:
    """Return the shift along the ray that the scale check implies, in the object's diameters.

    Nothing where its size was free.
    """
    centre = se3.transform(it.clip.hand.T_cam_hand @ it.poses, it.scale * it.clip.mesh.centre[None])
    away = np.linalg.norm(centre, axis=-1).mean()
    return _log_offset(np.nan_to_num(abs(it.scale_check[0] - 1.0)) * away / it.diameter, 0.02)


def seen_size(it: SolvedEvidence) -> float:
    """Measure how much of the object is seen: the side of a square of its mask's area at the hand, in its diameters."""
    focal = np.sqrt(it.clip.K[:, 0, 0] * it.clip.K[:, 1, 1])
    return _log_offset(np.median(np.sqrt(it.mask_area) * it.depth / focal) / it.diameter, 0.02)


def hand_misfit(it: SolvedEvidence) -> float:
    """Return the share of the hand's pixels that differ from its silhouette; where it is unknown, what is too much."""
    return _log_offset(float(np.nan_to_num(it.hand_differing, nan=UNSEEN_HAND_MISFIT)), 0.01)


def mean_penetration(it: SolvedEvidence) -> float:
    """Measure how deep the hand is in the object at the deepest, mean over frames, in its diameters."""
    return _log_offset(np.maximum(-it.to_object, 0.0).max(axis=1).mean() / it.diameter, 0.01)


def joint_error(it: SolvedEvidence) -> float:
    """Return the logarithm of the 2D joints' error, in shares of the hand's box; without joints, ``DEFAULT_JOINT_ERROR``'."""
    return _log_offset(float(np.nan_to_num(it.joint_error, nan=DEFAULT_JOINT_ERROR)), 0.01)


def depth_source_level(it: SolvedEvidence) -> float:
    """Return 0 without depth images, 1 with a network's, 2 with a sensor's."""
    depth = it.clip.evidence.get(DEPTH_KEY)
    return 0.0 if not isinstance(depth, Depth) else 2.0 if depth.source.source == "sensor" else 1.0


def _log_offset(value: float | Float[ndarray, ""], least: float) -> float:
    """Return the logarithm of a number that is never below zero, and hardly counts below ``least``."""
    return float(np.log(max(float(value), 0.0) + least))


FEATURES: tuple[Feature, ...] = (
    Feature("energy-gap", energy_gap, 1),
    Feature("solution-spread", solution_spread, -1),
    Feature("pose-spread", lambda it: _log_offset(it.spread, 1e-4), -1),  # that masks and contact leave [diameters]
    Feature("mask-misfit", lambda it: _log_offset(it.misfit, 0.05), -1),  # of ``fitting.stages.mesh_deformation``
    Feature("mesh-deformation", lambda it: it.deformed, -1),  # to meet the masks [diameters]
    Feature("size-shift", size_shift, -1),
    Feature("contact-gap", contact_gap, -1),
    Feature("depth-order", lambda it: _log_offset(np.nanmax(it.in_front), 0.01), -1),  # pixels with the other in front
    Feature("off-axis-turn", lambda it: _log_offset(it.off_axis, 5e-3), -1),  # besides that about the axis [rad]
    Feature(
        "hand-shift", lambda it: (it.hand_shift / it.diameter) ** 2, -1
    ),  # usual corrections succeed, large ones not
    Feature("hand-turn", lambda it: it.hand_turn**2, -1),  # by the refinement [rad]
    Feature("seen-size", seen_size, 1),
)
HAND_FEATURES: tuple[Feature, ...] = (
    Feature(
        "hand-spread", lambda it: _log_offset(it.hand_spread / it.diameter, MIN_HAND_SPREAD), -1
    ),  # that its evidence leaves
    Feature("hand-misfit", hand_misfit, -1),
    Feature("penetration", mean_penetration, -1),
    Feature("joint-error", joint_error, -1),
    Feature("depth-images", depth_source_level, 1),
)
"""Signs of the hand and of the evidence on it."""
ESTIMATED_FEATURE_NAMES = (
    "energy-gap", "solution-spread", "pose-spread", "mask-misfit", "contact-gap", "hand-turn",
    *(sign.name for sign in HAND_FEATURES),
)  # fmt: skip
ESTIMATED_FEATURES = tuple(sign for sign in (*FEATURES, *HAND_FEATURES) if sign.name in ESTIMATED_FEATURE_NAMES)
"""Signs that count where hands are estimated (``checks.calibration``): few, since more were worse for other objects."""


CORRECTED_FEATURES = (
    *FEATURES,
    *(sign for sign in HAND_FEATURES if sign.name in ("hand-spread", "hand-misfit", "penetration")),
)
"""Signs that count where a measured hand was corrected."""


def was_corrected(signs: Mapping[str, float]) -> bool:
    """Say whether a measured hand was solved with the object, since its evidence turned it far: its spread is not 0."""
    return signs.get("hand-spread", -np.inf) > np.log(MIN_HAND_SPREAD) + 1e-6


def compute_features(it: SolvedEvidence) -> dict[str, float]:
    """Compute every sign of a result, by its name; unknown ones are left out."""
    measured = {sign.name: float(sign.measure(it)) for sign in (*FEATURES, *HAND_FEATURES)}
    return {name: value for name, value in measured.items() if not np.isnan(value)}
