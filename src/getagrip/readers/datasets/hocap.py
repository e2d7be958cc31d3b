"""HO-Cap (Wang et al., 2024): one or two hands with four objects, before eight RealSense cameras and a HoloLens.

The files are read as HO-Cap's own toolkit (https://github.com/IRVLUTD/HO-Cap) describes those of December 2024:

    calibration/intrinsics/<serial>.yaml        fx, fy, ppx, ppy of the colour camera
    calibration/extrinsics/<name>               poses of the cameras and of tag_1, the world frame, z up
    calibration/mano/<subject>.yaml             betas (10,)
    models/<object>/cleaned_mesh_10000.obj      [m]; or textured_mesh.obj
    <subject>/<sequence>/meta.yaml              num_frames, object_ids, mano_sides, subject_id, extrinsics, and the
                                                serial numbers and image sizes of the cameras
    <subject>/<sequence>/poses_m.npy            (2, T, 51): right and left hand in the world: rotation vector, 45
                                                coefficients of MANO's principal components, translation [m]
    <subject>/<sequence>/poses_o.npy            (O, T, 7): objects in the world: quaternion (x, y, z, w) and translation
    <subject>/<sequence>/poses_pv.npy           (T, 7): the HoloLens camera in the world, likewise

Unknown poses are -1. Images and labels of images are not read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack, World
from getagrip.clip.timeline import SIDES
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import read_mesh
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.io.files import is_portable_name, read_bytes, read_yaml, shorten_value
from getagrip.io.options import OptionalFolder
from getagrip.readers.datasets import mano_tracks
from getagrip.readers.datasets.cutting import SeveralCameras
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.mano_tracks import check_mano_numbers
from getagrip.readers.datasets.realsense import (
    parse_integer,
    parse_names,
    read_colour_intrinsics,
    read_extrinsics,
)
from getagrip.readers.datasets.track_files import hand_to_camera
from getagrip.readers.datasets.tracks import GRASPS_WITHIN_10_MM, MAX_SEQUENCE_FRAMES, SequenceSource, Track
from getagrip.readers.datasets.views import TrackView, with_further_views
from getagrip.stable_grasps.definition import GraspOptions

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface

HOCAP_FPS = 30.0
HOCAP_WORLD_TAG = "tag_1"
"""Tag whose frame is the world's, on the table."""
HOCAP_WORLD_UP = np.array([0.0, 0.0, 1.0])
HOCAP_SIDES: tuple[Side, Side] = ("right", "left")
"""Order of the hands in ``poses_m.npy``."""
HOCAP_MESHES = ("cleaned_mesh_10000.obj", "textured_mesh.obj")
"""Names of an object's mesh, the preferred one first."""
UNKNOWN_POSE = -1.0
"""Every number of an unknown pose."""
MAX_HOCAP_SIDE_PX = 8192
"""Maximum side of an image [px]."""


@dataclass(frozen=True, kw_only=True)
class HoCap(SeveralCameras):
    """HO-Cap: every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = GRASPS_WITHIN_10_MM
    """Definition of a stable grasp."""

    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl."""
    view: Annotated[int, arg(metavar="N")] = 1
    """The clip's camera: 0 the HoloLens on the head, 1 to 8 the RealSense cameras, as meta.yaml orders them."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences below ``root``."""
        if self.view < 0:
            raise UsageError(f"--view must be 0 (the HoloLens) or the number of a RealSense camera (got {self.view})")
        mano = mano_tracks.mano_folder(self.mano, "HO-Cap")
        found = sorted(file.parent for file in self.root.glob("*/*/meta.yaml"))
        if not found:
            first = next(self.root.glob("*/*/meta.json"), None) is not None
            got = "meta.json, of HO-Cap's first release, which is not read" if first else "no meta.yaml"
            raise InputError(self.root, "", f"{got} in it", "HO-Cap's folder with <subject>/<sequence>/meta.yaml")
        read = partial(_read_sequence, mano=mano, view=self.view, views=self.views)
        return [SequenceSource(f"{folder.parent.name}/{folder.name}", partial(read, folder)) for folder in found]


@dataclass(frozen=True)
class HoCapCamera:
    """A camera of a sequence."""

    name: str
    K: Float[ndarray, "3 3"]
    size: tuple[int, int]
    T_world_cam: Float[ndarray, "T 4 4"]
    known: Bool[ndarray, "T"]
    """True in frames in which its pose is known."""
    description: str


@dataclass(frozen=True)
class HoCapPoses:
    """The poses of hands and objects in the world, over a sequence; in unknown frames they mean nothing."""

    hands: dict[Side, HandTrack]
    """Before the world frame in place of a camera's."""
    hand_known: dict[Side, Bool[ndarray, "T"]]
    meshes: dict[str, Mesh]
    """Meshes of objects, by name."""
    T_world_obj: dict[str, Float[ndarray, "T 4 4"]]
    object_known: dict[str, Bool[ndarray, "T"]]


