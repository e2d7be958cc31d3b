"""HO-3D (Hampali et al., CVPR 2020), versions 2 and 3: a right hand and a YCB object, true poses by fitting to RGB-D.

The labels are read as HO-3D's own scripts (https://github.com/shreyashampali/ho3d) describe them, and converted from
OpenGL's axes (y up, z towards the eye) to this package's:

    <split>/<sequence>/meta/<frame>.pkl     objName, objRot (rotation vector), objTrans [m], camMat, handJoints3D [m],
                                            and with MANO handPose (48,), handTrans [m], handBeta (10,)

    evaluation.txt, evaluation_xyz.json     <sequence>/<frame> in each line, and their joints (N, 21, 3) [m]

    calibration/<recording>/calibration/    version 3, of recordings by several cameras: <recording>0, 1, ... are their
                                            sequences
        cam_orders.txt                      the cameras' digits
        cam_<i>_intrinsics.txt              fx, fy, ppx, ppy of the i-th of them
        trans_<i>.txt                       (4, 4): its pose in a frame that all share [m]

Frames without labels hold None. In the evaluation split ``handJoints3D`` is the wrist only; the joints were published
later as a list, which is read where it lies beside the splits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit_joints import fit_joints
from getagrip.io import pickles
from getagrip.io.arrays import from_lists
from getagrip.io.files import is_portable_name, read_any_json, read_bytes, shorten_value
from getagrip.io.options import Flag, OptionalFolder
from getagrip.io.terminal import format_count
from getagrip.readers.datasets import mano_tracks
from getagrip.readers.datasets.cutting import ALL_KNOWN_FRAMES, CutSource, SeveralCameras
from getagrip.readers.datasets.dataset import Note, Part
from getagrip.readers.datasets.mano_tracks import check_mano_numbers
from getagrip.readers.datasets.tracks import (
    GRASPS_WITHIN_10_MM,
    SequenceSource,
    Track,
    TrackPiece,
    check_length,
    check_pinhole,
    intrinsics_from_opencv,
)
from getagrip.readers.datasets.views import TrackView, with_further_views
from getagrip.stable_grasps.definition import GraspOptions

HO3D_IMAGE_SIZE_PX = (640, 480)
"""Width and height of HO-3D's images [px]."""
HO3D_FPS = 30.0
R_CV_OPENGL = np.diag([1.0, -1.0, -1.0])
"""Rotation from OpenGL's camera axes to this package's."""
EVALUATION_SPLIT = "evaluation"
MAX_CALIBRATION_BYTES = 2**16
"""Maximum size of a file of the calibration; HO-3D's have at most a few hundred bytes."""
MAX_WRIST_DISTANCE_M = 0.005
"""Maximum distance between the wrists of a frame's labels and of the evaluation list [m]."""


class Ho3dFrame(NamedTuple):
    """The labels of one frame, in this package's axes."""

    number: int
    name: str
    """Name of the object."""
    T_cam_obj: Float[ndarray, "4 4"]
    K: Float[ndarray, "3 3"]
    joints: Float[ndarray, "21 3"]
    pose: Float[ndarray, "48"]
    """MANO's pose, like its translation and shape; zeros without MANO files."""
    translation: Float[ndarray, "3"]
    shape: Float[ndarray, "10"]


@dataclass(frozen=True, kw_only=True)
class Ho3d(SeveralCameras):
    """HO-3D: every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = GRASPS_WITHIN_10_MM
    """Definition of a stable grasp."""

    meshes: mano_tracks.Models = None
    """Folder of the YCB models."""
    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl; without, the generic hand is fitted to the joints."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences of HO-3D, all splits."""
        models = mano_tracks.ycb_models_folder(self.root, self.meshes)
        mano = None if self.mano is None else mano_tracks.mano_folder(self.mano, "HO-3D")
        found = sorted({file.parent.parent for file in self.root.glob("*/*/meta/*.pkl")})
        if not found:
            raise InputError(self.root, "", "no <split>/<sequence>/meta/<frame>.pkl in it", "HO-3D's folder")
        read = partial(_read_sequence, models=models, mano=mano, views=self.views)
        return [SequenceSource(f"{f.parent.name}/{f.name}", partial(read, f)) for f in found]


@dataclass(frozen=True, kw_only=True)
class Ho3dEvaluation(Ho3d):
    """HO-3D's evaluation split: a clip of each sequence, in all frames in which hand and object are known."""

    whole: Flag = True

    def sources(self) -> list[SequenceSource]:
        """List the sequences of the evaluation split."""
        for name in (f"{EVALUATION_SPLIT}.txt", f"{EVALUATION_SPLIT}_xyz.json"):
            if not (self.root / name).is_file():
                raise InputError(self.root, "", f"no {name} in it", "HO-3D's folder with the list of evaluated joints")
        found = [one for one in super().sources() if one.name.startswith(f"{EVALUATION_SPLIT}/")]
        if not found:
            raise InputError(self.root, "", f"no {EVALUATION_SPLIT}/<sequence>/meta in it", "HO-3D's folder")
        return found

    def parts(self, note: Note) -> Sequence[Part]:
        """List the sequences, each one clip with masks."""
        return [CutSource(source, _uncut_pieces, 2) for source in self.sources()]


