"""HaWoR's hands before the camera: ``cam_space/<0 left, 1 right>/<first>_<last>.json``, or an ``.npz`` of that layout.

``init_root_orient`` (T, 3, 3), ``init_hand_pose`` (T, 15, 3, 3), ``init_betas`` (T, 10) and ``init_trans`` (T, 3) of
the images ``first`` to ``last``, counted from 0 among HaWoR's images, and optionally ``joints_2d``. Rotations of left
hands are not mirrored. The camera has HaWoR's focal length and a central principal point. The focal length decides the
depth and is not in the file: it is read from ``est_focal.txt`` in HaWoR's folder, or stated by the user.

``world_space_res.pth`` is a file of joblib, which can run code; the error about it shows a line of Python that converts
it to ``.npz``: ``pred_trans`` (2, T, 3), ``pred_rot`` (2, T, 3), ``pred_hand_pose`` (2, T, 45), ``pred_betas``
(2, T, 10), ``pred_valid`` (2, T), the left hand first, in the world of ``SLAM/hawor_slam_w_scale_*.npz``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip.match_frames import frame_of, has_number_offset
from getagrip.errors import InputError, MissingOptionError
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.io.files import shorten_value
from getagrip.provenance import estimated
from getagrip.readers.trackers import records
from getagrip.readers.trackers.dynhamr import mano_root_joint, world_to_camera_mano
from getagrip.readers.trackers.estimates import (
    Camera,
    Estimate,
    Estimates,
    HandParameters,
    Request,
    WeakPerspective,
    to_rotation_matrices,
)
from getagrip.readers.trackers.records import Record, Sample, record_numbers
from getagrip.readers.trackers.tracker import Tracker, frames_of_images, frames_of_rows

HAWOR_FOCAL_FILE = "est_focal.txt"
SIDE_FOLDERS = ("0", "1")
"""Folders in ``cam_space`` of the left and the right hand."""
HAWOR_WORLD_KEYS = ("pred_trans", "pred_rot", "pred_hand_pose", "pred_betas")
"""Names of the items of the list in ``world_space_res.pth``; ``pred_valid`` is the last item."""
HAWOR_CAMERA_KEYS = ("init_root_orient", "init_hand_pose", "init_trans", "init_betas")


@dataclass(frozen=True)
class HaWoR(Tracker):
    """HaWoR's hands before the camera. HaWoR's focal length is required."""

    name = "HaWoR"
    takes = "its folder, or its cam_space files"
    looks_for = "cam_space/<0 or 1>/*.json with init_trans; pred_trans, pred_rot and pred_hand_pose in an .npz"
    layouts = ("world_space_res.npz", "cam_space/[01]/*.json", "[01]/*.json")

    def recognises(self, sample: Sample) -> str:
        if sample.has(*HAWOR_CAMERA_KEYS):
            return "HaWoR's hands before the camera (cam_space)"
        return "HaWoR's hands in the world" if sample.has(*HAWOR_WORLD_KEYS) else ""

    estimator_focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="")] = None
    """HaWoR's focal length."""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        found = list[Estimate]()
        for path in paths:
            if path.parent.name in SIDE_FOLDERS and path.parent.name != SIDE_FOLDERS[request.side == "right"]:
                continue
            record, focal = records.read_tracker_record(path), self._focal(path)
            if HAWOR_WORLD_KEYS[0] in record:
                found += _world_estimates(path, record, focal, request)
                continue
            T = count_hawor_frames(path, record)
            seen = records.seen_joints(path, record, T)
            for n, frame in enumerate(self._frames(path, record, T, request)):
                if frame is not None:
                    parameters = hawor_frame_parameters(path, record, n, T)
                    hand = hawor_estimate(path, frame, parameters, request.camera(frame), focal)
                    found.append(hand._replace(seen=None if seen is None else seen[n]))
        return Estimates(request.side, tuple(found))

    def _focal(self, path: Path) -> float:
        """Return HaWoR's focal length [px], stated or from ``est_focal.txt``. Raises ``UsageError`` if unknown."""
        if self.estimator_focal is not None:
            return self.estimator_focal
        notes = (folder / HAWOR_FOCAL_FILE for folder in path.parents[:3])
        noted = next((note for note in notes if note.is_file()), None)
        if noted is None:
            raise MissingOptionError("missing --estimator-focal: the focal length of HaWoR's run [px]")
        noted = files.inside(noted.parent, HAWOR_FOCAL_FILE, "", "a focal length")
        text = files.read_bytes(noted, 100).decode(errors="replace").strip()
        try:
            focal = float(text)
        except ValueError:
            focal = 0.0
        if not 0.0 < focal < records.MAX_RECORD_VALUE:
            raise InputError(noted, "", shorten_value(text), "a focal length [px]")
        return focal

    def _frames(self, path: Path, record: Record, count: int, request: Request) -> list[int | None]:
        """Return the frame index of each row, by ``frames`` or by the file's name."""
        named = re.fullmatch(r"(\d{1,9})_(\d{1,9})", path.stem)
        if "frames" in record or named is None:
            return frames_of_rows(path, record, count, request)
        first, last = int(named[1]), int(named[2])
        if last - first + 1 != count:
            raise InputError(path, "init_trans", f"{count} frames", f"{last - first + 1}, as the file's name says")
        names = [str(n) for n in range(first, last + 1)]
        if request.ask_first:  # the frame of image 0 is not stated: in a whole video it is frame 1
            of_video = [str(n) for n in range(first + 1, last + 2)]
            if has_number_offset(request.frames, of_video):
                request.check_numbers(path, names)
            names = of_video
        return [frame_of(name, request.frames) for name in names]


