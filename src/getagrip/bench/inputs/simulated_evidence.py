"""Simulate depth and 2D joints from the ground truth, with errors of sensors and networks.

Depth has an unknown scale, smooth errors over hand and object that are mostly constant over frames, a relief that is
too flat or too deep, a hand shifted against the object, white noise and holes. The sizes of the errors are assumed.

2D joints have an error that is constant over the clip, one per frame, both relative to the hand's box and larger where
the object hides the joint, and outliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.bench.inputs.perturbations import Change
from getagrip.clip import Clip, Masks
from getagrip.clip.depth import DEPTH_KEY, N_WINDOW_SAMPLES, Depth, DepthSource, sampling_windows
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.rasterize import depth_and_face

CONSTANT_VARIANCE_FRACTION = 0.7
"""Fraction of the smooth errors' variance that is constant over frames."""
SMOOTH_NOISE_GRID = 4
"""Number of random values along a side of the window, between which smooth errors are interpolated."""


@dataclass(frozen=True)
class SimulatedDepthErrors:
    """Errors of depth images.

    Attributes:
        source: maker of the images.
        clip_scale: standard deviation of the log scale of a clip's depth.
        frame_scale: standard deviation of the log scale of each frame's depth.
        relief: standard deviation of the relative error of the relief of hand and object.
        smooth: root mean square of smooth errors [m].
        apart: standard deviation of the hand's shift against the object [m].
        white: standard deviation of the noise of each pixel [m].
        holes: fraction of pixels without depth.
        warped: amplitude of a linear ramp over the window, relative to the distance: a gross error.
    """

    source: Literal["sensor", "network"]
    clip_scale: float
    frame_scale: float = 0.0
    relief: float = 0.0
    smooth: float = 0.0
    apart: float = 0.0
    white: float = 0.0
    holes: float = 0.0
    warped: float = 0.0


DEPTH_ERROR_LEVELS = {
    "realsense": SimulatedDepthErrors("sensor", clip_scale=0.003, smooth=0.002, white=0.002, holes=0.25),
    "mono": SimulatedDepthErrors("network", clip_scale=0.06, frame_scale=0.01, relief=0.15, smooth=0.006, apart=0.006),
    "mono-bad": SimulatedDepthErrors(
        "network", clip_scale=0.10, frame_scale=0.03, relief=0.30, smooth=0.012, apart=0.012
    ),
    "mono-warped": SimulatedDepthErrors(
        "network", clip_scale=0.06, frame_scale=0.01, relief=0.15, smooth=0.006, apart=0.006, warped=0.3
    ),
}
"""Levels of errors, by name."""


@dataclass(frozen=True)
class SimulatedDepth(Change):
    """Adds depth images of the true hand and object, with the errors of a level of ``DEPTH_ERROR_LEVELS``."""

    level: str

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        if clip.truth is None:
            raise InputError(clip.origin / "truth.npz", "", "no ground truth", "poses at which to simulate depth")
        rng = np.random.default_rng([seed, *b"depth", *clip.name.encode()])
        depth = simulate_depth(clip, masks, DEPTH_ERROR_LEVELS[self.level], rng)
        return replace(clip, evidence={**clip.evidence, DEPTH_KEY: depth}), masks


def simulate_depth(clip: Clip, masks: Masks, errors: SimulatedDepthErrors, rng: np.random.Generator) -> Depth:
    """Simulate the depth images of a clip with ground truth."""
    truth = clip.truth
    assert truth is not None
    corner, stride = sampling_windows(clip, masks, clip.size)
    source = DepthSource("metric", errors.source)
    seen = Depth(np.zeros((len(clip), N_WINDOW_SAMPLES, N_WINDOW_SAMPLES)), corner, stride, clip.size, source)
    hands = se3.transform(truth.T_cam_hand, truth.hand_vertices)
    grasped = se3.transform(truth.T_cam_obj, truth.scale * clip.mesh.vertices)
    z, constant = seen.z.copy(), _draw_smooth_field(rng)
    relief, apart = _draw_normal(rng, errors.relief), _draw_normal(rng, errors.apart)
    warp = errors.warped * rng.choice([-1.0, 1.0]) * _linear_ramp(rng.uniform(0.0, 2.0 * np.pi))
    scale = np.exp(_draw_normal(rng, errors.clip_scale))
    for n, K in enumerate(seen.intrinsics(clip)):
        surfaces = ((grasped[n], clip.mesh.faces), (hands[n], clip.hand.faces))
        depths = [depth_and_face(*surface, K, (N_WINDOW_SAMPLES, N_WINDOW_SAMPLES))[0] for surface in surfaces]
        true = np.minimum(*depths).astype(float)
        shown = np.isfinite(true)
        middle = float(true[shown].mean()) if shown.any() else 1.0
        true[~shown] = 1.5 * middle
        error = errors.smooth * (
            np.sqrt(CONSTANT_VARIANCE_FRACTION) * constant
            + np.sqrt(1.0 - CONSTANT_VARIANCE_FRACTION) * _draw_smooth_field(rng)
        )
        error += relief * np.where(shown, true - middle, 0.0) + apart * (depths[1] < depths[0])
        error += rng.normal(scale=errors.white, size=true.shape)
        holes = np.zeros_like(shown)
        if errors.holes:
            holes = _draw_smooth_field(rng) < np.quantile(_draw_smooth_field(rng), errors.holes)
        frame_scale = np.exp(_draw_normal(rng, errors.frame_scale))
        z[n] = np.where(holes, 0.0, scale * frame_scale * (true + error) * (1.0 + warp))
    return replace(seen, z=z)


def _draw_normal(rng: np.random.Generator, scale: float) -> float:
    return float(rng.normal(scale=scale))


