"""Motion capture as joints: one or two hands and an object in a world frame become tracks, the generic hand fitted.

Joints are what most recordings have and may give away. They do not determine a hand's surface: that of the fitted hand
is off by a few millimetres, so contacts at 0 mm depend on it more than on the grasp.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import HandTrack, Joint, World
from getagrip.datasets.assumed_camera import PosedCamera, assumed_camera
from getagrip.datasets.fitted_hands import FittedHand, describe_fit, fit_hand
from getagrip.datasets.tracks import Track
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.hands.model import Side


@dataclass(frozen=True)
class Motion:
    """Joints of the hands, and the object, in every frame of a sequence."""

    file: Path
    """What it was read from."""
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
    provenance: dict[str, str]
    """Where it all comes from."""
    joint: Joint | None = None
    """Of the object, where it has one."""
    articulation: Float[ndarray, "T"] | None = None
    """Angle of the joint [rad]."""
    camera: PosedCamera | None = None
    """One is assumed where it is not known; then z is up in the world frame."""
    estimated: dict[Side, Float[ndarray, "T 21 3"]] = field(default_factory=dict)
    """The joints as an estimator found them: clips are given hands that are fitted to these."""


def tracks(motion: Motion) -> Iterator[Track]:
    """The object in each hand. Raises ``InputError`` where joints are no hand's."""
    fitted = {side: fit_hand(motion.file, f"{side} joints", side, j) for side, j in motion.joints.items()}
    camera, up = motion.camera, None
    if camera is None:
        up = np.array([0.0, 0.0, 1.0])
        places = se3.transform(motion.T_world_obj, motion.mesh.centre[None])[:, 0]
        camera = assumed_camera(places, motion.joints.values())
    hands = {side: seen(hand.track, camera.T_cam_world) for side, hand in fitted.items()}
    for side, hand in hands.items():
        described = "the generic hand, fitted to the true 21 joints over all frames: not the true surface"
        provenance = motion.provenance | {"hands": described, "hand_fit": _fit(fitted[side])}
        given_hand = None
        if side in motion.estimated:
            given = fit_hand(motion.file, f"estimated {side} joints", side, motion.estimated[side])
            given_hand = seen(given.track, camera.T_cam_world)
            provenance["truth"] = f"{described}; {_fit(fitted[side])}"
            provenance["hands"] = "the generic hand, fitted to 21 joints that were estimated"
            provenance["hand_fit"] = _fit(given)
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
            given_hand=given_hand,
            provenance=provenance | {"camera": camera.described},
        )


def _fit(hand: FittedHand) -> str:
    """How well a hand fits, in words."""
    return describe_fit(hand.residuals) + ", over the sequence"


def seen(hand: HandTrack, T_cam_world: Float[ndarray, "T 4 4"]) -> HandTrack:
    """A hand whose poses are in the world frame, in that of a camera."""
    return replace(hand, T_cam_hand=T_cam_world @ hand.T_cam_hand)
