"""Any motion capture of hands and objects, brought into one layout (docs/formats.md#tracks): no MANO is needed.

A file is one sequence of one object with one or two hands:

    <anything>.npz   joints_left, joints_right   (T, 21, 3): joints in the world [m], NaN where unknown; one or both
                     order                       text: openpose or ho3d, the order of the joints
                     T_world_obj                 (T, 4, 4): object to world [m], NaN where unknown
                     mesh                        text: name of the mesh's file, in the same folder [m]
                     fps                         frames per second
                     category, subject, sequence texts; they name the clips
    optional         estimated_left, _right      (T, 21, 3): the joints as an estimator found them, of the same sides:
                                                 clips are given these hands, the true ones are their truth
                     frames                      (T,): numbers of the frames, rising; by default from 0
                     source, licence             texts, for the provenance
                     articulation                (T,): angle of the object's joint [rad]
                     mesh_top, joint             text: the mesh of the part that turns; (2, 3): a point of the axis [m],
                                                 its direction, in the object's frame
                     K, size, T_cam_world        (3, 3), (2,) [px], (4, 4) or (T, 4, 4): the camera; all three or none
                     assumed_camera              text: what that camera is, where it is no true one

Without a camera, one is assumed (``joint_tracks``), and z must be up in the world. Meshes are made fine enough for
contact to be counted by their vertices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import Joint
from getagrip.datasets.cutting import TrackedDataset
from getagrip.datasets.dataset import Note
from getagrip.datasets.joint_tracks import HandObjectMotion, PosedCamera, motion_tracks
from getagrip.datasets.tracks import SequenceSource, Track, check_length
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.subdivide import subdivide_parts
from getagrip.grasps.definition import MIN_GRASP_FRAMES, GraspOptions
from getagrip.hands.fit import JOINT_ORDERS
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.io.files import inside, is_portable_name, list_files, shorten_value
from getagrip.provenance import assumed, measured

HAND_SIDES: tuple[Side, ...] = ("left", "right")
TRACK_NAME_KEYS = ("category", "subject", "sequence")
CAMERA_KEYS = ("K", "size", "T_cam_world")
ARTICULATION_KEYS = ("articulation", "mesh_top", "joint")
SOURCE_TEXT_KEYS = ("source", "licence", "assumed_camera")
JOINT_ARRAY_KEYS = tuple(f"{kind}_{side}" for kind in ("joints", "estimated") for side in HAND_SIDES)
TRACK_FILE_KEYS = {
    *JOINT_ARRAY_KEYS,
    "order",
    "T_world_obj",
    "mesh",
    "fps",
    "frames",
    *TRACK_NAME_KEYS,
    *CAMERA_KEYS,
    *ARTICULATION_KEYS,
    *SOURCE_TEXT_KEYS,
}
GRASP_OPTIONS_10_MM = GraspOptions(contact_mm=10.0, shortest=MIN_GRASP_FRAMES)
"""Definition of ``arctic`` except for the contact: within 10 mm, fitted hands touch as true ones do (docs/arctic.md),
at 0 mm not."""
MAX_TRACK_FPS = 1000.0
"""Frames per second."""

Arrays = dict[str, Shaped[ndarray, "..."]]


@dataclass(frozen=True, kw_only=True)
class Tracks(TrackedDataset):
    """Any motion capture: files of joints and object poses (docs/formats.md): every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = GRASP_OPTIONS_10_MM
    """Definition of a stable grasp."""

    def sources(self) -> list[SequenceSource]:
        """List the file ``root``, or the files in a folder."""
        files = [self.root] if self.root.is_file() else list_files(self.root, (".npz",))
        if not files:
            raise InputError(self.root, "", "no .npz file", "a file of tracks, or a folder of them")
        return [SequenceSource(file.stem, partial(_read_tracks, file)) for file in files]


def _read_tracks(file: Path, note: Note) -> Iterator[Track]:
    """Yield the object in each hand, in the frames in which all that the file holds is known."""
    motion = read_motion(file, note)
    if motion is not None:
        yield from motion_tracks(motion)


