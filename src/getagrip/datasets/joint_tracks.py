"""Motion capture as joints: one or two hands and an object in a world frame become tracks, the generic hand fitted.

Joints are what most recordings have and may give away. They do not determine a hand's surface: that of the fitted hand
is off by a few millimetres, so contacts at 0 mm depend on it more than on the grasp. For recordings without a camera
one is assumed that stands still where the person's eyes could be: every number of it is a guess.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import HandTrack, Joint, World
from getagrip.datasets.tracks import Track
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands import generic
from getagrip.hands.fit import fit_joints
from getagrip.hands.model import HandModel, Side, hand_track
from getagrip.provenance import Provenance, Source, assumed, estimated

ASSUMED_CAMERA_DISTANCE_M = 0.7
"""Distance of the assumed camera from the object's usual place [m]: about an arm's length."""
ASSUMED_CAMERA_ELEVATION_RAD = np.radians(45.0)
"""How steeply it looks down [rad]."""
ASSUMED_IMAGE_SIZE_PX = (840, 600)
"""Width and height of its images [px], those of this package's ARCTIC masks."""
ASSUMED_FOCAL_PX = 600.0
"""Its focal length [px]: it sees 70 by 53 degrees."""
MIDDLE_KNUCKLE = 9
"""Among the 21 joints; the wrist is the first."""


@dataclass(frozen=True)
class HandObjectMotion:
    """Joints of the hands, and the object, in every frame of a sequence."""

    file: Path
    """File that it was read from."""
    subject: str
    sequence: str
    category: str
    fps: float
    numbers: Int[ndarray, "T"]
    """Numbers of the frames, rising."""
    joints: dict[Side, Float[ndarray, "T 21 3"]]
    """In the world frame [m], in this package's order; one hand or both."""
    T_world_obj: Float[ndarray, "T 4 4"]
    mesh: Mesh
    """The object; where it has a joint, at ``joint.angle``."""
    provenance: Provenance
    """Sources of all of it."""
    joint: Joint | None = None
    """Joint of the object, where it has one."""
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the joint [rad]."""
    camera: PosedCamera | None = None
    """One is assumed where it is not known; then z is up in the world frame."""
    estimated: dict[Side, Float[ndarray, "T 21 3"]] = field(default_factory=dict)
    """The joints as an estimator found them: clips are given hands that are fitted to these."""


def motion_tracks(motion: HandObjectMotion) -> Iterator[Track]:
    """Yield the object in each hand. Raises ``InputError`` where joints are no hand's."""
    fitted = {side: fit_hand(motion.file, f"{side} joints", side, j) for side, j in motion.joints.items()}
    camera, up = motion.camera, None
    if camera is None:
        up = np.array([0.0, 0.0, 1.0])
        places = se3.transform(motion.T_world_obj, motion.mesh.centre[None])[:, 0]
        camera = assumed_camera(places, motion.joints.values())
    hands = {side: hand_to_camera(hand.track, camera.T_cam_world) for side, hand in fitted.items()}
    for side, hand in hands.items():
        described = "the generic hand, fitted to the true 21 joints over all frames: not the true surface"
        provenance = motion.provenance | {"hands": described, "hand_fit": _describe_hand_fit(fitted[side])}
        input_hand = None
        if side in motion.estimated:
            value = fit_hand(motion.file, f"estimated {side} joints", side, motion.estimated[side])
            input_hand = hand_to_camera(value.track, camera.T_cam_world)
            provenance["truth"] = f"{described}; {_describe_hand_fit(fitted[side])}"
            provenance["hands"] = estimated("the generic hand, fitted to 21 joints that were estimated")
            provenance["hand_fit"] = _describe_hand_fit(value)
        yield Track(
            file=motion.file,
            subject=motion.subject,
            sequence=motion.sequence,
            category=motion.category,
            side=side,
            fps=motion.fps,
            numbers=motion.numbers,
            digits=6,
            size=camera.size,
            K=camera.K,
            hand=hand,
            T_cam_obj=camera.T_cam_world @ motion.T_world_obj,
            mesh=motion.mesh,
            joint=motion.joint,
            articulation=motion.articulation,
            other_hand=next((other for of, other in hands.items() if of != side), None),
            world=World(se3.inverse(camera.T_cam_world), up),
            input_hand=input_hand,
            provenance=provenance | {"camera": camera.described},
        )


def _describe_hand_fit(hand: FittedHand) -> str:
    """How well a hand fits, in words."""
    return describe_fit(hand.residuals) + ", over the sequence"


def hand_to_camera(hand: HandTrack, T_cam_world: Float[ndarray, "T 4 4"]) -> HandTrack:
    """Transform a hand from the world frame to a camera's."""
    return replace(hand, T_cam_hand=T_cam_world @ hand.T_cam_hand)


@dataclass(frozen=True)
class PosedCamera:
    """A pinhole that may move."""

    K: Float[ndarray, "3 3"]
    size: tuple[int, int]
    T_cam_world: Float[ndarray, "T 4 4"]
    described: Source
    """Description for the provenance."""


