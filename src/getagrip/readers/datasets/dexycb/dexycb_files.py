"""DexYCB's files as arrays: one ``DexYcbRecording`` for each sequence, in the frame of one of its cameras.

DexYCB's own layout is read, as its toolkit (https://github.com/NVlabs/dex-ycb-toolkit) describes it,

    calibration/intrinsics/<serial>_640x480.yml     fx, fy, ppx, ppy of the colour camera
    calibration/extrinsics_<id>/extrinsics.yml      poses (3 x 4) of the cameras and of a tag on the table; for one view
                                                    optional
    <subject>/<sequence>/meta.yml                   cameras, objects, the grasped object, the hand's side
    <subject>/<sequence>/<serial>/labels_<frame>.npz    pose_y (O, 3, 4), joint_3d (1, 21, 3), seg (480, 640)

and packed files, one ``.npz`` with many sequences: ``sequence`` and ``object`` (S,), ``offset`` (S + 1,), and per frame
``obj_quat_xyzw``, ``obj_trans`` [m], ``joints`` [m] and ``hand_valid``; sequence i has the rows offset[i] to
offset[i + 1]. Poses and joints are in the camera frame.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.io.files import is_portable_name, list_files, printable, read_yaml, shorten_value
from getagrip.readers.datasets.realsense import parse_integer, read_colour_intrinsics, read_extrinsics
from getagrip.readers.datasets.tracks import MAX_SEQUENCE_FRAMES

TABLE_TAG = "apriltag"
"""Name of the tag on the table, z up, in the extrinsics."""
DEXYCB_IMAGE_SIZE_PX = (640, 480)
"""Width and height of DexYCB's images [px]."""
_YCB_NAMES = """
    002_master_chef_can 003_cracker_box 004_sugar_box 005_tomato_soup_can 006_mustard_bottle 007_tuna_fish_can
    008_pudding_box 009_gelatin_box 010_potted_meat_can 011_banana 019_pitcher_base 021_bleach_cleanser 024_bowl 025_mug
    035_power_drill 036_wood_block 037_scissors 040_large_marker 051_large_clamp 052_extra_large_clamp 061_foam_brick
"""
YCB_NAME_BY_ID = dict(enumerate(_YCB_NAMES.split(), start=1))
"""Names of DexYCB's objects by their numbers in ``ycb_ids`` and ``seg``."""
PACKED_K = np.array([[616.641, 0.0, 308.548], [0.0, 616.258, 248.523], [0.0, 0.0, 1.0]])
"""Intrinsics of one of DexYCB's cameras [px], assumed for packed files: these do not state their camera."""
PACKED_ARRAYS = ("sequence", "object", "offset", "obj_quat_xyzw", "obj_trans", "joints", "hand_valid")


@dataclass(frozen=True)
class ObjectPoses:
    """The poses of one object over a sequence, and the frames in which they are known."""

    T_cam_obj: Float[ndarray, "N 4 4"]
    known: Bool[ndarray, "N"]


@dataclass(frozen=True)
class DexYcbRecording:
    """A sequence: a hand takes one of the objects on a table."""

    file: Path
    """The file that was read."""
    subject: str
    sequence: str
    camera: str
    side: Side
    grasped: str
    """Name of the grasped object."""
    objects: dict[str, ObjectPoses]
    """All objects by name, the grasped one included."""
    joints: Float[ndarray, "N 21 3"]
    """Joints in the camera frame [m], in this package's order."""
    hand_known: Bool[ndarray, "N"]
    K: Float[ndarray, "3 3"]
    T_table_cam: Float[ndarray, "4 4"] | None = None
    """Pose of the static camera in the frame of a tag on the table, z up; None where unknown."""


@dataclass(frozen=True)
class StaticCamera:
    """A further camera of a sequence."""

    serial: str
    K: Float[ndarray, "3 3"]
    T_cam_view: Float[ndarray, "4 4"]
    """Its pose in the frame of the sequence's camera."""


