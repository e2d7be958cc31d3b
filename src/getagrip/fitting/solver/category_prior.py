"""Priors on grasps, size and upright axis of an unmeasured object, known by its category only.

The package's own mesh of the category stands for an object that nobody has measured. Its search also starts from the
category's common grasps, turned about the object's upright axis, so that a handle is tried on every side of the hand.
Its size is drawn to the common size (``CategoryPrior.spread``), and its upright axis to its common direction in the
hand: a mug and a mug upside down have nearly the same silhouette. Vessels and bottles are seen from above: tilted away
from the camera or towards it, a bowl or a bottle has nearly the same silhouette.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.fitting.energy import Energy, InHand, PosesInCamera, Quadratic, Term
from getagrip.fitting.energy.handle_grip import finger_middles
from getagrip.fitting.motion import Fixed
from getagrip.fitting.problem import HALF_TURN_DISTANCE_RANGE, ObjectSurface, Problem
from getagrip.geometry import se3
from getagrip.hands.grips import CATEGORY_PRIORS, CategoryPrior
from getagrip.provenance import is_assumed

N_UPRIGHT_TURNS = 8
"""Turns of each grasp about the upright axis."""
CATEGORY_PRIOR_WEIGHT = 20.0
"""Energy of one standard deviation of size or tilt in each frame, times 1/2 [px^2]."""
HANDLE_TURN_RAD, MAX_HANDLE_DISTANCE_M = np.radians(30.0), 0.03
"""Turns of the grips of a handle, and the largest distance from it of a grip that holds it."""
TILT_SIGMA = 0.15
"""Standard deviation of a negative cosine to the common upright axis."""
SIDE_REFLECTIONS = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0])
"""Reflections: of the left hand's frame to the right's, and of an object whose handle points along x."""


def unmeasured_kind(clip: Clip) -> CategoryPrior | None:
    """Return the prior of an object's category, if shape and size of the object are unknown; else None."""
    unmeasured = clip.scale == "free" and is_assumed(clip.provenance.get("mesh"))
    return CATEGORY_PRIORS.get(clip.category) if unmeasured else None


def category_rotations(clip: Clip) -> Float[ndarray, "k 3 3"]:
    """Return rotations of an unmeasured object in the hand, of the most common grasps first; none of another."""
    kind = unmeasured_kind(clip)
    if kind is None:
        return np.zeros((0, 3, 3))
    grips = np.array([grip.R_hand_obj for grip in (*kind.grips, *kind.rarer)])
    about = se3.exp_so3(np.arange(N_UPRIGHT_TURNS)[:, None] * np.array([0.0, 0.0, 2.0 * np.pi / N_UPRIGHT_TURNS]))
    R = (grips[None] @ about[:, None]).reshape(-1, 3, 3)
    return R if clip.side == "right" else SIDE_REFLECTIONS[0] @ R @ SIDE_REFLECTIONS[1]


def handle_poses(problem: Problem, initial: Fixed) -> Fixed:
    """Return poses of an unmeasured object with the handle within the fingers, of the size that ``initial`` has.

    They are the usual grips of its handle, also turned by ``HANDLE_TURN_RAD`` about each axis; none without a handle.
    """
    kind, handle, fingers = unmeasured_kind(problem.clip), problem.handle, finger_middles(problem.clip.hand)
    if kind is None or handle is None or fingers is None:
        return initial.take(np.zeros(0, dtype=int))
    turns = se3.exp_so3(HANDLE_TURN_RAD * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]))
    R, held = np.zeros((0, 3, 3)), np.zeros((0, 3))
    for grip in kind.grips:
        away = np.linalg.norm(handle - (grip.at - problem.clip.mesh.centre), axis=1)
        if away.min() < MAX_HANDLE_DISTANCE_M:
            R = np.concatenate([R, grip.R_hand_obj @ turns])
            held = np.concatenate([held, np.tile(handle[away.argmin()], (len(turns), 1))])
    starts = initial.take(np.zeros(len(R), dtype=int))
    if problem.clip.side == "left":
        R = SIDE_REFLECTIONS[0] @ R @ SIDE_REFLECTIONS[1]
    middle = se3.transform(se3.inverse(problem.clip.hand.T_cam_hand), fingers).mean(axis=(0, 1))
    at = np.exp(starts.log_scale)[:, None] * (R @ held[..., None])[..., 0]
    return replace(starts, R=R, centre=middle - at)


