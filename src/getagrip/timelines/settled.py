"""A grasp's object as far away as its masks say, and the hand with it.

One image hardly tells how far away a hand is: from frame to frame its depth errs by a centimetre, and so does an object
that goes with it. The size of the object's masks, and a motion that does not jump, know better. The hand goes along the
camera's ray as far as the object does, so that contact stays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip.timeline import Side
from getagrip.fitting.misfit import relative_contour_error, stiffen_ridge
from getagrip.fitting.motion import Fixed, Frozen, Soft
from getagrip.fitting.objective import object_evidence_energy
from getagrip.fitting.problem import Problem
from getagrip.fitting.solve import minimise, poses_in_camera
from getagrip.geometry import se3
from getagrip.timelines.between import world_smoothness_term
from getagrip.timelines.motion import TimelineMotion

REFERENCE_DEPTH_JITTER_M, MIN_DEPTH_JITTER_M = 0.01, 0.001
"""Jitter of depth at which deviations are as stiff as ``HINGE_DEVIATION_RIDGE`` says, and below which nothing moves [m]."""
MAX_MOTION_CHANGE_M = 0.01
"""Motion that changes by more between frames: they are too far apart to tell it from jitter [m]."""
HINGE_DEVIATION_RIDGE = (1e5, 1e4)
"""Stiffness of a frame's deviation from the hinge in the hand [px^2 per m^2, per rad^2]: what is hidden stays there.

It is more where the hand jitters less, by the square: such a hand is right about depth, which masks that are half
hidden may not tell. Where the masks are met worse than the object's own mesh would, it is stiffer (``relative_contour_error``).
"""
DEPTH_CORRECTION_STAGES = ((128, 6), (256, 4), (256, 4))
"""Resolution [px] and iterations; before the last, it is known how well masks are met."""


def correct_depth(motion: TimelineMotion, problem: Problem, seen: Int[ndarray, "n"], side: Side, jitter: float) -> None:
    """Move object and hand of ``side`` in the frames of a grasp that show the object, which the problem is at.

    ``jitter`` is that of their depth [m].
    """
    before, centre, everywhere = motion.places(seen), motion.centre, np.arange(len(seen))
    times = max(1.0, REFERENCE_DEPTH_JITTER_M / jitter) ** 2
    ridge = HINGE_DEVIATION_RIDGE[0] * times, HINGE_DEVIATION_RIDGE[1] * times
    T_cam = se3.rigid(motion.T_cam_obj[seen, :3, :3], before)
    still = Fixed(np.eye(3)[None], np.zeros((1, 3)), np.zeros(1), len(seen))
    frozen, misfits = Frozen(Soft(still, np.zeros((1, len(seen), 6)), ridge)), 1.0
    energy, smooth = object_evidence_energy(problem), world_smoothness_term(problem)
    for level, iterations in DEPTH_CORRECTION_STAGES:
        frozen = Frozen(replace(frozen.core, ridge=stiffen_ridge(ridge, misfits)))
        found = minimise(frozen, [*energy(level, everywhere), smooth], T_cam, iterations)
        frozen = found.motion
        if level == DEPTH_CORRECTION_STAGES[-1][0]:
            misfits = relative_contour_error(problem.observation, float(found.terms["mask"][0]) / len(seen))
    poses = poses_in_camera(frozen, T_cam)
    moved = np.sum((poses.centre[0] - before) * before, axis=1) / np.sum(before**2, axis=1)
    motion.T_cam_obj[seen] = se3.rigid(poses.R[0], poses.centre[0] - poses.R[0] @ centre)
    hand = motion.T_cam_hands[side]
    hand[seen] = se3.rigid(None, moved[:, None] * before) @ hand[seen]


def depth_jitter(places: Float[ndarray, "n 3"]) -> float:
    """Estimate the standard deviation of errors of depth that differ between frames [m].

    Places are in the camera frame.

    Second differences show errors that remember a tenth of a second nearly in full. Motion has its share in them, which
    is as large across the ray: what they have along the ray beyond that is jitter. 0 for fewer than 3 frames.
    """
    if len(places) < 3:
        return 0.0
    ray = places[1:-1] / np.linalg.norm(places[1:-1], axis=1, keepdims=True)
    second = np.diff(places, 2, axis=0)
    along = np.sum(second * ray, axis=1)
    across = np.linalg.norm(second - along[:, None] * ray, axis=1) / np.sqrt(2.0)
    if np.median(across) > MAX_MOTION_CHANGE_M:
        return 0.0
    excess = np.median(np.abs(along)) ** 2 - np.median(across) ** 2
    return 1.48 * float(np.sqrt(max(excess, 0.0)))
