"""EgoDex's episodes: ``transforms/<joint>`` (N, 4, 4) in ARKit's world [m], with ``transforms/camera``, in HDF5.

The camera's axes are x right, y down, z forward. Its 25 joints of a hand are SOMA's: those of the four fingers begin at
the wrist's end of the metacarpal bones, which are not used. ``confidences`` are not used, either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.hands.trackers.estimates import Estimate, Estimates, Request
from getagrip.hands.trackers.joint_checks import check_before_camera
from getagrip.hands.trackers.recognition import Sample
from getagrip.hands.trackers.tracker import Tracker, frames_of_images, only_file
from getagrip.io import extras
from getagrip.provenance import estimated

PARTS = ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
FINGERS = ("Thumb", "IndexFinger", "MiddleFinger", "RingFinger", "LittleFinger")
JOINTS = ["Hand", *(f"{finger}{part}" for finger in FINGERS for part in PARTS)]
"""Its names of this package's 21 joints, behind the side."""
MOST_FRAMES = 200_000
DEPTH = estimated("the headset's joints, before its own camera")


@dataclass(frozen=True)
class EgoDex(Tracker):
    """EgoDex's joints of ARKit."""

    name = "EgoDex"
    takes = "its episodes (HDF5)"
    looks_for = "*.hdf5 with transforms/camera"
    layouts = ("*.hdf5",)

    def recognises(self, sample: Sample) -> str:
        return "an episode of EgoDex" if sample.path.suffix.lower() in (".hdf5", ".h5") else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the joints in those of the episode's frames that the clip has."""
        path = only_file(paths, "joints of an episode")
        joints = joints_of(path, request.side)
        check_before_camera(path, joints)
        frames = frames_of_images(path, {}, len(joints), request)
        found = [
            Estimate(path, frame, DEPTH, None, hand)
            for frame, hand in zip(frames, joints, strict=True)
            if frame is not None
        ]
        return Estimates(request.side, tuple(found), scale="the joints, as ARKit has them")


def joints_of(path: Path, side: Side) -> Float[ndarray, "T 21 3"]:
    """Read the 21 joints of a side before the camera [m]. Raises ``InputError``, and ``UsageError`` without h5py."""
    h5py = extras.load("h5py", "egodex", f"{path.name} (HDF5)")
    try:
        with h5py.File(path, "r") as episode:
            T_world_cam = _poses(path, episode, "camera")
            points = [_poses(path, episode, f"{side}{joint}")[:, :3, 3] for joint in JOINTS]
    except (OSError, RuntimeError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "an HDF5 file of EgoDex") from error
    if len({len(each) for each in (T_world_cam, *points)}) > 1:
        raise InputError(path, "transforms", "arrays of different lengths", "one pose for each frame")
    return se3.transform(se3.inverse(T_world_cam), np.stack(points, axis=1))


def _poses(path: Path, episode: object, name: str) -> Float[ndarray, "T 4 4"]:
    """Read a joint's poses; a link to another file is no data of this one."""
    key = f"transforms/{name}"
    data = episode.get(key) if hasattr(episode, "get") and not _leads_out(episode, key) else None
    shape: tuple[int, ...] = tuple(getattr(data, "shape", ()))
    if data is None or len(shape) != 3 or shape[1:] != (4, 4) or not 0 < shape[0] <= MOST_FRAMES or data.external:
        raise InputError(path, key, f"the shape {shape}" if shape else "no such array", "poses (N, 4, 4)")
    poses = np.asarray(data[()], dtype=float)
    if not np.isfinite(poses).all():
        raise InputError(path, key, "numbers that are not finite", "poses (N, 4, 4)")
    return poses


def _leads_out(episode: object, key: str) -> bool:
    """Return whether a name is a link out of the file."""
    import h5py

    parts = key.split("/")
    links = [episode.get("/".join(parts[:n]), getlink=True) for n in (1, 2)]  # type: ignore[attr-defined]
    return any(isinstance(link, h5py.ExternalLink) for link in links)