def handle_half_turns(clip: Clip, surface: ObjectSurface) -> Float[ndarray, "k 3 3"]:
    """Return the half turn that swaps the sides of an unmeasured object's handle; none without a handle."""
    half = se3.exp_so3(np.array([[0.0, 0.0, np.pi]]))
    if unmeasured_kind(clip) is None or surface.moved_by(half)[0] < HALF_TURN_DISTANCE_RANGE[1]:
        return half[:0]
    return half


def opening_angle(clip: Clip, T_hand_obj: Float[ndarray, "T 4 4"]) -> float:
    """Measure the angle by which an unmeasured vessel's opening points away from the camera, median [degrees].

    NaN of all other objects.
    """
    kind = unmeasured_kind(clip)
    if kind is None or not kind.opens_up:
        return float("nan")
    T = clip.hand.T_cam_hand @ T_hand_obj
    away = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=-1, keepdims=True)
    return float(np.degrees(np.arcsin(np.clip(np.median(np.sum(T[:, :3, 2] * away, axis=-1)), -1.0, 1.0))))


@dataclass(frozen=True)
class SizeTerm:
    """``weight / 2 * (log(scale) / spread)^2`` in each frame."""

    spread: float
    weight: float = CATEGORY_PRIOR_WEIGHT
    name: str = "size"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found, off = Quadratic.zero(poses), np.log(poses.scale)[:, None]
        stiffness = self.weight / self.spread**2
        found.value[:] = 0.5 * stiffness * off**2
        found.g[..., 6], found.H[..., 6, 6] = stiffness * off, stiffness
        return found


@dataclass(frozen=True)
class UprightTerm:
    """``weight / 2 * (min(0, max over k of axis_k . R z) / TILT)^2``, z the object's upright axis.

    Called ``opening`` where the axis points to the camera.
    """

    axes: Float[ndarray, "N k 3"]
    """Common directions of z in the camera frame."""
    weight: float = CATEGORY_PRIOR_WEIGHT
    name: str = "upright"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        z = poses.R[..., 2]
        cosine = np.sum(z[:, :, None] * self.axes, axis=-1)
        nearest = cosine.argmax(axis=-1)
        axis = self.axes[np.arange(z.shape[1]), nearest]
        error = np.minimum(cosine.max(axis=-1), 0.0)
        J = np.zeros((*z.shape[:2], 1, 7))
        J[..., 0, 3:6] = np.where(error[..., None] < 0.0, np.cross(z, axis), 0.0)
        return Quadratic.of_squares(error[..., None], J, 0.5 * self.weight / TILT_SIGMA**2)


def category_energy(clip: Clip) -> Energy:
    """Return the terms on an unmeasured object's upright axis and size, and on a stated size that is free in the fit.

    No terms for other objects.
    """
    kind = unmeasured_kind(clip)
    spread = None if kind is None else kind.spread
    if clip.size_sigmas is not None:
        spread = float(np.hypot(*clip.size_sigmas))

    def terms(level: int, index: Int[ndarray, "n"]) -> list[Term]:
        if spread is None:
            return []
        size = SizeTerm(spread)
        if kind is None or not kind.opens_up:
            return [size]
        axes = category_rotations(clip)[: len(kind.grips), :, 2]
        in_camera = axes @ np.swapaxes(clip.hand.T_cam_hand[index, :3, :3], 1, 2)
        from_above = -clip.hand.T_cam_hand[index, None, :3, 3]
        from_above /= np.linalg.norm(from_above, axis=-1, keepdims=True)
        return [size, InHand(UprightTerm(in_camera)), InHand(UprightTerm(from_above, name="opening"))]

    return terms
