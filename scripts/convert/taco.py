"""TACO's sequences in GeneOH Diffusion's copy as tracks, which `getagrip import tracks` reads (docs/datasets.md).

    python scripts/convert/taco.py SOURCE_DATA TRACKS

SOURCE_DATA is the folder ``data/taco/source_data`` of https://github.com/Meowuu7/GeneOH-Diffusion (Liu et al., ICLR
2024), which holds two sequences of TACO (Liu et al., CVPR 2024; CC BY 4.0), in which a left hand moves an object:

    <sequence>.pkl   hand_verts (T, 778, 3) [m], hand_pose (T, 48): MANO's rotation vectors, the global one first,
                     hand_trans (T, 3) [m]: the wrist joint; obj_pose (T, 4, 4): object to camera [m]
    <sequence>.obj   the object [m], about 1,000 vertices

The hand's joints are not given: they follow from how the surface moves (``flat_hand``), so no MANO file is needed. The
hand is a left one: with the fingers ahead and the thumb up, the palm, to which they bend, is on the right. All is in
the frame of a camera whose intrinsics are not given: a pinhole is assumed, and so are 30 frames per second. Who the
person is and what the object is stands nowhere: the subject is "unknown", the category "object".
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.model import ORDER_21, PARENTS
from getagrip.io import pickles
from getagrip.readers.datasets import track_files
from getagrip.readers.datasets.mano_tracks import check_mano_numbers

FPS = 30.0
VERTICES = 778
RIDGE = 1e-3
"""Ridge on y, relative to the mean square of its coefficients, which is 1."""
FOLLOWERS = 15
"""Number of vertices that define a joint: those best explained by the rotations of the bone and its parent."""
MOVES = 0.003
"""Minimum rms distance of a vertex that does not follow the parent bone from the parent's rigid motion [m]."""
LEAST_TURN = np.radians(5.0)
"""Minimum root mean square angle of each bone about its mean."""


def main(source_data: Path, out: Path) -> None:
    found = [file for file in sorted(source_data.glob("*.pkl")) if file.with_suffix(".obj").is_file()]
    if not found:
        sys.exit(f"{source_data}: no <sequence>.pkl with a <sequence>.obj: expected the folder source_data")
    out.mkdir(parents=True, exist_ok=True)
    for file in found:
        try:
            convert(file, out)
        except InputError as error:
            print(f"{error}: skipped", file=sys.stderr)


def convert(file: Path, out: Path) -> None:
    """Convert a sequence to a file of tracks and the object's mesh."""
    K, size = track_files.assumed_pinhole()
    T_cam_hand, vertices, pose, given = read(file)
    found = flat_hand(vertices, generic.load("left").joints[0], pose)
    if found is None:
        raise InputError(file, "hand_pose", "fingers that move too little", "motion that tells where their joints are")
    joints, A = np.tile(found[1], (len(pose), 1, 1)), _rotations(pose)
    for bone in range(1, 16):
        parent = PARENTS[bone]
        joints[:, bone] = joints[:, parent] + A[:, parent] @ (found[1][bone] - found[1][parent])
    joints = np.concatenate([joints, vertices[:, list(mano.FINGERTIP_VERTICES["left"])]], axis=1)[:, ORDER_21]
    shutil.copy(file.with_suffix(".obj"), out)
    np.savez_compressed(
        out / f"{file.stem}.npz",
        joints_left=se3.transform(T_cam_hand, joints), order="openpose",
        T_world_obj=check_mano_numbers(file, given, "obj_pose", (len(pose), 4, 4)), mesh=f"{file.stem}.obj", fps=FPS,
        category="object", subject="unknown", sequence=file.stem, K=K, size=size, T_cam_world=np.eye(4),
        source=f"TACO, {file.stem}, in GeneOH Diffusion's copy; {FPS:g} frames per second are assumed",
        licence="made from TACO, CC BY 4.0",
        assumed_camera=f"a guess: the poses are the camera's, its focal length {K[0, 0]:g} px is assumed",
    )  # fmt: skip


def read(
    file: Path,
) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 778 3"], Float[ndarray, "T 45"], dict[str, object]]:
    """Read the hand's poses, vertices in the hand frame and fingers' rotation vectors, and the content of the file.

    MANO's root joint, which the translation is, lies where the generic hand has its wrist. Raises ``InputError``.
    """
    given = pickles.read_pickle_file(file, "a sequence of TACO")
    vertices = check_mano_numbers(file, given, "hand_verts", (-1, VERTICES, 3))
    T = len(vertices)
    pose = check_mano_numbers(file, given, "hand_pose", (T, 48))
    R = se3.exp_so3(pose[:, :3])
    T_cam_hand = se3.rigid(
        R, check_mano_numbers(file, given, "hand_trans", (T, 3)) - R @ generic.load("left").joints[0]
    )
    return T_cam_hand, se3.transform(se3.inverse(T_cam_hand), vertices), pose[:, 3:], given


