"""HRDexDB (Lim et al., 2026), its human part: a right hand grasps an object before calibrated cameras.

The files are read as its own viewer (https://github.com/snuvclab/HRDexDB) and the published folder have them:

    human/<object>/<scene>/hand/mano/<frame>.obj            MANO's right hand in the world [m]
    human/<object>/<scene>/cam_param/intrinsics.json        by camera: intrinsics_undistort (3 x 3), width, height
    human/<object>/<scene>/cam_param/extrinsics.json        by camera: world to camera, (3 x 4) or (4 x 4) [m]
    human/<object>/<scene>/cam_param/ego_calib.json         optional, cameras on the head: intrinsics, and extrinsics by
                                                            camera and frame
    human/<object>/<scene>/C2R.npy                          optional: (4, 4), robot to world; z is up of the robot
    object_6d_pose_v2/human/<object>_<scene>.npz            frame_<frame> (4, 4): object to world [m]
    assets/mesh_v2/<object>/<object>.obj                    [m]

or, as its viewer describes the folder, poses in ``human/<object>/<scene>/object_6d/pose_<number>.txt``, one for each
hand, and the mesh in ``assets/mesh``. Videos, and the robots' part, are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack, World
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import MAX_MESH_BYTES, read_mesh
from getagrip.geometry.mesh_files.obj import parse_obj
from getagrip.hands.model import HandModel
from getagrip.io import arrays
from getagrip.io.files import is_portable_name, printable, read_bytes, read_json, shorten_value
from getagrip.io.options import OptionalFolder
from getagrip.readers.datasets import mano_tracks
from getagrip.readers.datasets.cutting import SeveralCameras
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.mano_tracks import check_mano_numbers
from getagrip.readers.datasets.realsense import parse_integer
from getagrip.readers.datasets.track_files import hand_to_camera
from getagrip.readers.datasets.tracks import (
    SequenceSource,
    Track,
    check_length,
    check_pinhole,
    intrinsics_from_opencv,
)
from getagrip.readers.datasets.views import TrackView, share_in_image, with_further_views
from getagrip.readers.trackers.read_hands import make_mano_track, mano_joints
from getagrip.stable_grasps.definition import GraspOptions

HRDEXDB_GRASP_OPTIONS = GraspOptions(contact_mm=10.0, points="area")
"""Stable grasps of scanned objects, whose vertices are uneven."""
HRDEXDB_FPS = 30.0
HRDEXDB_PART = "human"
HRDEXDB_LAYOUTS = (("object_6d_pose_v2", "mesh_v2"), ("object_6d", "mesh"))
"""Folders of the objects' poses, and of the meshes they belong to, the preferred ones first."""
MAX_HRDEXDB_SIDE_PX = 8192
"""Maximum side of an image [px]."""
MAX_POSE_BYTES = 2**12
"""Maximum size of a file of one pose."""


@dataclass(frozen=True, kw_only=True)
class HrDexDb(SeveralCameras):
    """HRDexDB's human part: every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = HRDEXDB_GRASP_OPTIONS
    """Definition of a stable grasp."""

    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl."""
    camera: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: by the object)")] = ""
    """The clip's camera; by default the fixed one that shows the object's centre in most frames, of several the
    nearest."""

    def sources(self) -> list[SequenceSource]:
        """List the scenes below ``root``, the folder that holds ``human``, or a folder above it."""
        mano = mano_tracks.mano_folder(self.mano, "HRDexDB")
        base = next((place for place in (self.root, self.root / "v0") if (place / HRDEXDB_PART).is_dir()), self.root)
        found = sorted(folder.parent.parent for folder in base.glob(f"{HRDEXDB_PART}/*/*/hand/mano"))
        if not found:
            raise InputError(self.root, "", f"no {HRDEXDB_PART}/<object>/<scene>/hand/mano", "HRDexDB's folder")
        read = partial(_read_scene, base, mano=mano, camera=self.camera, views=self.views)
        return [SequenceSource(f"{folder.parent.name}/{folder.name}", partial(read, folder)) for folder in found]


@dataclass(frozen=True)
class HrDexDbCamera:
    """A camera of a scene."""

    name: str
    K: Float[ndarray, "3 3"]
    size: tuple[int, int]
    T_cam_world: Float[ndarray, "T 4 4"]
    known: Bool[ndarray, "T"]
    """True in frames in which its pose is known."""
    description: str


