"""The UmeTrack hand of HOT3D: a person's mesh from the profile JSON, posed by 22 joint angles.

Kinematics as in facebookresearch/hand_tracking_toolkit, ``umetrack_skinning.py`` (Han et al., "UmeTrack: Unified
multi-view end-to-end hand tracking for VR", SIGGRAPH Asia 2022). Each finger is a chain of four hinges that starts at
the wrist. Hinge i turns by its angle about the line through ``joint_rest_positions[i]`` along
``joint_rotation_axes[i]``, both given for the hand at rest; the bones of a finger are the frames after its second,
third and fourth hinge:

    M_f,i = rot(line_f,1, angle_f,1) ... rot(line_f,i, angle_f,i)      x = sum_b w_b M_b x_rest

The last two of the 22 angles, the wrist's, have no effect, as in the toolkit. The profile describes a left hand in
millimetres; a right hand is the left one mirrored in x.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, edge_table
from getagrip.geometry.mesh_files import check_size
from getagrip.hands.generic import MANO_WRIST_M
from getagrip.hands.model import SIDE_MIRROR, PosedHand, Side, contact_regions, mirrored, position_on_palm
from getagrip.io.files import Json, read_json

UMETRACK_SHAPES = {
    "mesh_vertices": (None, 3),
    "mesh_triangles": (None, 3),
    "dense_bone_weights": (None, 17),
    "joint_rest_positions": (22, 3),
    "joint_rotation_axes": (22, 3),
    "landmark_rest_positions": (21, 3),
}

ROTATION_WRIST_HAND = np.radians([2.45, -3.75, 0.25])
"""Rotation vector from MANO's template frame to the UmeTrack wrist frame of a left hand [rad]: the mean of the four
hands of HOT3D's test sample, which has every hand in both models. They differ from it by up to 4 degrees and 7 mm."""
ROOT_IN_WRIST = np.array([0.0160, -0.0036, -0.0001])
"""MANO's root joint in the UmeTrack wrist frame [m], likewise."""


@dataclass(frozen=True)
class UmeTrackHand:
    """One person's hand at rest, in the UmeTrack wrist frame of the left hand.

    Attributes:
        rest: the left hand's mesh [m], closed at the wrist, faces outward.
        weights: (V, 17) skinning weights of root, wrist and three bones for each of the ``FINGERS``.
        pivots: (20, 3) a point on the axis of each hinge [m]: four hinges for each of the ``FINGERS``.
        axes: (20, 3) directions of the hinges, unit.
        tips: (5, 3) fingertips [m].
    """

    rest: Mesh
    weights: Float[ndarray, "V 17"]
    pivots: Float[ndarray, "20 3"]
    axes: Float[ndarray, "20 3"]
    tips: Float[ndarray, "5 3"]

    def with_pose(self, side: Side, angles: Float[ndarray, "*batch 22"]) -> PosedHand:
        """Return the posed hand in the package's hand frame (see ``hands.model``); ``angles`` are HOT3D's [rad]."""
        M = self._bones(angles[..., :20])
        rows = M[..., :3, :].reshape(*M.shape[:-3], 17, 12)
        blend = (self.weights @ rows).reshape(*rows.shape[:-2], -1, 3, 4)
        vertices = (blend[..., :3] @ self.rest.vertices[..., None])[..., 0] + blend[..., 3]

        points = np.concatenate([self.pivots.reshape(5, 4, 3)[:, 1:], self.tips[:, None]], axis=1).reshape(20, 3)
        bone = np.array([b for f in range(5) for b in (2 + 3 * f, 3 + 3 * f, 4 + 3 * f, 4 + 3 * f)])
        fingers = se3.transform(M[..., bone, :, :], points[:, None])[..., 0, :]
        wrist = np.broadcast_to(ROOT_IN_WRIST, (*fingers.shape[:-2], 1, 3))
        joints = np.concatenate([wrist, fingers], axis=-2)

        T_hand_wrist = se3.inverse(_t_wrist_hand("left"))
        vertices, joints = se3.transform(T_hand_wrist, vertices), se3.transform(T_hand_wrist, joints)
        faces = self.rest.faces
        if side == "right":
            vertices, joints, faces = mirrored(vertices), mirrored(joints), faces[:, ::-1].copy()
        return PosedHand(side, vertices, faces, joints, self.regions)

    def _bones(self, angles: Float[ndarray, "*batch 20"]) -> Float[ndarray, "*batch 17 4 4"]:
        """Compute the motion of root, wrist and finger bones from rest, in the wrist frame."""
        turns = se3.rotation_about_line(self.pivots, self.axes, angles)
        M = np.zeros((*angles.shape[:-1], 17, 4, 4))
        M[..., :, :, :] = np.eye(4)
        for finger in range(5):
            chain = np.eye(4)
            for hinge in range(4):
                chain = chain @ turns[..., 4 * finger + hinge, :, :]
                if hinge > 0:
                    M[..., 1 + 3 * finger + hinge, :, :] = chain
        return M

    @cached_property
    def regions(self) -> dict[str, Int[ndarray, "_"]]:
        """Contact regions of the hand at rest (``hands.model``): the pads of the last phalanges, and areas of the palm.

        A last phalanx faces the direction in which its tip moves when it bends.
        """
        x, normals = self.rest.vertices, self.rest.normals
        along = self.tips - self.pivots[3::4]
        palmar = np.cross(self.axes[3::4], along / np.linalg.norm(along, axis=1, keepdims=True))
        length, across = position_on_palm(x, np.zeros(3), self.pivots[5], self.pivots[17])
        return contact_regions(
            of_palm=self.weights[:, :2].sum(axis=1),
            of_fingers=self.weights[:, 2:].reshape(-1, 5, 3),
            towards_pads=normals @ palmar.T,
            towards_palm=-normals[:, 1],
            length=length,
            across=across,
        )