@dataclass(frozen=True)
class UnreadSequence:
    """A sequence with its readers, which raise ``InputError`` for malformed files. Picklable."""

    name: str
    read: Callable[[], DexYcbRecording]
    further_cameras: Callable[[str], list[StaticCamera]] | None = None
    """Read the other cameras than that of a serial number; None for packed files, which have one."""


def find_dexycb_sequences(root: Path) -> list[UnreadSequence]:
    """Find the sequences of a packed file, of a folder of packed files, or of DexYCB's own layout.

    Raises ``InputError`` where no sequence is found, and for malformed packed files.
    """
    packed = [root] if root.is_file() else list_files(root, (".npz",))
    if packed:
        return [sequence for file in packed for sequence in _find_packed_sequences(file)]
    if not root.is_dir():
        raise InputError(root, "", "no such file or folder", "DexYCB's folder, or a packed file of its sequences")
    folders = [meta.parent for meta in sorted(root.glob("*/*/meta.yml"))]
    if not folders:
        raise InputError(root, "", "no <subject>/<sequence>/meta.yml and no .npz in it", "DexYCB's own layout")
    return [
        UnreadSequence(
            f"{f.parent.name}/{f.name}", partial(_read_sequence_folder, root, f), partial(_further_cameras, root, f)
        )
        for f in folders
    ]


def _find_packed_sequences(path: Path) -> list[UnreadSequence]:
    """Read the sequences of a packed file. The hand's side is inferred from how the fingers bend."""
    stored = arrays.read(path, PACKED_ARRAYS.__contains__)
    names, grasped = _parse_texts(path, stored, "sequence"), _parse_texts(path, stored, "object")
    q = arrays.floats(path, stored, "obj_quat_xyzw", (-1, 4))
    N, S = len(q), len(names)
    t = arrays.floats(path, stored, "obj_trans", (N, 3))
    joints = arrays.floats(path, stored, "joints", (N, 21, 3))[:, JOINT_ORDERS["ho3d"]]
    known = _check_array(path, stored, "hand_valid", (N,), "b")
    offset = _check_array(path, stored, "offset", (S + 1,), "iu").astype(np.int64)
    if len(grasped) != S:
        raise InputError(path, "object", f"{len(grasped)} names", f"{S}, one for each sequence")
    if offset[0] != 0 or offset[-1] != N or np.any(np.diff(offset) <= 0):
        raise InputError(path, "offset", shorten_value(offset.tolist()), f"rising numbers from 0 to {N}")
    if np.diff(offset).max() > MAX_SEQUENCE_FRAMES:
        got = f"a sequence of {np.diff(offset).max()} frames"
        raise InputError(path, "offset", got, f"at most {MAX_SEQUENCE_FRAMES}")
    lengths = np.linalg.norm(q, axis=1)
    if np.abs(lengths - 1.0).max() > 1e-2:
        input_length = f"a quaternion of length {lengths[np.argmax(np.abs(lengths - 1.0))]:.3g}"
        raise InputError(path, "obj_quat_xyzw", input_length, "unit quaternions")
    sequences = []
    for i, (name, obj) in enumerate(zip(names, grasped, strict=True)):
        rows = slice(offset[i], offset[i + 1])
        subject, _, sequence = name.partition("/")
        if not (_is_clip_name_part(subject) and _is_clip_name_part(sequence)):
            raise InputError(path, f"sequence[{i}]", shorten_value(name), "<subject>/<sequence>")
        if not _is_clip_name_part(obj):
            raise InputError(path, f"object[{i}]", shorten_value(obj), "the name of an object")
        T_cam_obj = se3.rigid(se3.from_quaternion(np.roll(q[rows], 1, axis=1)), t[rows])
        objects = {obj: ObjectPoses(T_cam_obj, np.ones(len(T_cam_obj), dtype=bool))}
        side, hands = infer_hand_side(joints[rows][known[rows]]), (joints[rows], known[rows])
        read = partial(DexYcbRecording, path, subject, sequence, "", side, obj, objects, *hands, PACKED_K)
        sequences.append(UnreadSequence(name, read))
    return sequences