def _read_scene(
    base: Path, folder: Path, note: Note, *, mano: Path, camera: str, views: int | Literal["all"]
) -> Iterator[Track]:
    name, scene = folder.parent.name, folder.name
    if not (is_portable_name(name) and is_portable_name(scene)):
        raise InputError(folder, "", "a folder name that clip names cannot contain", "<object>/<scene>")
    hands = _numbered_files(folder / "hand" / "mano", r"(\d{1,8})\.obj")
    check_length(folder, "hand/mano", len(hands))
    found = _find_object(base, folder, list(hands))
    if found is None:
        note(f"{name}/{scene}: no poses of the object, or no mesh of the same version: skipped")
        return
    T_of, mesh_file = found
    numbers = np.array(sorted(hands.keys() & T_of.keys()), dtype=np.int64)
    if len(numbers) < 2:
        note(f"{name}/{scene}: hand and object are known in {len(numbers)} frames: skipped")
        return
    T_world_obj, mesh = np.stack([T_of[int(number)] for number in numbers]), read_mesh(mesh_file)
    hand = _read_hands([hands[int(number)] for number in numbers], mano)
    cameras = _read_cameras(folder / "cam_param", numbers)
    own = _choose_camera(folder, cameras, camera, se3.transform(T_world_obj, mesh.centre[None])[:, 0])
    rows = np.flatnonzero(own.known)
    T_cam_world = own.T_cam_world[rows]
    up = _read_up(folder / "C2R.npy")
    track = Track(
        file=folder,
        subject=HRDEXDB_PART,
        sequence=f"{name}_{scene}",
        category=name,
        side="right",
        fps=HRDEXDB_FPS,
        numbers=numbers[rows],
        digits=6,
        size=own.size,
        K=own.K,
        hand=hand_to_camera(hand.take(rows), T_cam_world),
        T_cam_obj=T_cam_world @ T_world_obj[rows],
        mesh=mesh,
        world=World(se3.inverse(T_cam_world), up),
        provenance={
            "source": f"HRDexDB, {HRDEXDB_PART}/{name}/{scene}",
            "licence": "made from HRDexDB; its own licence holds",
            "hands": "HRDexDB's MANO surface (true)",
            "camera": own.description,
            "scale": f"HRDexDB's {mesh_file.parent.parent.name}, true size",
        },
    )
    others = [other for other in cameras if other is not own and other.known.any()]
    yield with_further_views(track, views, partial(_further_views, own, others, rows), note)


def _further_views(own: HrDexDbCamera, others: Sequence[HrDexDbCamera], rows: Int[ndarray, "n"]) -> list[TrackView]:
    return [
        TrackView(
            name=other.name,
            K=other.K,
            size=other.size,
            T_cam_view=own.T_cam_world[rows] @ se3.inverse(other.T_cam_world[rows]),
            camera=other.description,
            known=other.known[rows],
        )
        for other in others
    ]


def _numbered_files(folder: Path, pattern: str) -> dict[int, Path]:
    """List the files whose names match, by the number in them."""
    matches = ((re.fullmatch(pattern, file.name), file) for file in sorted(folder.glob("*")))
    return {int(match[1]): file for match, file in matches if match is not None}


def _find_object(base: Path, folder: Path, hands: list[int]) -> tuple[dict[int, Float[ndarray, "4 4"]], Path] | None:
    """Read the object's poses in the world by frame, and find its mesh of the same version; None without either."""
    name, scene = folder.parent.name, folder.name
    for poses, meshes in HRDEXDB_LAYOUTS:
        mesh = base / "assets" / meshes / name / f"{name}.obj"
        places = (base / poses / HRDEXDB_PART / f"{name}_{scene}.npz", folder / f"{poses}.npz")
        packed = next((file for file in places if file.is_file()), None)
        texts = _numbered_files(folder / poses, r"pose_(\d{1,8})\.txt")
        if not mesh.is_file() or (packed is None and not texts):
            continue
        if packed is not None:
            return _read_packed_poses(packed), mesh
        if len(texts) != len(hands):
            raise InputError(folder / poses, "", f"{len(texts)} poses", f"{len(hands)}, one for each hand")
        read = (_check_pose(file, "", _read_text(file)) for _, file in sorted(texts.items()))
        return dict(zip(sorted(hands), read, strict=True)), mesh
    return None


def _read_packed_poses(file: Path) -> dict[int, Float[ndarray, "4 4"]]:
    stored = arrays.read(file, lambda key: re.fullmatch(r"frame_\d{1,8}", key) is not None)
    poses = {key: arrays.floats(file, stored, key, (4, 4), kinds="fiu") for key in stored}
    return {int(key.removeprefix("frame_")): _check_pose(file, key, T) for key, T in poses.items()}


def _read_text(file: Path) -> Float[ndarray, "4 4"]:
    """Read 16 numbers of a text file."""
    text = read_bytes(file, MAX_POSE_BYTES).decode("utf-8", "replace")
    try:
        return np.array([float(word) for word in text.split()]).reshape(4, 4)
    except ValueError as error:
        raise InputError(file, "", shorten_value(text), "16 numbers") from error