def load(path: Path) -> UmeTrackHand:
    """Read ``umetrack_hand_user_profile.json``. Raises ``InputError`` for any other file."""
    model = read_json(path).get("hand_model")
    if not isinstance(model, dict):
        raise InputError(path, "hand_model", "nothing", "a UmeTrack hand model")
    arrays = {key: _read_profile_array(path, model, key, shape) for key, shape in UMETRACK_SHAPES.items()}
    v, f, weights = arrays["mesh_vertices"] / 1e3, arrays["mesh_triangles"], arrays["dense_bone_weights"]
    if len(weights) != len(v):
        raise InputError(path, "dense_bone_weights", f"{len(weights)} rows", f"one for each of {len(v)} vertices")
    faces = f.astype(np.int64)
    if len(f) == 0 or np.any(faces != f) or faces.min() < 0 or faces.max() >= len(v):
        raise InputError(path, "mesh_triangles", "something else", f"vertex indices below {len(v)}")
    check_size(path, "mesh_vertices", float(np.ptp(v, axis=0).max()), "the hand")
    rest = Mesh(v, close_boundary(faces))
    if rest.volume < 0:
        rest = Mesh(v, rest.faces[:, ::-1].copy())
    axes = arrays["joint_rotation_axes"][:20]
    return UmeTrackHand(
        rest=rest,
        weights=weights / weights.sum(axis=1, keepdims=True),
        pivots=arrays["joint_rest_positions"][:20] / 1e3,
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        tips=arrays["landmark_rest_positions"][:5] / 1e3,
    )


def T_world_hand(side: Side, T_world_wrist: Float[ndarray, "*batch 4 4"]) -> Float[ndarray, "*batch 4 4"]:
    """Convert HOT3D's ``wrist_xform`` to the pose of the package's hand frame in the world."""
    return T_world_wrist @ _t_wrist_hand(side)


def _t_wrist_hand(side: Side) -> Float[ndarray, "4 4"]:
    R = se3.exp_so3(ROTATION_WRIST_HAND)
    left = se3.rigid(R, ROOT_IN_WRIST - R @ mirrored(MANO_WRIST_M))
    M = np.diag([*SIDE_MIRROR, 1.0])
    return left if side == "left" else M @ left @ M


def close_boundary(faces: Int[ndarray, "F 3"]) -> Int[ndarray, "G 3"]:
    """Close a mesh with one boundary loop by a fan of faces from one of the loop's vertices."""
    edges = edge_table(faces)
    rim = edges[edges[:, 3] == len(faces), :2]
    if len(rim) == 0:
        return faces
    centre = rim[0, 0]
    rim = rim[(rim != centre).all(axis=1)]
    fan = np.stack([rim[:, 1], rim[:, 0], np.full(len(rim), centre)], axis=1)
    return np.concatenate([faces, fan])


def _read_profile_array(
    path: Path, model: Json, key: str, shape: tuple[int | None, int]
) -> Float[ndarray, "rows cols"]:
    wanted = f"numbers of shape ({shape[0] or 'n'}, {shape[1]})"
    try:
        value = np.asarray(model[key], dtype=float)
    except KeyError:
        raise InputError(path, f"hand_model.{key}", "nothing", wanted) from None
    except (TypeError, ValueError):
        raise InputError(path, f"hand_model.{key}", "something else", wanted) from None
    if value.ndim != 2 or value.shape[1] != shape[1] or (shape[0] is not None and value.shape[0] != shape[0]):
        raise InputError(path, f"hand_model.{key}", f"shape {value.shape}", wanted)
    if not np.isfinite(value).all():
        raise InputError(path, f"hand_model.{key}", "NaN or infinite numbers", wanted)
    return value
