"""Cameras from other programs' files, recognised by names and keys: ``read_camera_path(path)``, ``read_rig(path)``.

A path is of one camera that may move, a rig is several that stand still. Each format is a function in a file of this
folder, which returns None for other formats, and a line in ``CAMERA_FORMATS`` or ``RIG_FORMATS``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.readers.cameras import capture_apps, colmap, opencv_rig, rig_files, slam
from getagrip.readers.cameras.camera_path import CameraPath
from getagrip.readers.cameras.rig import Rig, rig_of_images

__all__ = ["CAMERA_FORMATS", "RIG_FORMATS", "CameraPath", "Rig", "holds_rig_only", "read_camera_path", "read_rig"]

CAMERA_FORMATS: dict[str, Callable[[Path], CameraPath | None]] = {
    "colmap (images.txt or images.bin, cameras.txt or cameras.bin)": colmap.read_colmap,
    "epic-fields (a JSON with camera and images)": colmap.read_epic_fields,
    "vipe (pose/*.npz and intrinsics/*.npz)": slam.read_vipe,
    "megasam (cam_c2w in an .npz)": slam.read_megasam,
    "hawor (SLAM/hawor_slam_w_scale_*.npz, or traj in an .npz, as of DROID-SLAM)": slam.read_hawor,
    "nerfstudio (transforms.json, as of Polycam, too)": capture_apps.read_nerfstudio,
    "record3d (metadata.json)": capture_apps.read_record3d,
    "arkit (frames' .json with cameraPoseARFrame)": capture_apps.read_arkit,
    "aria (closed_loop_trajectory.csv)": capture_apps.read_aria,
    "tum (lines of 8 numbers)": slam.read_tum,
    "kitti (lines of 12 numbers)": slam.read_kitti,
}


def read_camera_path(path: Path, quaternion: str = "") -> CameraPath:
    """Read a camera trajectory in any known format.

    ``quaternion``, ``xyzw`` or ``wxyz``, is the user's order of quaternions in lines of numbers. Raises ``InputError``
    for malformed files and unknown formats, ``UsageError`` where several formats fit.
    """
    if not path.exists():
        raise InputError(path, "", "no such file or folder", "a camera's path")
    lines = {key: partial(read, quaternion=quaternion) for key, read in CAMERA_FORMATS.items() if read is slam.read_tum}
    with arrays.convert_to_input_errors(path):
        found = {name: one for name, read in (CAMERA_FORMATS | lines).items() if (one := read(path)) is not None}
    if quaternion and not {*lines} & {*found}:
        raise UsageError(f"--quaternion cannot be used with {path}: it has no lines of quaternions")
    if len(found) > 1:
        raise UsageError(f"{path}: several formats fit ({', '.join(found)}); name the file")
    if not found:
        expected = f"one of {', '.join(CAMERA_FORMATS)}; other paths can be written as lines of time x y z qx qy qz qw"
        raise InputError(path, "", "files of no known program", expected)
    return next(iter(found.values()))


def _of_images(path: Path, read: Callable[[Path], CameraPath | None]) -> Rig | None:
    """Read the rig of a model's images."""
    found = read(path)
    return None if found is None else rig_of_images(found)


RIG_FORMATS: dict[str, Callable[[Path], Rig | None]] = {
    "cameras by name (a JSON, NAME: T_world_cam and K)": rig_files.read_own_rig,
    "kalibr (camchain.yaml)": rig_files.read_kalibr,
    "opencv (YAML or JSON of camera_matrix, R and T, a file or a folder)": opencv_rig.read_opencv_rig,
    "dexycb (extrinsics.yml)": rig_files.read_dexycb_rig,
    "colmap (images.txt or images.bin, cameras.txt or cameras.bin)": partial(_of_images, read=colmap.read_colmap),
    "nerfstudio (transforms.json)": partial(_of_images, read=capture_apps.read_nerfstudio),
}


def read_rig(path: Path, metres: float | None = None) -> Rig:
    """Read a calibration of several cameras in any known format, in ``metres`` of a unit of length, if stated.

    Raises ``InputError`` for malformed files, unknown formats and cameras at impossible distances, ``UsageError`` where
    several formats fit.
    """
    if not path.exists():
        raise InputError(path, "", "no such file or folder", "a calibration of several cameras")
    if metres is not None and not 0.0 < metres < 1e6:
        raise UsageError(f"--metres must be above 0 (got {metres:g})")
    with arrays.convert_to_input_errors(path):
        found = {name: rig for name, read in RIG_FORMATS.items() if (rig := read(path)) is not None}
    if len(found) > 1:
        raise UsageError(f"{path}: several formats fit ({', '.join(found)}); name the file")
    if not found:
        raise InputError(path, "", "a calibration of no known program", f"one of {', '.join(RIG_FORMATS)}")
    return next(iter(found.values())).scaled(metres)


def holds_rig_only(path: Path) -> bool:
    """Return whether a file is a calibration of several cameras, and no path of one. Raises ``InputError``."""
    with arrays.convert_to_input_errors(path):
        rigs = [read for read in RIG_FORMATS.values() if not isinstance(read, partial)]
        if not path.exists() or any(read(path) is not None for read in CAMERA_FORMATS.values()):
            return False
        return any(read(path) is not None for read in rigs)