def _uncut_pieces(tracks: Iterable[Track], note: Note) -> Iterator[TrackPiece]:
    for track in tracks:
        yield TrackPiece(track, track.name, ALL_KNOWN_FRAMES)


def _read_sequence(
    folder: Path, note: Note, *, models: Path, mano: Path | None, views: int | Literal["all"]
) -> Iterator[Track]:

    name = f"{folder.parent.name}/{folder.name}"
    frames, unknown, joints = [], 0, {}
    listed = folder.parent.parent / f"{EVALUATION_SPLIT}_xyz.json"
    if folder.parent.name == EVALUATION_SPLIT and listed.is_file():
        joints, mano = _evaluation_joints(listed), None  # MANO's parameters are not public
    files = sorted((folder / "meta").glob("*.pkl"))
    check_length(folder, "meta", len(files))
    for file in files:
        frame = _read_frame(file, mano is not None, joints.get(f"{folder.name}/{file.stem}"))
        if frame is None:
            unknown += 1
        else:
            frames.append(frame)
    if unknown:
        note(f"{name}: {format_count(unknown, 'frame')} without the pose of the hand or of the object: skipped")
    if not frames:
        return
    grasped = frames[0].name
    other = next((frame for frame in frames if frame.name != grasped or not np.allclose(frame.K, frames[0].K)), None)
    if other is not None:
        label = folder / "meta" / f"{other.number:04d}.pkl"
        raise InputError(label, "objName or camMat", "another", "one per sequence")
    mesh = mano_tracks.read_ycb_mesh(models, grasped)
    letters = re.match(r"[A-Za-z]+", folder.name)
    track = Track(
        file=folder,
        subject=letters[0] if letters else folder.name,
        sequence=folder.name,
        category=grasped,
        side="right",
        fps=HO3D_FPS,
        numbers=np.array([frame.number for frame in frames]),
        digits=4,
        size=HO3D_IMAGE_SIZE_PX,
        K=intrinsics_from_opencv(frames[0].K),
        hand=_fit_generic_hand(folder, frames) if mano is None else _pose_mano_hand(mano, frames),
        T_cam_obj=np.stack([frame.T_cam_obj for frame in frames]),
        mesh=mesh,
        provenance={
            "source": f"HO-3D, {name}",
            "licence": "made from HO-3D, for non-commercial research only",
            "hands": "the generic hand, fitted to HO-3D's 21 joints over all frames: not the true surface"
            if mano is None
            else "HO-3D's MANO parameters (true), by the user's MANO files",
            "camera": "HO-3D's",
            "scale": "YCB mesh, true size",
        },
    )
    yield with_further_views(track, views, partial(_further_views, folder, len(frames)), note)


def _further_views(folder: Path, frames: int) -> list[TrackView]:
    """Read the other cameras of a sequence's recording that have a sequence; none without a calibration.

    Raises ``InputError``.
    """
    root, recording, own = folder.parent.parent, folder.name[:-1], folder.name[-1:]
    calibration = root / "calibration" / recording / "calibration"
    if not recording or not calibration.is_dir():
        return []
    file = calibration / "cam_orders.txt"
    order = [f"{number:.0f}" for number in _read_numbers(file)]
    if own not in order or len(set(order)) < len(order):
        raise InputError(file, "", shorten_value(order), f"different digits of cameras, {own} among them")
    T_shared_own = _read_camera_pose(calibration, order.index(own))
    return [
        TrackView(
            name=f"{recording}{digit}",
            K=intrinsics_from_opencv(_read_camera_intrinsics(calibration / f"cam_{place}_intrinsics.txt")),
            size=HO3D_IMAGE_SIZE_PX,
            T_cam_view=np.tile(se3.inverse(T_shared_own) @ _read_camera_pose(calibration, place), (frames, 1, 1)),
            camera=f"HO-3D's, of the sequence {recording}{digit}",
        )
        for place, digit in enumerate(order)
        if digit != own and next(root.glob(f"*/{recording}{digit}/meta"), None) is not None
    ]


def _read_camera_pose(calibration: Path, place: int) -> Float[ndarray, "4 4"]:
    file = calibration / f"trans_{place}.txt"
    numbers = _read_numbers(file)
    T = numbers.reshape(4, 4) if numbers.size == 16 else np.zeros((4, 4))
    if not se3.is_rigid(T):
        raise InputError(file, "", shorten_value(numbers.tolist()), "a rotation and a translation [m], 4 x 4")
    return T