def read_motion(file: Path, note: Note) -> HandObjectMotion | None:
    """Read a file, in the frames in which all that it holds is known; None for fewer than 2. Raises ``InputError``."""
    stored = arrays.read(file, TRACK_FILE_KEYS.__contains__)
    order = _read_joint_order(file, stored)
    category, subject, sequence = (_read_name(file, stored, key) for key in TRACK_NAME_KEYS)
    poses = _read_with_unknown_frames(file, stored, "T_world_obj", (-1, 4, 4))
    T = len(poses)
    check_length(file, "T_world_obj", T)
    joints, estimated = _read_joint_arrays(file, stored, "joints", T), _read_joint_arrays(file, stored, "estimated", T)
    if not joints:
        raise InputError(file, "joints_left, joints_right", "none of them", "the joints of a hand or of both")
    if estimated and estimated.keys() != joints.keys():
        raise InputError(file, "estimated_left, estimated_right", "not those of joints_...", "the same sides, or none")
    known = np.isfinite(poses).all(axis=(1, 2))
    for of_side in (*joints.values(), *estimated.values()):
        known &= np.isfinite(of_side).all(axis=(1, 2))
    rows = np.flatnonzero(known)
    if rows.size < 2:
        note(f"{file.name}: hands and object are known in {rows.size} of {T} frames: skipped")
        return None
    if not se3.is_rigid(poses[rows]).all():
        raise InputError(file, "T_world_obj", "matrices that are no rigid motions", "rotations and translations [m]")
    mesh, joint = _read_object(file, stored)
    return HandObjectMotion(
        file=file,
        subject=subject,
        sequence=sequence,
        category=category,
        fps=_read_fps(file, stored),
        numbers=_read_frame_numbers(file, stored, T)[rows],
        joints={side: of_side[rows][:, order] for side, of_side in joints.items()},
        estimated={side: of_side[rows][:, order] for side, of_side in estimated.items()},
        T_world_obj=poses[rows],
        mesh=mesh,
        joint=joint,
        articulation=arrays.floats(file, stored, "articulation", (T,))[rows] if "articulation" in stored else None,
        camera=_read_posed_camera(file, stored, T, rows),
        provenance={
            "source": f"{file.name}, {subject}/{sequence}",
            **{key: _read_text(file, stored, key) for key in ("source", "licence") if key in stored},
            "scale": f"the file's mesh, taken as of true size; long edges halved: {len(mesh.vertices)} vertices",
        },
    )


def _read_joint_arrays(file: Path, arrays: Arrays, kind: str, T: int) -> dict[Side, Float[ndarray, "T 21 3"]]:
    """Read the joints of each hand that the file has, in its own order."""
    keys = {side: f"{kind}_{side}" for side in HAND_SIDES}
    return {
        side: _read_with_unknown_frames(file, arrays, key, (T, 21, 3)) for side, key in keys.items() if key in arrays
    }


def _read_object(file: Path, value: Arrays) -> tuple[Mesh, Joint | None]:
    """Read the object from its mesh, or from two where it has a joint."""
    has = [key for key in ARTICULATION_KEYS if key in value]
    if has and len(has) < len(ARTICULATION_KEYS):
        raise InputError(file, ", ".join(ARTICULATION_KEYS), f"only {', '.join(has)}", "all of them, or none")
    parts = []
    for key in ("mesh", "mesh_top") if has else ("mesh",):
        parts.append(read_mesh(inside(file.parent, _read_text(file, value, key), key, "a mesh", file)))
    mesh, part = subdivide_parts(parts)
    if not has:
        return mesh, None
    point, direction = arrays.floats(file, value, "joint", (2, 3))
    length = float(np.linalg.norm(direction))
    if length < 1e-6:
        raise InputError(file, "joint", "a direction of length 0", "a direction of the axis")
    return mesh, Joint(moves=part == 1, point=point, direction=direction / length)