def _check_pose(file: Path, key: str, T: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"]:
    if not se3.is_rigid(T):
        raise InputError(file, key, shorten_value(T.tolist()), "a rotation and a translation [m], 4 x 4")
    return T


def _read_hands(files: Sequence[Path], mano: Path) -> HandTrack:
    """Read MANO's surface in each frame, before the world frame in place of a camera's. Raises ``InputError``."""
    model = mano_tracks.load_mano_hand(mano, "right").model
    vertices = np.stack([_read_hand(file, model) for file in files])
    return make_mano_track(model, vertices, np.stack([mano_joints(model, one) for one in vertices]))


def _read_hand(file: Path, model: HandModel) -> Float[ndarray, "V 3"]:
    vertices, _ = parse_obj(file, read_bytes(file, MAX_MESH_BYTES))
    if vertices.shape != model.template.shape:
        raise InputError(file, "", f"{len(vertices)} vertices", f"MANO's {len(model.template)}")
    corners = (vertices - vertices.mean(axis=0))[model.faces]
    if not np.linalg.det(corners).sum() > 0.0:  # the volume: faces of a left hand are wound the other way
        raise InputError(file, "", "a surface that is inside out", "MANO's right hand")
    return vertices


def _read_cameras(folder: Path, numbers: Int[ndarray, "T"]) -> list[HrDexDbCamera]:
    """Read the fixed cameras, then those on the head. Raises ``InputError``."""
    cameras = []
    intrinsics, extrinsics = (read_json(folder / f"{kind}.json") for kind in ("intrinsics", "extrinsics"))
    for name in sorted(intrinsics.keys() & extrinsics.keys()):
        T = _read_extrinsics(folder / "extrinsics.json", extrinsics, name)
        known = np.ones(len(numbers), dtype=bool)
        described = f"fixed camera {name}, undistorted"
        K, size = _read_intrinsics(folder / "intrinsics.json", intrinsics, name)
        cameras.append(HrDexDbCamera(name, K, size, np.tile(T, (len(numbers), 1, 1)), known, described))
    worn = folder / "ego_calib.json"
    if not worn.is_file():
        return cameras
    content = read_json(worn)
    parts = [content.get(kind) for kind in ("intrinsics", "extrinsics")]
    if not all(isinstance(part, dict) for part in parts):
        raise InputError(worn, "", shorten_value(content), "intrinsics and extrinsics by camera")
    lenses, paths = (part if isinstance(part, dict) else {} for part in parts)
    for name in sorted((lenses.keys() & paths.keys()) - {camera.name for camera in cameras}):
        path = paths[name] if isinstance(paths[name], dict) else {}
        keys = {int(key): key for key in path if re.fullmatch(r"[0-9]{1,8}", key)}
        known = np.array([int(number) in keys for number in numbers])
        T = np.tile(np.eye(4), (len(numbers), 1, 1))
        for row in np.flatnonzero(known):
            T[row] = _read_extrinsics(worn, path, keys[int(numbers[row])])
        K, size = _read_intrinsics(worn, lenses, name)
        cameras.append(HrDexDbCamera(name, K, size, T, known, f"camera {name} on the head, undistorted"))
    return cameras


def _read_intrinsics(file: Path, of: Mapping[str, object], name: str) -> tuple[Float[ndarray, "3 3"], tuple[int, int]]:
    if not is_portable_name(name):
        raise InputError(file, printable(name), "the name of a camera", "one that can be part of a folder's")
    entry = of[name]
    if not isinstance(entry, dict):
        raise InputError(file, name, shorten_value(entry), "intrinsics of the camera")
    K = check_mano_numbers(file, entry, "intrinsics_undistort", (3, 3), name)
    width, height = (parse_integer(file, entry, key, 1, MAX_HRDEXDB_SIDE_PX) for key in ("width", "height"))
    return intrinsics_from_opencv(check_pinhole(file, f"{name}.intrinsics_undistort", K)), (width, height)


def _read_extrinsics(file: Path, of: Mapping[str, object], name: str) -> Float[ndarray, "4 4"]:
    value = arrays.from_lists(of[name])
    T = np.eye(4)
    if value is None or value.shape not in ((3, 4), (4, 4)) or value.dtype.kind not in "fi":
        raise InputError(file, printable(name), shorten_value(of[name]), "a matrix, 3 x 4 or 4 x 4")
    T[: len(value)] = value
    return _check_pose(file, name, T)


def _choose_camera(
    folder: Path, cameras: Sequence[HrDexDbCamera], name: str, places: Float[ndarray, "T 3"]
) -> HrDexDbCamera:
    """Choose the camera of a name, or the fixed one that shows most places in the world, of several the nearest."""
    if name:
        chosen = next((camera for camera in cameras if camera.name == name and camera.known.any()), None)
        if chosen is None:
            known = ", ".join(camera.name for camera in cameras if camera.known.any())
            raise UsageError(f"--camera must be one of {folder}'s, {known} (got {name})")
        return chosen
    fixed = [camera for camera in cameras if camera.known.all()]
    if not fixed:
        raise InputError(folder / "cam_param", "", "no camera", "intrinsics and extrinsics of cameras")

    def of(camera: HrDexDbCamera) -> tuple[float, float]:
        seen = se3.transform(camera.T_cam_world, places[:, None])[:, 0]
        return share_in_image(camera.K, camera.size, seen), -float(np.linalg.norm(np.median(seen, axis=0)))

    return max(fixed, key=of)


def _read_up(file: Path) -> Float[ndarray, "3"] | None:
    """Read the direction up in the world, the robot's z; None without the robot's pose."""
    if not file.is_file():
        return None
    T = arrays.floats(file, {"": arrays.parse_npy(file, "", read_bytes(file))}, "", (4, 4))
    return np.asarray(_check_pose(file, "", T)[:3, 2])