def _draw_smooth_field(rng: np.random.Generator) -> Float[ndarray, "n n"]:
    """Draw a smooth field over a window, of unit variance."""
    coarse = rng.normal(size=(SMOOTH_NOISE_GRID, SMOOTH_NOISE_GRID))
    field = cv2.resize(coarse, (N_WINDOW_SAMPLES, N_WINDOW_SAMPLES), interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / field.std())


def _linear_ramp(angle: float) -> Float[ndarray, "n n"]:
    """Return a field that is linear across a window, from -1 to 1 along x and y weighted by the angle's cos and sin."""
    x = np.linspace(-1.0, 1.0, N_WINDOW_SAMPLES)
    return np.cos(angle) * x + np.sin(angle) * x[:, None]


@dataclass(frozen=True)
class SimulatedJointErrors:
    """Errors of 2D joints, as standard deviations along each axis relative to the hand's box.

    Attributes:
        own: error of a joint in a frame.
        lasting: error of a joint in all frames of the clip.
        together: shift of all joints of a frame.
        hidden: factor on the errors of a joint behind the object.
        palm: factor on the errors of wrist and knuckles.
        outliers: fraction of joints shifted by up to half a box.
        mistake: a gross error of all joints.
    """

    own: float
    lasting: float
    together: float = 0.0
    hidden: float = 2.5
    palm: float = 1.0
    outliers: float = 0.0
    mistake: Literal["", "other hand", "shifted camera"] = ""


JOINT_ERROR_LEVELS = {
    "lab": SimulatedJointErrors(0.02, 0.02),
    "wild": SimulatedJointErrors(0.035, 0.035, outliers=0.05),
    "landmarks": SimulatedJointErrors(0.032, 0.032, together=0.028, palm=1.8, outliers=0.1),
    "other hand": SimulatedJointErrors(0.02, 0.02, mistake="other hand"),
    "shifted camera": SimulatedJointErrors(0.02, 0.02, mistake="shifted camera"),
}
"""Levels of errors, by name. ``landmarks`` has our detector's errors on real images (``results/landmark-errors.json``),
half of them assumed constant over a clip; ``lab`` and ``wild`` are assumed."""
PALM_JOINTS = [0, 1, 5, 9, 13, 17]
"""Indices of wrist and knuckles."""
N_JOINT_VERTICES = 40
"""Number of vertices nearest to a joint that define its motion."""


@dataclass(frozen=True)
class SimulatedJoints(Change):
    """Adds 2D joints of the true hand, with the errors of a level of ``JOINT_ERROR_LEVELS``."""

    level: str

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        if clip.truth is None or clip.hand.joints is None:
            raise InputError(clip.origin / "truth.npz", "", "no ground truth", "a true hand, whose joints are seen")
        rng = np.random.default_rng([seed, *b"joints", *clip.name.encode()])
        points = simulate_joints_2d(clip, masks, JOINT_ERROR_LEVELS[self.level], rng)
        hand = replace(clip.hand, joints_2d=points, joints_2d_confidence=np.ones(points.shape[:2]))
        return replace(clip, hand=hand), masks


def simulate_joints_2d(
    clip: Clip, masks: Masks, errors: SimulatedJointErrors, rng: np.random.Generator
) -> Float[ndarray, "T 21 2"]:
    """Simulate detected 2D joints of the true hand [px]."""
    points = project(clip.K, true_joints(clip))
    hidden, size = _is_hidden_by_object(masks, points), np.ptp(points, axis=1).max(axis=-1)[:, None, None]
    off = errors.own * rng.normal(size=points.shape) + errors.lasting * rng.normal(size=points.shape[1:])
    off[hidden] *= errors.hidden
    off[:, PALM_JOINTS] *= errors.palm
    far = rng.random(hidden.shape) < errors.outliers
    off[far] += rng.uniform(-0.5, 0.5, (np.count_nonzero(far), 2))
    off += errors.together * rng.normal(size=(len(points), 1, 2))
    if errors.mistake == "other hand":
        middle, angle = points.mean(axis=1, keepdims=True), rng.uniform(0.0, 2.0 * np.pi)
        points = middle + [-1.0, 1.0] * (points - middle) + size * [np.cos(angle), np.sin(angle)]
    if errors.mistake == "shifted camera":
        points = points + 0.1 * np.array(clip.size)
    return np.asarray(points + size * off)


def true_joints(clip: Clip) -> Float[ndarray, "T 21 3"]:
    """Return the joints of the true hand in the camera frame [m]; each moves rigidly with its nearest vertices."""
    truth, joints = clip.truth, clip.hand.joints
    assert truth is not None
    assert joints is not None
    found = np.empty_like(joints)
    for j in range(joints.shape[1]):
        distance = np.linalg.norm(clip.hand.vertices - joints[:, j, None], axis=-1).mean(axis=0)
        near = np.argsort(distance)[:N_JOINT_VERTICES]
        given, true = clip.hand.vertices[:, near], truth.hand_vertices[:, near]
        a, b = given.mean(axis=1, keepdims=True), true.mean(axis=1, keepdims=True)
        R = se3.nearest_rotation(np.swapaxes(true - b, 1, 2) @ (given - a))
        found[:, j] = b[:, 0] + (R @ (joints[:, j] - a[:, 0])[..., None])[..., 0]
    return np.asarray(se3.transform(truth.T_cam_hand, found))


def _is_hidden_by_object(masks: Masks, points: Float[ndarray, "T 21 2"]) -> Bool[ndarray, "T 21"]:
    height, width = masks.object.shape[1:]
    places = np.clip(points, 0.0, [width - 1, height - 1]).astype(int)
    return np.stack([mask[at[:, 1], at[:, 0]] for mask, at in zip(masks.object, places, strict=True)])
