"""EgoDex's episodes: ``transforms/<joint>`` (N, 4, 4) in ARKit's world [m], with ``transforms/camera``, in HDF5.

The camera's axes are x right, y down, z forward. The 25 joints of a hand are SOMA's; the joints at the wrist's end of
the four metacarpal bones, and ``confidences``, are not used.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.io import plugins
from getagrip.io.files import printable
from getagrip.provenance import estimated
from getagrip.readers.trackers.estimates import Estimate, Estimates, Request
from getagrip.readers.trackers.read_hands import check_before_camera
from getagrip.readers.trackers.records import Sample
from getagrip.readers.trackers.tracker import Tracker, frames_of_images, only_file

if TYPE_CHECKING:
    from h5py import Dataset, Group

EGODEX_FINGER_JOINTS = ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
EGODEX_FINGERS = ("Thumb", "IndexFinger", "MiddleFinger", "RingFinger", "LittleFinger")
EGODEX_JOINTS = ["Hand", *(f"{finger}{part}" for finger in EGODEX_FINGERS for part in EGODEX_FINGER_JOINTS)]
"""EgoDex's names of this package's 21 joints, after the side."""
MAX_EPISODE_FRAMES = 200_000
MAX_CHUNK_BYTES = 32 * 2**20
"""Maximum unpacked size of a chunk of an array."""
SIZE_PRESERVING_FILTERS = (2, 3)
"""HDF5's numbers of the filters that keep the size: byte order and checksum."""
EGODEX_DEPTH_SOURCE = estimated("the headset's joints, before its own camera")


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
        path = only_file(paths, "joints of an episode")
        joints = read_egodex_joints(path, request.side)
        check_before_camera(path, joints)
        frames = frames_of_images(path, {}, len(joints), request)
        found = [
            Estimate(path, frame, EGODEX_DEPTH_SOURCE, None, hand)
            for frame, hand in zip(frames, joints, strict=True)
            if frame is not None
        ]
        return Estimates(request.side, tuple(found), scale="the joints, as ARKit has them")


def read_egodex_joints(path: Path, side: Side) -> Float[ndarray, "T 21 3"]:
    """Read the 21 joints of a side before the camera [m]. Raises ``InputError``, and ``UsageError`` without h5py."""
    h5py = plugins.import_extra("h5py", "egodex", f"{path.name} (HDF5)")
    try:
        with h5py.File(path, "r") as episode:
            T_world_cam = _read_joint_poses(path, episode, "camera")
            points = [_read_joint_poses(path, episode, f"{side}{joint}")[:, :3, 3].copy() for joint in EGODEX_JOINTS]
    except (OSError, RuntimeError, KeyError, TypeError, ValueError, zlib.error) as error:
        raise InputError(path, "", f"a damaged file ({error})", "an HDF5 file of EgoDex") from error
    if len({len(each) for each in (T_world_cam, *points)}) > 1:
        raise InputError(path, "transforms", "arrays of different lengths", "one pose for each frame")
    return se3.transform(se3.inverse(T_world_cam), np.stack(points, axis=1))


def _read_joint_poses(path: Path, episode: Group, name: str) -> Float[ndarray, "T 4 4"]:
    """Read a joint's poses, which must be stored in this file."""
    import h5py

    key, data = f"transforms/{name}", episode
    for part in key.split("/"):  # a soft link may lead to an external one
        if not isinstance(data, h5py.Group) or not isinstance(data.get(part, getlink=True), h5py.HardLink):
            raise InputError(path, key, "no such array", "poses (N, 4, 4)")
        data = data[part]
    shape: tuple[int, ...] = getattr(data, "shape", None) or ()
    if len(shape) != 3 or shape[1:] != (4, 4) or not 0 < shape[0] <= MAX_EPISODE_FRAMES or data.dtype.kind not in "fiu":
        got = f"{printable(str(getattr(data, 'dtype', 'a group')))} of shape {shape}"
        raise InputError(path, key, got, f"poses (N, 4, 4), numbers, of at most {MAX_EPISODE_FRAMES} frames")
    if data.external or data.is_virtual:
        raise InputError(path, key, "an array of another file", "poses in this file")
    _check_hdf5_chunks(path, key, data)
    poses = np.asarray(data[()], dtype=float)
    if not np.isfinite(poses).all():
        raise InputError(path, key, "numbers that are not finite", "poses (N, 4, 4)")
    return poses


def _check_hdf5_chunks(path: Path, key: str, data: Dataset) -> None:
    """Raise ``InputError`` for compressed chunks larger than the array: HDF5 unpacks them whole."""
    if data.chunks is None:
        return
    import h5py

    stored, size = data.id.get_create_plist(), math.prod(data.chunks) * data.dtype.itemsize
    filters = [stored.get_filter(n)[0] for n in range(stored.get_nfilters())]
    if len({*filters}) < len(filters) or not {*filters} <= {h5py.h5z.FILTER_DEFLATE, *SIZE_PRESERVING_FILTERS}:
        raise InputError(path, key, f"HDF5's filters {filters}", "plain or deflated numbers")
    sizes = [size]
    for n in range(data.id.get_num_chunks() if h5py.h5z.FILTER_DEFLATE in filters else 0):
        packed = data.id.read_direct_chunk(data.id.get_chunk_info(n).chunk_offset)[1]
        sizes.append(len(zlib.decompressobj().decompress(packed, MAX_CHUNK_BYTES + 1)))
    if max(sizes) > MAX_CHUNK_BYTES:
        raise InputError(path, key, f"a part of {max(sizes)} bytes", f"at most {MAX_CHUNK_BYTES}")