def assumed_camera(places: Float[ndarray, "T 3"], hands: Iterable[Float[ndarray, "T 21 3"]]) -> PosedCamera:
    """Place a fixed camera that looks at the median of an object's places from the side from which the forearms come.

    ``hands`` are joints in this package's order. All is in the world frame [m], where z is up.
    """
    up = np.array([0.0, 0.0, 1.0])
    behind = np.concatenate([joints[:, 0] - joints[:, MIDDLE_KNUCKLE] for joints in hands]).mean(axis=0)
    behind -= (behind @ up) * up
    if np.linalg.norm(behind) < 1e-6:  # hands that point straight up or down: from anywhere
        behind = np.array([1.0, 0.0, 0.0])
    behind /= np.linalg.norm(behind)
    z = -(np.cos(ASSUMED_CAMERA_ELEVATION_RAD) * behind + np.sin(ASSUMED_CAMERA_ELEVATION_RAD) * up)
    x = np.cross(z, up) / np.cos(ASSUMED_CAMERA_ELEVATION_RAD)
    side = f"on the forearms' side, {np.degrees(ASSUMED_CAMERA_ELEVATION_RAD):.0f} degrees above it"
    return camera_facing_object(np.stack([x, np.cross(z, x), z]), places, f"a guess: none is given; fixed, {side}")


def camera_facing_object(
    R_cam_world: Float[ndarray, "3 3"], places: Float[ndarray, "T 3"], described: str
) -> PosedCamera:
    """Place a fixed camera of some orientation that looks at the median of an object's places [m] from ``ASSUMED_CAMERA_DISTANCE_M``."""
    T_cam_world = se3.rigid(
        R_cam_world, [0.0, 0.0, ASSUMED_CAMERA_DISTANCE_M] - R_cam_world @ np.median(places, axis=0)
    )
    K, size = assumed_pinhole()
    described += (
        f", {ASSUMED_CAMERA_DISTANCE_M:g} m from the object's median place, focal length {ASSUMED_FOCAL_PX:g} px"
    )
    return PosedCamera(K, size, np.tile(T_cam_world, (len(places), 1, 1)), assumed(described))


def assumed_pinhole() -> tuple[Float[ndarray, "3 3"], tuple[int, int]]:
    """Return the camera's intrinsics, and the size of its images [px]."""
    return np.array(
        [
            [ASSUMED_FOCAL_PX, 0.0, ASSUMED_IMAGE_SIZE_PX[0] / 2.0],
            [0.0, ASSUMED_FOCAL_PX, ASSUMED_IMAGE_SIZE_PX[1] / 2.0],
            [0.0, 0.0, 1.0],
        ]
    ), ASSUMED_IMAGE_SIZE_PX


@dataclass(frozen=True)
class FittedHand:
    """The generic hand in every frame, of one shape."""

    track: HandTrack
    """Its poses are in the frame that the joints were in."""
    residuals: Float[ndarray, "T 21"]
    """Distances of its joints from the true ones [m]."""


def fit_hand(file: Path, key: str, side: Side, joints: Float[ndarray, "T 21 3"]) -> FittedHand:
    """Fit the generic hand to joints [m] in this package's order, those of ``key`` in a file.

    Raises ``InputError`` where they are no hand's.
    """
    model = generic.load(side)
    try:
        fit = fit_joints(model, joints, "openpose")
    except UsageError as error:
        raise InputError(file, key, str(error), "the 21 joints of a hand") from error
    posed = model.with_shape(_normalise_girth(model, fit.shape, joints)).with_pose(fit.pose)
    track = hand_track(posed, fit.hand.T_cam_hand)
    return FittedHand(track, np.linalg.norm(se3.transform(track.T_cam_hand, posed.joints) - joints, axis=-1))


def describe_fit(residuals: Float[ndarray, "T 21"]) -> str:
    """Describe how well a hand fits, by distances of joints [m]."""
    off = 1e3 * residuals
    rms = np.sqrt(np.mean(off**2))
    return f"joints {rms:.1f} mm off (root mean square; median {np.median(off):.1f}, worst {off.max():.1f})"


def _normalise_girth(
    model: HandModel, shape: Float[ndarray, "S"], joints: Float[ndarray, "T 21 3"]
) -> Float[ndarray, "S"]:
    """Return the shape with fingers as thick as the hand is long.

    Joints say nothing about girth, but enlarge it by chance.
    """
    length = np.median(_mean_finger_length(joints)) / _mean_finger_length(model.with_shape().with_pose().joints)
    shape = shape.copy()
    shape[model.shape_names.index("thickness")] = length - 1.0 - shape[model.shape_names.index("size")]
    return shape


def _mean_finger_length(joints: Float[ndarray, "*batch 21 3"]) -> Float[ndarray, "*batch"]:
    """Mean over the four fingers of the length along the bones from the wrist to the tip [m]."""
    wrist = np.broadcast_to(joints[..., None, :1, :], (*joints.shape[:-2], 4, 1, 3))
    chains = np.concatenate([wrist, joints[..., 5:, :].reshape(*joints.shape[:-2], 4, 4, 3)], axis=-2)
    return np.asarray(np.linalg.norm(np.diff(chains, axis=-2), axis=-1).sum(axis=-1).mean(axis=-1))