def infer_hand_side(joints: Float[ndarray, "N 21 3"]) -> Side:
    """Find the side of a hand: fingers bend towards the palm, which is on opposite sides of left and right hands."""
    wrist, index, pinky = joints[:, 0], joints[:, 5], joints[:, 17]
    towards = np.cross(index - wrist, pinky - wrist)  # the palm of a right hand, the back of a left one
    bent = (joints[:, [8, 12, 16, 20]] - joints[:, [5, 9, 13, 17]]).sum(axis=1)
    return "right" if np.sum(towards * bent) > 0.0 else "left"


def _read_sequence_folder(root: Path, folder: Path) -> DexYcbRecording:
    """Read a sequence of DexYCB's own layout, in the camera that sees most of the grasped object at the end."""
    path = folder / "meta.yml"
    if not (_is_clip_name_part(folder.parent.name) and _is_clip_name_part(folder.name)):
        raise InputError(path, "", "a folder name that clip names cannot contain", "<subject>/<sequence>")
    meta = read_yaml(path)
    frames = parse_integer(path, meta, "num_frames", 1, MAX_SEQUENCE_FRAMES)
    ids = _parse_list(path, meta, "ycb_ids")
    if not all(isinstance(i, int) and i in YCB_NAME_BY_ID for i in ids) or len(set(ids)) < len(ids):
        raise InputError(path, "ycb_ids", shorten_value(ids), "different numbers of DexYCB's objects, 1 to 21")
    grasped = ids[parse_integer(path, meta, "ycb_grasp_ind", 0, len(ids) - 1)]
    sides: dict[object, Side] = {"left": "left", "right": "right"}
    side = _parse_list(path, meta, "mano_sides")[0]
    if side not in sides:
        raise InputError(path, "mano_sides", shorten_value(side), "left or right")
    serial = _best_camera(folder, _serials_with_folder(folder, meta), grasped, frames)
    labels = [_read_label(folder / serial / _label_name(n), len(ids)) for n in range(frames)]
    pose_y, joints = (np.stack(a) for a in zip(*labels, strict=True))
    T_cam_obj = np.zeros((frames, len(ids), 4, 4))
    T_cam_obj[:, :, :3], T_cam_obj[:, :, 3, 3] = pose_y, 1.0
    known = np.any(pose_y != 0.0, axis=(2, 3))  # unknown poses are 0
    bad = np.argwhere(known & ~se3.is_rigid(T_cam_obj))
    if bad.size:
        label = folder / serial / _label_name(bad[0, 0])
        raise InputError(label, "pose_y", "a matrix that is not a rigid motion", "[R | t]")
    return DexYcbRecording(
        file=folder,
        subject=folder.parent.name,
        sequence=folder.name,
        camera=serial,
        side=sides[side],
        grasped=YCB_NAME_BY_ID[grasped],
        objects={YCB_NAME_BY_ID[id_]: ObjectPoses(T_cam_obj[:, k], known[:, k]) for k, id_ in enumerate(ids)},
        joints=joints,
        hand_known=~np.all(joints == -1.0, axis=(1, 2)),  # unknown hands are -1
        K=read_colour_intrinsics(_intrinsics_file(root, serial)),
        T_table_cam=_find_table_camera(root, path, meta, serial),
    )


def _serials_with_folder(folder: Path, meta: dict[str, object]) -> list[str]:
    """List the cameras that have a folder."""
    serials = [str(serial) for serial in _parse_list(folder / "meta.yml", meta, "serials")]
    found = [serial for serial in serials if serial.isalnum() and (folder / serial).is_dir()]
    if not found:
        raise InputError(folder, "serials", f"no folder of any of {', '.join(map(printable, serials))}", "one at least")
    return list(dict.fromkeys(found))


def _further_cameras(root: Path, folder: Path, own: str) -> list[StaticCamera]:
    """Read the other cameras that have a folder. Raises ``InputError``, also without a calibration."""
    path = folder / "meta.yml"
    meta = read_yaml(path)
    others = [serial for serial in _serials_with_folder(folder, meta) if serial != own]
    T_master_own, *T_master = read_extrinsics(_extrinsics_file(root, path, meta), [own, *others])
    return [
        StaticCamera(serial, read_colour_intrinsics(_intrinsics_file(root, serial)), se3.inverse(T_master_own) @ T)
        for serial, T in zip(others, T_master, strict=True)
    ]