def _read_sequence(folder: Path, note: Note, *, mano: Path, view: int, views: int | Literal["all"]) -> Iterator[Track]:
    """Yield every hand with every object that has a mesh."""
    subject, sequence = folder.parent.name, folder.name
    path = folder / "meta.yaml"
    if not (is_portable_name(subject) and is_portable_name(sequence)):
        raise InputError(path, "", "a folder name that clip names cannot contain", "<subject>/<sequence>")
    meta = read_yaml(path)
    frames = parse_integer(path, meta, "num_frames", 1, MAX_SEQUENCE_FRAMES)
    sides = [side for side in SIDES if side in parse_names(path, meta, "mano_sides")]
    poses = _read_poses(folder, meta, sides, frames, mano, note)
    camera, others = _read_cameras(folder, meta, frames, view, views != 1)
    for name, mesh in poses.meshes.items():
        for side in sides:
            known = poses.hand_known[side] & poses.object_known[name] & camera.known
            rows = np.flatnonzero(known)
            if not rows.size:
                note(f"{subject}/{sequence}: {name} and the {side} hand are never known together: skipped")
                continue
            T_cam_world = se3.inverse(camera.T_world_cam[rows])
            track = Track(
                file=folder,
                subject=subject,
                sequence=sequence,
                category=name,
                side=side,
                fps=HOCAP_FPS,
                numbers=rows,
                digits=6,
                size=camera.size,
                K=camera.K,
                hand=hand_to_camera(poses.hands[side].take(rows), T_cam_world),
                T_cam_obj=T_cam_world @ poses.T_world_obj[name][rows],
                mesh=mesh,
                beside=partial(_other_surfaces, poses, side, name, camera),
                world=World(camera.T_world_cam[rows], HOCAP_WORLD_UP),
                provenance={
                    "source": f"HO-Cap, {subject}/{sequence}",
                    "licence": "made from HO-Cap, CC BY 4.0",
                    "hands": "HO-Cap's MANO parameters (true), by the user's MANO files",
                    "masks": "rendered from the true poses, hidden by the hands and by other objects with a mesh",
                    "camera": camera.description,
                    "scale": "HO-Cap's reconstructed mesh, true size",
                },
            )
            yield with_further_views(track, views, partial(_further_views, camera, others, rows), note)


def _further_views(own: HoCapCamera, others: Sequence[HoCapCamera], rows: Int[ndarray, "n"]) -> list[TrackView]:
    return [
        TrackView(
            name=other.name,
            K=other.K,
            size=other.size,
            T_cam_view=se3.inverse(own.T_world_cam[rows]) @ other.T_world_cam[rows],
            camera=other.description,
            known=other.known[rows],
        )
        for other in others
    ]


def _other_surfaces(
    poses: HoCapPoses, side: Side, name: str, camera: HoCapCamera, n: int
) -> tuple[list[Surface], list[Surface]]:
    """Pose the other hand, and the other objects that have a mesh, in the camera frame in frame n."""
    T_cam_world = se3.inverse(camera.T_world_cam[n])
    hands: list[Surface] = [
        (se3.transform(T_cam_world @ hand.T_cam_hand[n], hand.vertices[n]), hand.faces)
        for other, hand in poses.hands.items()
        if other != side and poses.hand_known[other][n]
    ]
    objects: list[Surface] = [
        (se3.transform(T_cam_world @ poses.T_world_obj[other][n], mesh.vertices), mesh.faces)
        for other, mesh in poses.meshes.items()
        if other != name and poses.object_known[other][n]
    ]
    return hands, objects


def _read_poses(
    folder: Path, meta: Mapping[str, object], sides: Sequence[Side], frames: int, mano: Path, note: Note
) -> HoCapPoses:
    root, path = folder.parent.parent, folder / "meta.yaml"
    (subject,) = parse_names(path, {"subject_id": [meta.get("subject_id")]}, "subject_id")
    betas_file = root / "calibration" / "mano" / f"{subject}.yaml"
    betas = check_mano_numbers(betas_file, read_yaml(betas_file), "betas", (10,))
    objects = parse_names(path, meta, "object_ids")
    meshes = {}
    for name in objects:
        file = next(
            (root / "models" / name / mesh for mesh in HOCAP_MESHES if (root / "models" / name / mesh).is_file()), None
        )
        if file is None:
            note(f"{folder.parent.name}/{folder.name}: no mesh of {name}: it is skipped and hides nothing")
        else:
            meshes[name] = read_mesh(file)
    of_hands, hand_known = _read_array(folder / "poses_m.npy", (len(HOCAP_SIDES), frames, 51))
    hands = {side: _pose_hand(of_hands[HOCAP_SIDES.index(side)], betas, mano, side) for side in sides}
    T_world_obj, object_known = _read_rigid(folder / "poses_o.npy", (len(objects), frames, 7))
    return HoCapPoses(
        hands=hands,
        hand_known={side: hand_known[HOCAP_SIDES.index(side)] for side in sides},
        meshes=meshes,
        T_world_obj=dict(zip(objects, T_world_obj, strict=True)),
        object_known=dict(zip(objects, object_known, strict=True)),
    )


