"""Skinned hands: ``load(side) -> with_shape -> with_pose``, each stage immutable, with any leading batch axes.

    model = generic.load("right")            # HandModel: template, joints, weights, shape space
    shaped = model.with_shape(shape)         # ShapedHand: the flat hand of one person
    posed = shaped.with_pose(pose)           # PosedHand: vertices, joints and contact regions in the hand frame
    track = hand_track(posed, T_cam_hand)    # HandTrack: the hand of a clip

All models share one hand frame and one joint tree, MANO's. The frame is MANO's template frame at zero global rotation:
of a right hand the wrist lies towards +x, the fingers point to -x, the palm faces -y, the thumb is at +z; a left hand
is the right one mirrored in x. The wrist is not the origin: MANO turns a hand about its root joint J0, so the pose
(global rotation R, translation t) of a MANO-like tracker is ``T_cam_hand = [R | J0 - R J0 + t]`` (``root_transform``).

Equations: linear blend skinning with linear shape and pose corrections, as in SMPL (Loper et al., "SMPL", SIGGRAPH Asia
2015, Eq. 2-10) and MANO (Romero, Tzionas, Black, "Embodied Hands", SIGGRAPH Asia 2017).

Contact regions are the pads of the fingertips and, as in objects-along-hit, three areas of the palm: the ball of the
thumb, the cushions below the fingers' roots, and the edge below the little finger. They follow from skinning weights,
normals and joints at rest, for any hand model with bones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS, HandTrack
from getagrip.clip.timeline import opposite_side
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import vertex_normals

Side = Literal["left", "right"]

MANO_JOINTS = (
    "wrist",
    *(f"{finger}{n}" for finger in ("index", "middle", "pinky", "ring", "thumb") for n in (1, 2, 3)),
)
"""The 16 joints in MANO's order; the pose has three numbers for each except the wrist."""
PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
"""Parent of each of the 16 joints."""
KNUCKLES = tuple(MANO_JOINTS.index(f"{finger}1") for finger in FINGERS)
"""The first joint of each finger, in the order of ``FINGERS``."""
PALM_REGIONS = ("palm_thumb", "palm_fingers", "palm_edge")
"""Contact regions of the palm: the ball of the thumb, below the fingers' roots, the edge below the little finger."""
MIN_BONE_WEIGHT = 0.5
"""Skinning weight above which a vertex belongs to a bone."""
SIDE_MIRROR = np.array([-1.0, 1.0, 1.0])
"""Factors that mirror points between right and left hands."""


@dataclass(frozen=True)
class PosedHand:
    """Hands in the hand frame: the result of every hand model.

    Attributes:
        side: ``left`` or ``right``.
        vertices: (..., V, 3) vertices in the hand frame [m].
        faces: (F, 3) vertex ids of the corners of each face, counter-clockwise seen from outside.
        joints: (..., 21, 3) joints in the hand frame [m]: wrist, then thumb, index, middle, ring, pinky, each from the
            palm to the tip.
        regions: contact regions by name, (n,) vertex ids each: the five ``FINGERS``, then ``palm_*``.
    """

    side: Side
    vertices: Float[ndarray, "*batch V 3"]
    faces: Int[ndarray, "F 3"]
    joints: Float[ndarray, "*batch 21 3"]
    regions: dict[str, Int[ndarray, "_"]]

    @cached_property
    def normals(self) -> Float[ndarray, "*batch V 3"]:
        """Unit vertex normals, outward."""
        return vertex_normals(self.vertices, self.faces)


@dataclass(frozen=True)
class HandModel:
    """A hand that deforms with shape and pose.

    Attributes:
        name: name, for messages.
        side: ``left`` or ``right``.
        template: (V, 3) vertices of the flat mean hand, in the hand frame [m].
        faces: (F, 3) vertex ids of the corners of each face, counter-clockwise seen from outside.
        joints: (16, 3) joints of the flat mean hand, in the hand frame [m], in the order of ``MANO_JOINTS``.
        weights: (V, 16) skinning weights; rows sum to one.
        tips: (5,) the vertex at the tip of each of the ``FINGERS``.
        regions: contact regions by name, (n,) vertex ids each.
        shape_names: meaning of each shape parameter.
        shape_directions: (V, 3, S) displacement of the vertices per unit of each shape parameter [m].
        joint_directions: (16, 3, S) displacement of the joints per unit of each shape parameter [m].
        shape_spread: (S,) standard deviation of each shape parameter among people.
        pose_directions: (V, 3, 135) displacement of the vertices per unit of each entry of R - I, R the rotations of
            the 15 finger joints.
    """

    name: str
    side: Side
    template: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    joints: Float[ndarray, "16 3"]
    weights: Float[ndarray, "V 16"]
    tips: Int[ndarray, "5"]
    regions: dict[str, Int[ndarray, "_"]]
    shape_names: tuple[str, ...]
    shape_directions: Float[ndarray, "V 3 S"]
    joint_directions: Float[ndarray, "16 3 S"]
    shape_spread: Float[ndarray, "S"]
    pose_directions: Float[ndarray, "V 3 135"] | None = None

    def with_shape(self, shape: Float[ndarray, "..."] | None = None) -> ShapedHand:
        """Return the flat hands of shapes (..., S); the mean hand without a shape.

        Raises ``UsageError`` unless the last axis has the length of ``shape_names``.
        """
        count = len(self.shape_names)
        shape = np.zeros(count) if shape is None else np.asarray(shape, dtype=float)
        if shape.ndim == 0 or shape.shape[-1] != count:
            raise UsageError(f"shape of the {self.name} hand must be of size (..., {count}) (got {shape.shape})")
        return ShapedHand(
            model=self,
            vertices=self.template + np.tensordot(shape, self.shape_directions, axes=(-1, 2)),
            joints=self.joints + np.tensordot(shape, self.joint_directions, axes=(-1, 2)),
        )