def _world_estimates(path: Path, record: Record, focal: float, request: Request) -> Iterator[Estimate]:
    """Yield the hands of one side in ``world_space_res``, before the camera of the SLAM file beside it."""
    found = sorted((path.parent / "SLAM").glob("hawor_slam_w_scale_*.npz"))
    if not found:
        raise InputError(path.parent / "SLAM", "", "no hawor_slam_w_scale_*.npz", "the camera's path, in a world")
    row, given = int(request.side == "right"), np.shape(record["pred_trans"])
    T = given[1] if len(given) == 3 and given[1] > 0 else 1
    t = record_numbers(path, record, "pred_trans", (2, T, 3))
    valid = record_numbers(path, record, "pred_valid", (2, T))[row] if "pred_valid" in record else np.ones(T)
    slam = files.inside(path.parent, f"SLAM/{found[-1].name}", "", "HaWoR's SLAM")
    T_cam_world = se3.inverse(slam_poses(slam))
    if len(T_cam_world) != T:
        raise InputError(slam, "traj", f"{len(T_cam_world)} poses", f"{T}, one for each frame of {path.name}")
    R = record_numbers(path, record, "pred_rot", (2, T, 3))[row]
    pose = record_numbers(path, record, "pred_hand_pose", (2, T, 45))[row]
    betas = record_numbers(path, record, "pred_betas", (2, T, 10))[row]
    for n, frame in enumerate(frames_of_images(path, record, T, request)):
        if frame is not None and valid[n] > 0.5:
            root = mano_root_joint(request.mano, request.side, betas[n])
            turned, moved = world_to_camera_mano(T_cam_world[n], se3.exp_so3(R[n]), t[row, n], root)
            seen = {"init_root_orient": turned, "init_hand_pose": pose[n], "init_trans": moved, "init_betas": betas[n]}
            yield hawor_estimate(path, frame, seen, request.camera(frame), focal)


def slam_poses(path: Path) -> Float[ndarray, "T 4 4"]:
    """Read ``T_world_cam`` of HaWoR's SLAM [m]: ``traj`` (T, 7), a position and a quaternion (x, y, z, w); ``scale``.

    Raises ``InputError``.
    """
    record = records.read_tracker_record(path)
    traj = record_numbers(path, record, "traj", (-1, 7))
    scale = float(record_numbers(path, record, "scale", ())) if "scale" in record else 1.0
    return se3.rigid(se3.from_quaternion(traj[:, [6, 3, 4, 5]]), scale * traj[:, :3])


def count_hawor_frames(path: Path, record: Record) -> int:
    """Return the number of frames in a file. Raises ``InputError``."""
    return len(record_numbers(path, record, "init_trans", (-1, 3)))


def hawor_frame_parameters(path: Path, record: Record, n: int, frames: int) -> Record:
    """Return the parameters of frame ``n``. Raises ``InputError``."""
    shapes = {"init_root_orient": ((3, 3), (3,)), "init_hand_pose": ((15, 3, 3), (15, 3), (45,))}
    shapes |= {"init_trans": ((3,),), "init_betas": ((10,),)}
    return {
        key: record_numbers(path, record, key, *((frames, *s) for s in shapes[key]))[n] for key in HAWOR_CAMERA_KEYS
    }


def hawor_estimate(path: Path, frame: int, record: Record, camera: Camera, focal: float) -> Estimate:
    """Convert one frame to a hand; ``focal`` [px] is HaWoR's own. Raises ``InputError``."""
    t = record_numbers(path, record, "init_trans", (3,))
    if not t[2] > 0:
        raise InputError(path, "init_trans", f"the depth {t[2]:g}", "a hand before the camera, above 0")
    fingers = record_numbers(path, record, "init_hand_pose", (15, 3, 3), (15, 3), (45,))
    matrices = to_rotation_matrices(path, "init_hand_pose", fingers if fingers.ndim > 1 else fingers.reshape(15, 3), 1)
    pose = se3.log_so3(matrices).reshape(45)
    orient = record_numbers(path, record, "init_root_orient", (3, 3), (3,))
    R = to_rotation_matrices(path, "init_root_orient", orient, 0)
    weak = WeakPerspective.of_translation(t, focal, np.array(camera.size) / 2.0)
    depth = f"HaWoR's translation, its focal length {focal:.6g} px divided out and the clip's put in"
    betas = record_numbers(path, record, "init_betas", (10,))
    return Estimate(path, frame, estimated(depth), HandParameters(R, pose, betas, weak.before(camera)))