def _pose_hand(values: Float[ndarray, "T 51"], betas: Float[ndarray, "10"], mano: Path, side: Side) -> HandTrack:
    """Pose a hand with the published MANO, faults included, as HO-Cap's own fit does."""
    hand = mano_tracks.load_mano_hand(mano, side, repaired=False)
    pose = hand.pose(values[:, 3:48], "pca", flat_hand_mean=False)
    return mano_tracks.mano_hand_track(hand, values[:, :3], pose, values[:, 48:], betas, True, np.eye(4))


def _read_cameras(
    folder: Path, meta: Mapping[str, object], frames: int, view: int, all_cameras: bool
) -> tuple[HoCapCamera, list[HoCapCamera]]:
    """Read the clip's camera, and the others if they are wanted. Raises ``InputError``."""
    path, calibration = folder / "meta.yaml", folder.parent.parent / "calibration"
    fixed, worn = _of_cameras(path, meta, "realsense"), _of_cameras(path, meta, "hololens")
    serials = parse_names(path, fixed, "serials")
    if view > len(serials):
        raise InputError(path, "realsense.serials", f"{len(serials)} cameras", f"--view 0 to {len(serials)}")
    wanted = [view, *(number for number in range(len(serials) + 1) if number != view)] if all_cameras else [view]
    (extrinsics,) = parse_names(path, {"extrinsics": [meta.get("extrinsics")]}, "extrinsics")
    used = [serials[number - 1] for number in wanted if number]
    T_master_world, *T_master_cam = read_extrinsics(calibration / "extrinsics" / extrinsics, [HOCAP_WORLD_TAG, *used])
    poses = dict(zip(used, T_master_cam, strict=True))
    cameras = []
    for number in wanted:
        if number:
            serial, size = serials[number - 1], _parse_size(path, fixed, "width", "height")
            T_world_cam = np.tile(se3.inverse(T_master_world) @ poses[serial], (frames, 1, 1))
            known, described = np.ones(frames, dtype=bool), f"RealSense {serial}, fixed"
        else:
            (serial,) = parse_names(path, {"serial": [worn.get("serial")]}, "serial")
            size = _parse_size(path, worn, "pv_width", "pv_height")
            T_world_cam, known = _read_rigid(folder / "poses_pv.npy", (frames, 7))
            described = f"{serial}, on the head"
            if known.any():
                T_world_cam = T_world_cam[_nearest(known)]
        K = read_colour_intrinsics(calibration / "intrinsics" / f"{serial}.yaml")
        cameras.append(HoCapCamera(serial, K, size, T_world_cam, known, described))
    return cameras[0], cameras[1:]


def _of_cameras(path: Path, meta: Mapping[str, object], kind: str) -> Mapping[str, object]:
    value = meta.get(kind)
    if not isinstance(value, dict):
        raise InputError(path, kind, shorten_value(value), "serial numbers and sizes of the cameras")
    return value


def _parse_size(path: Path, entry: Mapping[str, object], *keys: str) -> tuple[int, int]:
    width, height = (parse_integer(path, entry, key, 1, MAX_HOCAP_SIDE_PX) for key in keys)
    return width, height


def _nearest(known: Bool[ndarray, "T"]) -> Int[ndarray, "T"]:
    """Return the index of the nearest known frame of each frame."""
    at = np.flatnonzero(known)
    after = np.minimum(np.searchsorted(at, np.arange(len(known))), len(at) - 1)
    before = np.maximum(after - 1, 0)
    frames = np.arange(len(known))
    return np.where(np.abs(at[before] - frames) < np.abs(at[after] - frames), at[before], at[after])


def _read_array(file: Path, shape: tuple[int, ...]) -> tuple[Float[ndarray, "..."], Bool[ndarray, "..."]]:
    """Read poses, 0 where unknown, and where they are known. Raises ``InputError``."""
    stored = arrays.parse_npy(file, "", read_bytes(file))
    unknown = np.zeros(shape[:-1], dtype=bool)
    if stored.shape == shape and stored.dtype.kind == "f":
        unknown = np.asarray(np.all(stored == UNKNOWN_POSE, axis=-1) | np.all(np.isnan(stored), axis=-1))
        stored = np.where(unknown[..., None], 0.0, stored)
    return arrays.floats(file, {"": stored}, "", shape), ~unknown


def _read_rigid(file: Path, shape: tuple[int, ...]) -> tuple[Float[ndarray, "... 4 4"], Bool[ndarray, "..."]]:
    """Read rigid poses, the identity where unknown, and where they are known. Raises ``InputError``."""
    values, known = _read_array(file, shape)
    values[~known, 3] = 1.0
    lengths = np.linalg.norm(values[..., :4], axis=-1)
    worst = float(lengths.flat[np.argmax(np.abs(lengths - 1.0))])
    if not abs(worst - 1.0) < 1e-2:
        raise InputError(file, "", f"a quaternion of length {worst:.3g}", "unit quaternions (x, y, z, w)")
    return se3.rigid(se3.from_quaternion(np.roll(values[..., :4], 1, axis=-1)), values[..., 4:]), known