@dataclass(frozen=True)
class ShapedHand:
    """Flat hands of some shapes.

    Attributes:
        model: the hand model.
        vertices: (..., V, 3) vertices of the flat hand, in the hand frame [m].
        joints: (..., 16, 3) joints of the flat hand, in the hand frame [m].
    """

    model: HandModel
    vertices: Float[ndarray, "*batch V 3"]
    joints: Float[ndarray, "*batch 16 3"]

    def with_pose(self, pose: Float[ndarray, "..."] | None = None) -> PosedHand:
        """Return the hands with fingers turned by a pose; the flat hands without one.

        ``pose`` (..., 45) has a rotation vector [rad] for each joint except the wrist, in MANO's order, relative to the
        flat hand and in its axes. Raises ``UsageError`` unless the last axis has length 45.
        """
        model = self.model
        pose = np.zeros(45) if pose is None else np.asarray(pose, dtype=float)
        if pose.ndim == 0 or pose.shape[-1] != 45:
            raise UsageError(f"pose of the {model.name} hand must be of size (..., 45) (got {pose.shape})")
        R = se3.exp_so3(pose.reshape(*pose.shape[:-1], 15, 3))
        vertices = self.vertices
        if model.pose_directions is not None:
            bends = (R - np.eye(3)).reshape(*R.shape[:-3], 135)
            vertices = vertices + np.tensordot(bends, model.pose_directions, axes=(-1, 2))
        T = joint_transforms(R, self.joints)
        moved = skin(vertices, model.weights, T, self.joints)
        skeleton = np.concatenate([T[..., :3, 3], moved[..., model.tips, :]], axis=-2)
        return PosedHand(model.side, moved, model.faces, skeleton[..., ORDER_21, :], model.regions)


ORDER_21 = np.array([0] + [i for n, knuckle in enumerate(KNUCKLES) for i in (*range(knuckle, knuckle + 3), 16 + n)])
"""Index of each of the 21 joints among the 16 joints followed by the five fingertips."""


def joint_transforms(
    R: Float[ndarray, "*#batch 15 3 3"], joints: Float[ndarray, "*#batch 16 3"]
) -> Float[ndarray, "*batch 16 4 4"]:
    """Return the frames of the joints in the hand frame, ``T_hand_joint``; at rest their axes are the hand's."""
    batch = np.broadcast_shapes(R.shape[:-3], joints.shape[:-2])
    T = np.empty((*batch, 16, 4, 4))
    T[..., 0, :, :] = se3.rigid(None, joints[..., 0, :])
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            step = se3.rigid(R[..., child - 1, :, :], joints[..., child, :] - joints[..., parent, :])
            T[..., child, :, :] = T[..., parent, :, :] @ step
    return T


def skin(
    vertices: Float[ndarray, "*#batch V 3"],
    weights: Float[ndarray, "V joints"],
    T: Float[ndarray, "*#batch joints 4 4"],
    joints: Float[ndarray, "*#batch joints 3"],
) -> Float[ndarray, "*batch V 3"]:
    """Apply linear blend skinning: a vertex moves with the weighted mean of the joints' motions from rest.

    ``T`` maps joint frames into the hand frame; ``joints`` are their origins at rest, with the hand's axes.
    """
    motion = np.array(np.broadcast_to(T, (*np.broadcast_shapes(T.shape[:-3], joints.shape[:-2]), *T.shape[-3:])))
    motion[..., :3, 3] -= (T[..., :3, :3] @ joints[..., None])[..., 0]
    rows = motion[..., :3, :].reshape(*motion.shape[:-2], 12)
    blend = (weights @ rows).reshape(*rows.shape[:-2], len(weights), 3, 4)
    return (blend[..., :3] @ vertices[..., None])[..., 0] + blend[..., 3]