def _intrinsics_file(root: Path, serial: str) -> Path:
    return root / "calibration" / "intrinsics" / f"{serial}_640x480.yml"


def _best_camera(folder: Path, serials: list[str], grasped: int, frames: int) -> str:
    """Choose the camera with the most pixels of the grasped object in the last frame."""
    if len(serials) == 1:
        return serials[0]
    pixels = {}
    for serial in serials:
        path = folder / serial / _label_name(frames - 1)
        seg = _check_array(path, arrays.read(path, {"seg"}.__contains__), "seg", DEXYCB_IMAGE_SIZE_PX[::-1], "iu")
        pixels[serial] = np.count_nonzero(seg == grasped)
    return max(pixels, key=pixels.__getitem__)


def _label_name(frame: int) -> str:
    return f"labels_{frame:06d}.npz"


def _read_label(path: Path, objects: int) -> tuple[Float[ndarray, "O 3 4"], Float[ndarray, "21 3"]]:
    """Read the poses of the objects and the joints of the hand; ``joint_3d`` is in this package's order."""
    stored = arrays.read(path, {"pose_y", "joint_3d"}.__contains__)
    joints = arrays.floats(path, stored, "joint_3d", (1, 21, 3))
    return arrays.floats(path, stored, "pose_y", (objects, 3, 4)), joints[0]


def read_table_camera(path: Path, serial: str) -> Float[ndarray, "4 4"]:
    """Read the pose of a camera in the frame of the tag on the table. Raises ``InputError``."""
    T_master_tag, T_master_cam = read_extrinsics(path, [TABLE_TAG, serial])
    return np.asarray(se3.inverse(T_master_tag) @ T_master_cam)


def _find_table_camera(root: Path, path: Path, meta: dict[str, object], serial: str) -> Float[ndarray, "4 4"] | None:
    """Read the camera's pose in the frame of the tag on the table; None without a calibration."""
    file = _extrinsics_file(root, path, meta)
    return read_table_camera(file, serial) if file.is_file() else None


def _extrinsics_file(root: Path, path: Path, meta: dict[str, object]) -> Path:
    """Return the file of the cameras' poses, which may be missing."""
    name = meta.get("extrinsics", "")
    if not (isinstance(name, str) and (name == "" or _is_clip_name_part(name))):
        raise InputError(path, "extrinsics", shorten_value(name), "the name of a calibration")
    return root / "calibration" / f"extrinsics_{name}" / "extrinsics.yml"


def _parse_list(path: Path, entry: dict[str, object], key: str) -> list[int]:
    value = entry.get(key)
    if not isinstance(value, list) or not value:
        raise InputError(path, key, shorten_value(value), "a list that is not empty")
    return value


def _parse_texts(path: Path, arrays: dict[str, ndarray], key: str) -> list[str]:
    array = _check_array(path, arrays, key, (-1,), "U")
    try:
        return [str(text) for text in array.tolist()]
    except ValueError as error:
        raise InputError(path, key, f"text that does not decode ({error})", "names") from error


def _check_array(
    path: Path, arrays: dict[str, ndarray], key: str, shape: tuple[int, ...], kinds: str
) -> Shaped[ndarray, "..."]:
    """Check an array's presence, kind and shape; -1 stands for any length above 0."""
    array = arrays.get(key)
    if array is None:
        raise InputError(path, key, "no such array", f"an array of shape {shape}")
    alike = (a == b or (b == -1 and a > 0) for a, b in zip(array.shape, shape, strict=False))
    if array.dtype.kind not in kinds or array.ndim != len(shape) or not all(alike):
        raise InputError(path, key, f"{array.dtype} of shape {array.shape}", f"kind {kinds} of shape {shape}")
    return array


def _is_clip_name_part(text: str) -> bool:

    return is_portable_name(text) and re.fullmatch(r"[\w.-]+", text) is not None and "--" not in text