def _read_posed_camera(file: Path, value: Arrays, T: int, rows: Int[ndarray, "n"]) -> PosedCamera | None:
    """Return the file's camera in some of its frames; None where it has none."""
    has = [key for key in CAMERA_KEYS if key in value]
    if not has:
        return None
    if len(has) < len(CAMERA_KEYS):
        raise InputError(file, ", ".join(CAMERA_KEYS), f"only {', '.join(has)}", "all of them, or none")
    K = arrays.floats(file, value, "K", (3, 3))
    width, height = (float(n) for n in arrays.floats(file, value, "size", (2,), kinds="iuf"))
    if not (1 <= width <= 10_000 and 1 <= height <= 10_000 and width % 1 == height % 1 == 0):
        raise InputError(file, "size", f"{width:g} x {height:g}", "width and height in pixels, 1 to 10000")
    T_cam_world = arrays.floats(file, value, "T_cam_world", (4, 4) if value["T_cam_world"].ndim == 2 else (T, 4, 4))
    if not se3.is_rigid(T_cam_world).all():
        raise InputError(file, "T_cam_world", "what is no rigid motion", "rotations and translations [m]")
    described = (
        assumed(_read_text(file, value, "assumed_camera")) if "assumed_camera" in value else measured("the file's own")
    )
    return PosedCamera(K, (int(width), int(height)), np.broadcast_to(T_cam_world, (T, 4, 4))[rows], described)


def _read_frame_numbers(file: Path, value: Arrays, T: int) -> Int[ndarray, "T"]:
    if "frames" not in value:
        return np.arange(T)
    numbers = arrays.floats(file, value, "frames", (T,), kinds="iu").astype(np.int64)
    if numbers[0] < 0 or np.any(np.diff(numbers) <= 0) or numbers[-1] >= 10**9:
        raise InputError(file, "frames", shorten_value(numbers[:8].tolist()), "rising numbers from 0 to 999999999")
    return numbers


def _read_fps(file: Path, value: Arrays) -> float:
    fps = float(arrays.floats(file, value, "fps", (), kinds="iuf"))
    if not 0.0 < fps <= MAX_TRACK_FPS:
        raise InputError(file, "fps", f"{fps:g}", f"frames per second, up to {MAX_TRACK_FPS:g}")
    return fps


def _read_with_unknown_frames(file: Path, value: Arrays, key: str, shape: tuple[int, ...]) -> Float[ndarray, "T ..."]:
    """Check an array in which whole frames may be NaN.

    Raises ``InputError`` also for frames of which only a part is.
    """
    if key in value and value[key].dtype.kind == "f" and value[key].ndim == len(shape):
        values = value[key].astype(float)
        unknown = np.asarray(np.isnan(values).all(axis=tuple(range(1, len(shape)))))
        values[unknown] = 0.0
        values = arrays.floats(file, {key: values}, key, shape)
        values[unknown] = np.nan
        return values
    return arrays.floats(file, value, key, shape)


def _read_text(file: Path, arrays: Arrays, key: str) -> str:
    if key not in arrays:
        raise InputError(file, key, "no such array", "a text")
    value = arrays[key]
    if value.dtype.kind != "U" or value.ndim != 0 or not 0 < len(str(value)) <= 200 or not str(value).isprintable():
        raise InputError(file, key, f"{value.dtype} of shape {value.shape}", "a text of up to 200 printable characters")
    return str(value)


def _read_name(file: Path, arrays: Arrays, key: str) -> str:
    name = _read_text(file, arrays, key)
    if not is_portable_name(name):
        raise InputError(file, key, shorten_value(name), "a name that can be part of a folder's")
    return name


def _read_joint_order(file: Path, arrays: Arrays) -> list[int]:
    """Return the index of each of this package's joints in the file."""
    order = _read_text(file, arrays, "order")
    for name, places in JOINT_ORDERS.items():
        if order == name:
            return places
    raise InputError(file, "order", shorten_value(order), f"one of {', '.join(JOINT_ORDERS)}")
