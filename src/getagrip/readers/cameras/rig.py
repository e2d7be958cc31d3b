"""Rigs: several cameras in one frame, each with its name, pinhole, lens and pose; by a calibration's files.

Lengths are metres and images are counted from the corner of the first pixel, so that readers add 0.5 to OpenCV's
principal points. A camera stands still: a model with several images of a camera must agree on its pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.views import MAX_VIEWS
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.geometry import se3
from getagrip.geometry.lens import Distortion
from getagrip.io import files
from getagrip.readers.cameras.camera_path import CameraPath, Pinhole

MIN_RIG_EXTENT_M, MAX_RIG_EXTENT_M = 0.005, 20.0
"""Bounds of the largest distance between two cameras of a rig [m]: of other ones the unit is wrong."""
MAX_LENGTH = 1e9
"""Maximum length in the file's unit."""
STATIC_CAMERA_TOLERANCE, STATIC_CAMERA_TOLERANCE_DEG = 0.02, 1.0
"""Maximum difference of a camera's poses in several images, as a fraction of the rig's extent, and in degrees."""


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera of a rig.

    Attributes:
        name: name of the camera.
        pinhole: intrinsics and lens.
        T_world_cam: (4, 4) pose of the camera, camera frame (x right, y down, z forward) to the rig's frame [m].
    """

    name: str
    pinhole: Pinhole
    T_world_cam: Float[ndarray, "4 4"]


@dataclass(frozen=True, eq=False)
class Rig:
    """Several calibrated cameras in one frame.

    Attributes:
        source: description of the files, in words.
        path: the file or folder, for errors.
        cameras: the cameras, of different names.
        metric: True if lengths are in metres, as far as the format says.
    """

    source: str
    path: Path
    cameras: tuple[RigCamera, ...]
    metric: bool

    def __post_init__(self) -> None:
        names = self.names
        if not 2 <= len(names) <= MAX_VIEWS or len({*names}) < len(names):
            raise InputError(self.path, "", f"{len(names)} cameras", f"2 to {MAX_VIEWS}, of different names")
        for one in self.cameras:
            if not files.is_portable_name(one.name):
                raise InputError(self.path, files.printable(one.name), "such a name", "one that can name a folder")
            if not np.abs(one.T_world_cam).max() < MAX_LENGTH or not se3.is_rigid(one.T_world_cam):
                raise InputError(self.path, one.name, "a pose that is not a rigid motion", "a rotation and a place")
            if not one.pinhole.is_possible:
                got = f"K {one.pinhole.K.tolist()} of images {one.pinhole.size}"
                raise InputError(self.path, one.name, got, "focal lengths above 0 and a size in pixels")

    @property
    def names(self) -> list[str]:
        """Names of the cameras."""
        return [one.name for one in self.cameras]

    @property
    def extent(self) -> float:
        """Largest distance between two cameras."""
        at = np.array([one.T_world_cam[:3, 3] for one in self.cameras])
        return float(np.linalg.norm(at[:, None] - at, axis=-1).max())

    def scaled(self, metres: float | None) -> Rig:
        """Return the rig with ``metres`` per unit of length, if stated. Raises ``InputError`` by its extent."""
        rig = self
        if metres is not None:
            moved = [replace(one, T_world_cam=_scaled(one.T_world_cam, metres)) for one in self.cameras]
            rig = replace(self, cameras=tuple(moved), metric=True)
        if not MIN_RIG_EXTENT_M <= rig.extent <= MAX_RIG_EXTENT_M:
            got = f"cameras that are {rig.extent:.4g} m apart"
            hint = "are these millimetres? --metres 0.001" if rig.extent > MAX_RIG_EXTENT_M else "--metres, of a unit"
            raise InputError(self.path, "", got, f"{MIN_RIG_EXTENT_M:g} to {MAX_RIG_EXTENT_M:g} m; {hint}")
        return rig

    def camera(self, name: str, option: str) -> RigCamera:
        """Return a camera. Raises ``UsageError`` for an unknown one, as the value of an ``option``."""
        if name not in self.names:
            raise unknown_choice_error(option, name, self.names)
        return next(one for one in self.cameras if one.name == name)

    def own(self, name: str | None, views: Sequence[str]) -> RigCamera:
        """Return the clip's own camera: the one of a ``name``, else the only one that is no view.

        Raises ``UsageError``.
        """
        if name is not None:
            if name in views:
                raise UsageError(f"--camera must be another camera than the views' (got {name})")
            return self.camera(name, "--camera")
        others = [one for one in self.names if one not in views]
        if len(others) != 1:
            said = f"{', '.join(others)}" if others else "every camera is a view"
            raise UsageError(f"missing --camera: the clip's own camera in {self.path}: {said}")
        return self.camera(others[0], "--camera")

    def T_own_view(self, own: RigCamera, view: RigCamera) -> Float[ndarray, "4 4"]:
        """Return the pose of a camera in another one's frame [m]."""
        return np.asarray(se3.inverse(own.T_world_cam) @ view.T_world_cam)

    def K_and_lens(self, one: RigCamera, size: tuple[int, int]) -> tuple[Float[ndarray, "3 3"], Distortion]:
        """Return a camera's intrinsics for images of a ``size``, and its lens.

        Raises ``InputError`` for images of another shape, and for a lens that cannot be undistorted.
        """
        if one.pinhole.lens is None:
            expected = "one of OpenCV's models; undistort the images, and write the calibration of the new ones"
            raise InputError(self.path, one.name, "a lens of another model", expected)
        try:
            one.pinhole.check_images(self.path, size)
        except InputError as error:
            expected = f"{error.expected} (are these images of {one.name}?)"
            raise InputError(error.path, f"{one.name}.{error.key}", error.got, expected) from error
        return one.pinhole.resized(size), one.pinhole.lens


def _scaled(T: Float[ndarray, "4 4"], metres: float) -> Float[ndarray, "4 4"]:
    return se3.rigid(T[:3, :3], metres * T[:3, 3])


def rig_of_images(path: CameraPath) -> Rig | None:
    """Return the rig of a model of still cameras' images; None for a path whose images have no names or intrinsics.

    Cameras have the names of their images' folders or, of images in one folder, of the images.
    Raises ``InputError`` for a camera that moves.
    """
    if not path.names or not path.pinholes:
        return None
    each = [PurePosixPath(name.replace("\\", "/")) for name in path.names]
    several = len({one.parent for one in each}) > 1
    names = [one.parent.name if several else one.stem for one in each]
    found: dict[str, int] = {}
    extent = float(np.linalg.norm(np.ptp(path.T_world_cam[:, :3, 3], axis=0)))
    for row, name in enumerate(names):
        T, first = path.T_world_cam[row], path.T_world_cam[found.setdefault(name, row)]
        apart = float(np.linalg.norm(T[:3, 3] - first[:3, 3]))
        turned = float(np.degrees(se3.angle_between(T[:3, :3], first[:3, :3])))
        if apart > STATIC_CAMERA_TOLERANCE * extent or turned > STATIC_CAMERA_TOLERANCE_DEG:
            got = f"a camera that moves by {apart:.3g} and turns by {turned:.3g}° between its images"
            raise InputError(path.path, files.printable(name), got, "one that stands still: a single image of each")
    pinholes = path.pinholes * len(names) if len(path.pinholes) == 1 else path.pinholes
    cameras = [RigCamera(name, pinholes[row], path.T_world_cam[row]) for name, row in found.items()]
    if len(cameras) < 2:
        return None
    return Rig(path.source, path.path, tuple(cameras), path.metric)