def _read_camera_intrinsics(file: Path) -> Float[ndarray, "3 3"]:
    text = read_bytes(file, MAX_CALIBRATION_BYTES).decode("utf-8", "replace")
    values = dict(re.findall(r"\b(fx|fy|ppx|ppy)\s*:\s*(\d+(?:\.\d*)?(?:e[-+]?\d+)?)", text))
    if len(values) < 4 or not all(float(value) < 1e6 for value in values.values()):
        raise InputError(file, "", shorten_value(text), "fx, fy, ppx and ppy, as fx: 614.6")
    fx, fy, cx, cy = (float(values[key]) for key in ("fx", "fy", "ppx", "ppy"))
    return check_pinhole(file, "", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))


def _read_numbers(file: Path) -> Float[ndarray, "n"]:
    """Read the numbers of a text file. Raises ``InputError``."""
    text = read_bytes(file, MAX_CALIBRATION_BYTES).decode("utf-8", "replace")
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise InputError(file, "", shorten_value(text), "numbers") from error
    if not numbers.size or not np.abs(numbers).max() < 1e6:
        raise InputError(file, "", shorten_value(text), "numbers")
    return numbers


@cache
def _evaluation_joints(listed: Path) -> dict[str, Float[ndarray, "21 3"]]:
    names = read_bytes(listed.with_name(f"{EVALUATION_SPLIT}.txt")).decode("utf-8", "replace").split()
    joints = from_lists(read_any_json(listed))
    if joints is None or joints.shape != (len(names), 21, 3) or joints.dtype.kind != "f":
        got = "no array of numbers" if joints is None else f"an array of shape {joints.shape}"
        raise InputError(listed, "", got, f"21 joints for each of the {len(names)} lines of {EVALUATION_SPLIT}.txt")
    return dict(zip(names, joints, strict=True))


def _read_frame(file: Path, with_mano: bool, listed: Float[ndarray, "21 3"] | None) -> Ho3dFrame | None:
    """Read the labels of a frame; None where the object or the hand is unknown.

    ``listed`` are the frame's joints in the evaluation list. Raises ``InputError``, also for a different wrist.
    """
    value = pickles.read_pickle_file(file, "the labels of a frame of HO-3D")
    if not file.stem.isdigit():
        raise InputError(file, "", f"the name {file.name!r}", "<number>.pkl")
    rotation, joints = value.get("objRot", 0), value.get("handJoints3D", 0)
    if listed is not None and isinstance(joints, ndarray) and joints.size == 3:
        apart = float(np.linalg.norm(joints.reshape(3) - listed[0]))
        if not apart <= MAX_WRIST_DISTANCE_M:
            got = f"a wrist {apart:.3g} m from the one in {EVALUATION_SPLIT}_xyz.json"
            raise InputError(file, "handJoints3D", got, "the same")
        value = {**value, "handJoints3D": listed}
        joints = listed
    if rotation is None or joints is None or (isinstance(joints, ndarray) and joints.size == 3):
        return None
    name = value.get("objName")
    if not isinstance(name, str) or not is_portable_name(name):
        raise InputError(file, "objName", shorten_value(name), "the name of a YCB object")
    T_cam_obj = se3.rigid(
        R_CV_OPENGL @ se3.exp_so3(check_mano_numbers(file, value, "objRot", (3,))),
        R_CV_OPENGL @ check_mano_numbers(file, value, "objTrans", (3,)),
    )
    K = check_pinhole(file, "camMat", check_mano_numbers(file, value, "camMat", (3, 3)))
    joints = check_mano_numbers(file, value, "handJoints3D", (21, 3)) @ R_CV_OPENGL
    sizes = {"handPose": 48, "handTrans": 3, "handBeta": 10}
    mano = [check_mano_numbers(file, value, key, (n,)) if with_mano else np.zeros(n) for key, n in sizes.items()]
    return Ho3dFrame(int(file.stem), name, T_cam_obj, K, joints, *mano)


def _fit_generic_hand(folder: Path, frames: list[Ho3dFrame]) -> HandTrack:

    try:
        return fit_joints(generic.load("right"), np.stack([frame.joints for frame in frames]), "ho3d").hand
    except UsageError as error:
        raise InputError(folder / "meta", "handJoints3D", str(error), "the 21 joints of a hand") from error


def _pose_mano_hand(mano: Path, frames: list[Ho3dFrame]) -> HandTrack:
    pose, t = np.stack([frame.pose for frame in frames]), np.stack([frame.translation for frame in frames])
    hand, T_cam = mano_tracks.load_mano_hand(mano, "right"), se3.rigid(R_CV_OPENGL)
    return mano_tracks.mano_hand_track(hand, pose[:, :3], pose[:, 3:], t, frames[0].shape, True, T_cam)
