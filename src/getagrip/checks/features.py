"""Features of a result from which its probability of being right is calibrated; no feature needs ground truth.

``result.json`` and docs/checks.md call them signs. Each is scaled to be about linear in the logarithm of the odds of a
right result (``calibration``): quantities that vary by large factors between clips are logarithms.
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
"""Distance of a candidate from the first above which it is another solution [diameters]."""
MAX_ENERGY_GAP = 0.7
"""Maximum logarithm of the ratio of two energies, and its value without another solution."""
MAX_SOLUTION_DISTANCE = 0.5
"""Maximum distance at which a solution counts [diameters]."""
MIN_SOLUTION_PROBABILITY = 1e-2
"""Probability, relative to the best solution, below which a solution is ignored."""
UNSEEN_HAND_MISFIT = 0.4
"""Fraction of differing pixels that is assumed for a hand without visible pixels."""
DEFAULT_JOINT_ERROR = 0.15
"""Error that is assumed for the joints of a hand without 2D joints [fractions of the hand's box]."""
MIN_HAND_SPREAD = 0.01
"""Spread of a hand below which differences hardly count [diameters]."""
MAX_CONTACT_GAP_M = 0.03
"""Maximum distance at which a region counts [m]."""


@dataclass(frozen=True)
class Feature:
    """A feature of a result.

    Attributes:
        name: its key in ``result.json``.
        measure: its value.
        direction: 1 if larger values make a right result more probable, -1 if less.
    """

    name: str
    measure: Callable[[SolvedEvidence], float]
    direction: int


def energy_gap(it: SolvedEvidence) -> float:
    """Compute the square root of the logarithm of the best other solution's energy, relative to the least."""
    times = it.energy_times[it.apart > MIN_DISTINCT_DISTANCE]
    factor = np.log(times.min()) if len(times) else MAX_ENERGY_GAP
    return float(np.sqrt(np.clip(factor, 0.0, MAX_ENERGY_GAP)))


def solution_spread(it: SolvedEvidence) -> float:
    """Compute the mean distance of all solutions [diameters], weighted by the probability that each energy implies.

    Energies that differ by one frame's energy differ by a factor of e in probability.
    """
    probable = np.exp(-(it.energy_times - 1.0) * len(it.clip))
    counts = np.flatnonzero(probable >= MIN_SOLUTION_PROBABILITY)
    off = np.array([min(it.vertices_apart(int(k)), MAX_SOLUTION_DISTANCE) for k in counts])
    return _log_offset(probable[counts] @ off / probable[counts].sum(), 3e-3)


def contact_gap(it: SolvedEvidence) -> float:
    """Compute the distance of the hand's contact regions from the object [diameters], mean over regions and frames."""
    return _log_offset(np.clip(it.region_distance, 0.0, MAX_CONTACT_GAP_M).mean() / it.diameter, 3e-3)


def size_shift(it: SolvedEvidence) -> float:
    """Compute the shift along the ray that the scale check implies [diameters]; 0 where the scale was not checked."""
    centre = se3.transform(it.clip.hand.T_cam_hand @ it.poses, it.scale * it.clip.mesh.centre[None])
    away = np.linalg.norm(centre, axis=-1).mean()
    return _log_offset(np.nan_to_num(abs(it.scale_check[0] - 1.0)) * away / it.diameter, 0.02)


def seen_size(it: SolvedEvidence) -> float:
    """Compute the side of a square of the mask's area, at the hand's distance [diameters]."""
    focal = np.sqrt(it.clip.K[:, 0, 0] * it.clip.K[:, 1, 1])
    return _log_offset(np.median(np.sqrt(it.mask_area) * it.depth / focal) / it.diameter, 0.02)


def hand_misfit(it: SolvedEvidence) -> float:
    """Return the fraction of the hand's pixels that differ from its silhouette; ``UNSEEN_HAND_MISFIT`` if unknown."""
    return _log_offset(float(np.nan_to_num(it.hand_differing, nan=UNSEEN_HAND_MISFIT)), 0.01)


def mean_penetration(it: SolvedEvidence) -> float:
    """Compute the depth of the hand's deepest point in the object [diameters], mean over frames."""
    return _log_offset(np.maximum(-it.to_object, 0.0).max(axis=1).mean() / it.diameter, 0.01)


def joint_error(it: SolvedEvidence) -> float:
    """Return the error of the hand's 2D joints [fractions of its box]; without joints, ``DEFAULT_JOINT_ERROR``."""
    return _log_offset(float(np.nan_to_num(it.joint_error, nan=DEFAULT_JOINT_ERROR)), 0.01)


def depth_source_level(it: SolvedEvidence) -> float:
    """Return the source of depth images: 0 for none, 1 for a network, 2 for a sensor."""
    depth = it.clip.evidence.get(DEPTH_KEY)
    return 0.0 if not isinstance(depth, Depth) else 2.0 if depth.source.source == "sensor" else 1.0


def _log_offset(value: float | Float[ndarray, ""], least: float) -> float:
    """Logarithm of a number of at least 0, with an offset: below ``least`` differences hardly count."""
    return float(np.log(max(float(value), 0.0) + least))


FEATURES: tuple[Feature, ...] = (
    Feature("energy-gap", energy_gap, 1),
    Feature("solution-spread", solution_spread, -1),
    Feature("pose-spread", lambda it: _log_offset(it.spread, 1e-4), -1),  # left by masks and contact [diameters]
    Feature("mask-misfit", lambda it: _log_offset(it.misfit, 0.05), -1),  # ``fitting.stages.mesh_deformation``
    Feature("mesh-deformation", lambda it: it.deformed, -1),  # towards the masks [diameters]
    Feature("size-shift", size_shift, -1),
    Feature("contact-gap", contact_gap, -1),
    Feature("depth-order", lambda it: _log_offset(np.nanmax(it.in_front), 0.01), -1),  # pixels with the other in front
    Feature("off-axis-turn", lambda it: _log_offset(it.off_axis, 5e-3), -1),  # besides the axis's angle [rad]
    Feature("hand-shift", lambda it: (it.hand_shift / it.diameter) ** 2, -1),  # small corrections usually succeed
    Feature("hand-turn", lambda it: it.hand_turn**2, -1),  # by the refinement [rad]
    Feature("seen-size", seen_size, 1),
)
HAND_FEATURES: tuple[Feature, ...] = (
    Feature("hand-spread", lambda it: _log_offset(it.hand_spread / it.diameter, MIN_HAND_SPREAD), -1),
    Feature("hand-misfit", hand_misfit, -1),
    Feature("penetration", mean_penetration, -1),
    Feature("joint-error", joint_error, -1),
    Feature("depth-images", depth_source_level, 1),
)
"""Features of the hand and of the evidence on it."""
_ESTIMATED = ("energy-gap", "solution-spread", "pose-spread", "mask-misfit", "contact-gap", "hand-turn")
ESTIMATED_FEATURES = (*(feature for feature in FEATURES if feature.name in _ESTIMATED), *HAND_FEATURES)
"""Features of results with estimated hands (``checks.calibration``): few, since more were worse for other objects."""


LIFTED_FEATURES = (
    *ESTIMATED_FEATURES,
    Feature("distance-spread", lambda it: _log_offset(it.distance_spread, 0.01), -1),  # by sizes and depth [diameters]
    Feature("shape-assumed", lambda it: float(it.shape_assumed), -1),
)
"""Features of results with hands that were lifted from 2D joints, whose size is assumed."""
_CORRECTED = ("hand-spread", "hand-misfit", "penetration")
CORRECTED_FEATURES = (*FEATURES, *(feature for feature in HAND_FEATURES if feature.name in _CORRECTED))
"""Features of results with corrected measured hands."""


def was_corrected(signs: Mapping[str, float]) -> bool:
    """Return whether a measured hand was solved jointly with the object, as its spread shows: it is not 0."""
    return signs.get("hand-spread", -np.inf) > np.log(MIN_HAND_SPREAD) + 1e-6


def compute_features(it: SolvedEvidence) -> dict[str, float]:
    """Compute all known features of a result, by name."""
    measured = {feature.name: float(feature.measure(it)) for feature in {*FEATURES, *LIFTED_FEATURES}}
    return {name: value for name, value in measured.items() if not np.isnan(value)}