def _rotations(pose: Float[ndarray, "T 45"]) -> Float[ndarray, "T 16 3 3"]:
    """Return the rotation of each bone in the hand frame."""
    A = np.tile(np.eye(3), (len(pose), 16, 1, 1))
    for bone, turn in enumerate(np.moveaxis(se3.exp_so3(pose.reshape(-1, 15, 3)), 1, 0), start=1):
        A[:, bone] = A[:, PARENTS[bone]] @ turn
    return A


def flat_hand(
    x: Float[ndarray, "T V 3"], wrist: Float[ndarray, "3"], pose: Float[ndarray, "T 45"]
) -> tuple[Float[ndarray, "V 3"], Float[ndarray, "16 3"], Float[ndarray, "V 16"]] | None:
    """Estimate vertices and joints [m] of the flat hand from a moving surface, and weights of one bone per vertex.

    A vertex that follows bone j is at x(t) = p(t) + B(t) l + A(t) y, with the place p and the rotation B of the
    parent's joint, the rotation A of the bone, the offset l of its joint from the parent's, and the vertex's own offset
    y from the joint. So l and y are linear least squares, from the wrist outwards. Along the axis of a joint that only
    bends they cannot be separated: a small ridge on y puts the joint in the middle of the vertices that follow it.

    ``x`` are the moving vertices in the hand frame, ``wrist`` the place of the wrist joint there, ``pose`` rotation
    vectors relative to the flat hand. None where some bone turns too little to place its joint.
    """
    T, V = x.shape[:2]
    A = _rotations(pose)
    mean = se3.nearest_rotation(A.mean(axis=0))
    if np.sqrt((se3.angle_between(A, mean[None]) ** 2).mean(axis=0))[1:].min() < LEAST_TURN:
        return None
    joints, place = np.tile(wrist, (16, 1)), np.tile(wrist, (16, T, 1))
    flat = np.tile(x.mean(axis=0), (16, 1, 1))
    error = np.zeros((16, V))
    error[0] = _rms(x - flat[0])
    for bone in range(1, 16):
        parent = PARENTS[bone]
        B, moved = A[:, parent], x - place[parent][:, None]
        offset, own, error[bone] = _placed(moved, B, A[:, bone])
        joints[bone] = joints[parent] + offset
        place[bone] = place[parent] + B @ offset
        flat[bone] = joints[bone] + own
    nearest = error.argmin(axis=0)
    return flat[nearest, np.arange(V)], joints, np.eye(16)[nearest]


def _placed(
    moved: Float[ndarray, "T V 3"], B: Float[ndarray, "T 3 3"], A: Float[ndarray, "T 3 3"]
) -> tuple[Float[ndarray, "3"], Float[ndarray, "V 3"], Float[ndarray, "V"]]:
    """Return a joint's offset, each vertex's own if it follows the bone, and the vertex's residual, rms [m]."""
    to_parent, to_bone = np.swapaxes(B, 1, 2), np.swapaxes(A, 1, 2)
    of_parent = (moved @ B).mean(axis=0)  # vertices explained by B alone, and by A alone
    of_bone = (moved @ A).mean(axis=0)
    mixed, ridged = (to_parent @ A).mean(axis=0), 1.0 + RIDGE
    schur = np.eye(3) - mixed @ mixed.T / ridged
    offsets = np.linalg.solve(schur, (of_parent - of_bone @ mixed.T / ridged).T).T
    own = (of_bone - offsets @ mixed) / ridged
    alone = _rms(moved - of_parent @ to_parent)
    both = _rms(moved - offsets @ to_parent - own @ to_bone)
    ratio = np.where(alone > MOVES, both / np.maximum(alone, MOVES), np.inf)
    followers = np.argsort(ratio, kind="stable")[:FOLLOWERS]
    offset = offsets[followers].mean(axis=0)
    own = (of_bone - offset @ mixed) / ridged
    return offset, own, _rms(moved - offset @ to_parent[:, None] - own @ to_bone)


def _rms(difference: Float[ndarray, "T V 3"]) -> Float[ndarray, "V"]:
    return np.asarray(np.sqrt((difference**2).sum(axis=-1).mean(axis=0)))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