def root_transform(
    R: Float[ndarray, "*#batch 3 3"], t: Float[ndarray, "*#batch 3"], root: Float[ndarray, "*#batch 3"]
) -> Float[ndarray, "*batch 4 4"]:
    """Return ``T_cam_hand`` of MANO's global rotation R about the root joint J0 (``root``), and translation t [m]."""
    return se3.rigid(R, root - (R @ root[..., None])[..., 0] + t)


def mirrored(points: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3"]:
    """Mirror points of a right hand into the frame of the left one, and back."""
    return points * SIDE_MIRROR


def mirrored_pose(pose: Float[ndarray, "*batch 45"]) -> Float[ndarray, "*batch 45"]:
    """Mirror a pose to the other hand (rotation vectors are axial: y and z change sign)."""
    return pose * np.tile([1.0, -1.0, -1.0], 15)


def mirrored_model(model: HandModel) -> HandModel:
    """Return the hand model of the other side, without ``pose_directions``."""
    return replace(
        model,
        side=opposite_side(model.side),
        template=mirrored(model.template),
        faces=model.faces[:, ::-1].copy(),
        joints=mirrored(model.joints),
        shape_directions=model.shape_directions * SIDE_MIRROR[:, None],
        joint_directions=model.joint_directions * SIDE_MIRROR[:, None],
        pose_directions=None,
    )


def hand_track(posed: PosedHand, T_cam_hand: Float[ndarray, "T 4 4"]) -> HandTrack:
    """Make the hand of a clip; a posed hand without a batch axis serves all frames.

    Raises ``UsageError`` for a number of hands that is neither 1 nor T, or ``T_cam_hand`` that is not rigid.
    """
    T = len(T_cam_hand)
    if posed.vertices.shape[:-2] not in {(), (1,), (T,)}:
        raise UsageError(f"hands must be of size ({T}, V, 3) or (V, 3) for {T} frames (got {posed.vertices.shape})")
    if T_cam_hand.shape != (T, 4, 4) or not se3.is_rigid(T_cam_hand).all():
        raise UsageError(f"T_cam_hand must be ({T}, 4, 4) rigid motions (got the size {T_cam_hand.shape})")
    return HandTrack(
        vertices=np.array(np.broadcast_to(posed.vertices, (T, *posed.vertices.shape[-2:]))),
        faces=posed.faces,
        T_cam_hand=np.array(T_cam_hand, dtype=float),
        regions=posed.regions,
        joints=np.array(np.broadcast_to(posed.joints, (T, 21, 3))),
    )


def contact_regions(
    of_palm: Float[ndarray, "V"],
    of_fingers: Float[ndarray, "V 5 3"],
    towards_pads: Float[ndarray, "V 5"],
    towards_palm: Float[ndarray, "V"],
    length: Float[ndarray, "V"],
    across: Float[ndarray, "V"],
) -> dict[str, Int[ndarray, "_"]]:
    """Return vertex ids of the five ``FINGERS``' pads and of the ``PALM_REGIONS``.

    ``of_palm`` and ``of_fingers`` are skinning weights, the latter of three bones for each of the ``FINGERS``.
    ``towards_pads`` and ``towards_palm`` are the components of the unit normals in the directions that each last
    phalanx and the palm face. ``length`` and ``across`` are the vertices' positions on the palm (``position_on_palm``).
    """
    palm, bones = of_palm > MIN_BONE_WEIGHT, of_fingers > MIN_BONE_WEIGHT
    pads = [bones[:, n, 2] & (towards_pads[:, n] > 0.2) for n in range(len(FINGERS))]
    below_thumb, below_fingers = palm | bones[:, 0, 0], palm | bones[:, 1:, 0].any(axis=1)
    ball = below_thumb & (towards_palm > 0.2) & (length > 0.1) & (length < 0.75) & (across < 0.35)
    cushions = below_fingers & (towards_palm > 0.5) & (length > 0.75) & (length < 1.1)
    edge = palm & (towards_palm > -0.3) & (length > 0.2) & (length <= 0.75) & (across > 0.85)
    named = zip((*FINGERS, *PALM_REGIONS), (*pads, ball, cushions, edge), strict=True)
    return {name: np.flatnonzero(inside) for name, inside in named}


def position_on_palm(
    x: Float[ndarray, "V 3"], wrist: Float[ndarray, "3"], index: Float[ndarray, "3"], pinky: Float[ndarray, "3"]
) -> tuple[Float[ndarray, "V"], Float[ndarray, "V"]]:
    """Return positions on the palm: ``length`` from 0 at the wrist to 1 at the knuckles, along x; and ``across``.

    ``across`` is 0 below the index and 1 below the little finger. ``wrist``, ``index`` and ``pinky`` are the wrist and
    the first joints of these fingers, in the frame of ``x``.
    """
    length = (x - wrist)[:, 0] / (0.5 * (index + pinky) - wrist)[0]
    return length, (x - index) @ (pinky - index) / np.sum((pinky - index) ** 2)
