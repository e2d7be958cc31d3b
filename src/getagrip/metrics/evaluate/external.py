"""Evaluation of other systems: a mesh per frame (systems without a CAD model), or poses of the clip's mesh.

Vertices of a mesh per frame do not correspond to those of the true one: there is no ADD. IOU is computed as for results
of this package; penetration and SCA with the clip's hand, unmoved, SCA on the comparable sides (``metrics.contact``). A
frame without a mesh has empty silhouette and contact.

Poses of the clip's mesh become a ``Reconstruction``, to which all metrics apply.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.clip import frame_indices
from getagrip.clip.match_frames import check_frame_numbers, frame_of, renumber_frames
from getagrip.clip.object_poses import poses_path_of_clip, read_poses
from getagrip.clip.read_arrays import MAX_CAMERA_RANGE_M, MIN_CAMERA_RANGE_M
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MESH_SUFFIXES, checked_mesh, drop_degenerate_faces, parse_mesh
from getagrip.io import files
from getagrip.metrics.contact import ContactDistances, Side, mesh_distances
from getagrip.metrics.evaluate.comparison import Comparison
from getagrip.metrics.evaluate.results import Evaluation, evaluate_comparison
from getagrip.metrics.mask import MaskIou, iou_of_meshes, iou_of_poses
from getagrip.result import FrameKind, Reconstruction, is_result, read_result
from getagrip.result.findings import format_probability

MeshFrame = Literal["camera", "hand"]
"""Frame of the vertices [m]: the clip's camera frame, or its hand frame."""
MAX_HAND_OBJECT_DISTANCE_M = 0.5
"""Maximum distance of an object's middle from the origin of the hand frame [m]."""
MAX_EVALUATED_FACES = 20_000_000
"""Maximum number of faces of all meshes of a clip."""
MISALIGNED_IOU_THRESHOLD, CONVENTION_IOU_THRESHOLD = 0.5, 0.6
"""Mean IOU below which poses may follow another convention, and from which on a convention is recognised."""
MISALIGNED_POSES_MESSAGE = (
    "no given pose meets the masks: are they inverse, in another frame, of another mesh or of another instance?"
)
N_CONVENTION_FRAMES = 6
"""Number of frames in which conventions are tried."""


def evaluate_meshes(meshes: Sequence[Mesh | None], clip: Clip, masks: Masks | None, method: str) -> Evaluation:
    """Compute IOU, SCA and penetration of a mesh for each of the clip's frames, in the hand frame.

    Additionally ``frames_without_mesh``, and ``closed``, the fraction of meshes without holes: for others the inside is
    uncertain.
    """
    return evaluate_comparison(_MeshComparison(clip, masks, tuple(meshes)), method, symmetry=None)


@dataclass(frozen=True, eq=False)
class _MeshComparison(Comparison):
    """A comparison with one mesh per frame, in the hand frame [m]."""

    frame_meshes: tuple[Mesh | None, ...]

    @property
    def meshes(self) -> tuple[Mesh | None, ...]:
        return self.frame_meshes

    @property
    def has_object(self) -> Bool[ndarray, "T"]:
        return np.array([mesh is not None for mesh in self.meshes])

    @cached_property
    def iou(self) -> MaskIou:
        poses = zip(self.meshes, self.clip.hand.T_cam_hand, strict=True)
        in_camera = [None if mesh is None else _transform_mesh(mesh, T_cam_hand) for mesh, T_cam_hand in poses]
        return iou_of_meshes(in_camera, self.clip.K, self.judged_masks)

    @property
    def distances(self) -> ContactDistances:
        return self._distances[0]

    @property
    def sides(self) -> Sequence[Side]:
        return self._distances[1]

    @cached_property
    def _distances(self) -> tuple[ContactDistances, tuple[Side, ...]]:
        return mesh_distances(self.meshes, self.clip.hand.vertices, self.clip.hand.faces)


def read_meshes(
    folder: Path, clip: Clip, frame: MeshFrame, first: int | None = None
) -> tuple[list[Mesh | None], list[InputError]]:
    """Read the mesh of each of the clip's frames, in the hand frame; also return the errors of unreadable files.

    Files are named like the frames, or by the same numbers; files of other frames are skipped. ``first`` is the number
    of the first frame's file, where numbers have another start. Raises ``InputError`` where no file is named like a
    frame or none can be read, ``UsageError`` where numbers seem to have another start.
    """
    named: dict[int, list[Path]] = {}
    paths = files.list_files(folder, MESH_SUFFIXES)
    frames = clip.frames if first is None else renumber_frames(clip.frames, first, "--first")
    check_frame_numbers(frames, [path.stem for path in paths], folder, "mesh", "--first" if first is None else "")
    for path in paths:
        n = frame_of(path.stem, frames)
        if n is not None:
            named.setdefault(n, []).append(path)
    if not named:
        expected = f"{clip.frames[0]}.obj (or {', '.join(MESH_SUFFIXES[1:])}) and so on, as the frames of {clip.name}"
        raise InputError(folder, "", "no mesh named like a frame", expected)
    meshes: list[Mesh | None] = [None] * len(clip)
    errors = []
    faces = 0
    for n, paths in named.items():
        try:
            if len(paths) > 1:
                raise InputError(paths[1], "", f"another mesh of the frame of {paths[0].name}", "one for each frame")
            meshes[n] = mesh = _read_mesh_in_hand(paths[0], frame, clip.hand.T_cam_hand[n])
        except InputError as error:
            errors.append(error)
            continue
        faces += len(mesh.faces)
        if faces > MAX_EVALUATED_FACES:
            got = f"meshes of more than {MAX_EVALUATED_FACES} faces in all"
            raise InputError(folder, "", got, "fewer; decimate them")
    if len(errors) == len(named):  # as with another unit or frame: the first error explains all
        raise errors[0]
    return meshes, errors


def _read_mesh_in_hand(path: Path, frame: MeshFrame, T_cam_hand: Float[ndarray, "4 4"]) -> Mesh:
    """Read a mesh in the hand frame, without degenerate faces, which systems often make."""
    vertices, faces = parse_mesh(path)
    mesh = checked_mesh(path, vertices, drop_degenerate_faces(vertices, faces))
    if frame == "camera":
        if not MIN_CAMERA_RANGE_M < mesh.centre[2] < MAX_CAMERA_RANGE_M:
            got = f"a mesh whose middle is {mesh.centre[2]:.3g} m before the camera"
            raise InputError(
                path, "vertices", got, f"{MIN_CAMERA_RANGE_M:g} to {MAX_CAMERA_RANGE_M:g} m; is it in the hand frame?"
            )
        mesh = _transform_mesh(mesh, se3.inverse(T_cam_hand))
    away = float(np.linalg.norm(mesh.centre))
    if frame == "hand" and away > MAX_HAND_OBJECT_DISTANCE_M:
        got = f"a mesh whose middle is {away:.3g} m from the hand's"
        raise InputError(path, "vertices", got, f"at most {MAX_HAND_OBJECT_DISTANCE_M:g} m; is it in the camera frame?")
    return mesh


def _transform_mesh(mesh: Mesh, T: Float[ndarray, "4 4"]) -> Mesh:
    return Mesh(se3.transform(T, mesh.vertices), mesh.faces)


@dataclass(frozen=True)
class ExternalSystem:
    """Another system by its name in tables, and its poses of many clips (``object_poses.poses_path_of_clip``)."""

    name: str
    root: Path

    def inputs(self, clip: str) -> dict[str, Path]:
        """Return the files with the poses of a clip, by name. Raises ``InputError``."""
        place = poses_path_of_clip(self.root, clip)
        inside = files.list_files(place) if place.is_dir() else [place]
        return {path.name: path for path in inside}

    def result(self, clip: Clip, masks: Masks | None, frames: Sequence[str]) -> Reconstruction:
        """Read the system's poses of a clip, in some of its frames. Raises ``InputError``.

        A result folder of this package that has all frames keeps its hand, its checks and its other content.
        """
        place = poses_path_of_clip(self.root, clip.name)
        if place.is_dir() and is_result(place):
            found, _ = read_result(place)
            if {*frames} <= {*found.frames}:
                return replace(found.take(np.array([found.frames.index(name) for name in frames])), method=self.name)
        return read_external_poses(place, self.name, clip, masks).take(clip.index_of(frames))


def read_external_poses(
    place: Path, name: str, clip: Clip, masks: Masks | None, first: int | None = None
) -> Reconstruction:
    """Read the poses of a file or folder as a result; arguments and errors are those of ``read_poses``.

    A frame without a pose gets the nearest frame's, fixed in the hand, and is marked as interpolated.
    """
    poses = read_poses(place, clip, first)
    scale = 1.0 if poses.scale is None else poses.scale
    kind: tuple[FrameKind, ...] = tuple("sampled" if found else "interpolated" for found in poses.found)
    iou = np.full(len(clip), np.nan)
    if masks is not None:
        iou = iou_of_poses(clip.mesh, scale, clip.hand.T_cam_hand @ poses.T_hand_obj, clip.K, masks).full
    notes = [f"poses of another system, from {place.name}"]
    if "interpolated" in kind:
        missing = f"no pose in {kind.count('interpolated')} of {len(clip)} frames"
        notes.append(f"{missing}: those of their neighbours, in the hand")
    if poses.scale is None and clip.scale == "free":
        notes.append("the scale 1 is a guess: the poses say none, and the clip's mesh has no known size")
    if masks is not None and (
        text := diagnose_pose_convention(clip, masks, clip.hand.T_cam_hand @ poses.T_hand_obj, scale, iou)
    ):
        notes.append(text)
    notes += poses.notes
    unknown = {"total": float("nan")}
    return replace(
        Reconstruction.external(clip.name, name, clip.frames, poses.T_hand_obj, scale),
        frame_kind=kind, iou=iou, energy=unknown, seconds=unknown, notes=tuple(notes),
    )  # fmt: skip


def diagnose_pose_convention(
    clip: Clip, masks: Masks, T_cam_obj: Float[ndarray, "T 4 4"], scale: float, iou: Float[ndarray, "T"]
) -> str:
    """Name the convention by which poses would meet the masks, or say that none does; empty if the poses meet them."""
    known = np.flatnonzero(np.isfinite(iou))
    if not len(known) or (mean := float(iou[known].mean())) >= MISALIGNED_IOU_THRESHOLD:
        return ""
    some = known[frame_indices(len(known), N_CONVENTION_FRAMES)]
    T, mesh, seen = T_cam_obj[some], clip.mesh, masks.take(some)
    to_middle = se3.rigid(np.eye(3), -scale * mesh.centre)
    to_mean = se3.rigid(np.eye(3), -scale * mesh.vertices.mean(axis=0))
    turned = se3.exp_so3(np.array([np.pi / 2.0, 0.0, 0.0]))
    conventions = {
        "inverse (camera to object)": se3.inverse(T),
        "of a camera that looks along -z (OpenGL)": np.diag([1.0, -1.0, -1.0, 1.0]) @ T,
        "with rotations that are transposed": se3.rigid(np.swapaxes(T[:, :3, :3], 1, 2), T[:, :3, 3]),
        "of the mesh moved to its middle": T @ to_middle,
        "of the mesh moved to the mean of its vertices": T @ to_mean,
        "of the mesh with y up instead of z": T @ se3.rigid(turned, np.zeros(3)),
        "of the mesh with z up instead of y": T @ se3.rigid(turned.T, np.zeros(3)),
    }
    each = {
        name: float(np.nanmean(iou_of_poses(mesh, scale, one, clip.K[some], seen).full))
        for name, one in conventions.items()
        if (se3.transform(one, scale * mesh.vertices)[..., 2] > 0.0).all()
    }
    best = max(each, key=lambda name: each[name], default="")
    beginning = (
        MISALIGNED_POSES_MESSAGE.partition(":")[0]
        if mean == 0.0
        else f"the poses meet the masks by {format_probability(mean)} only"
    )
    if best and each[best] >= max(CONVENTION_IOU_THRESHOLD, mean + 0.2):
        return f"{beginning}; they meet them by {format_probability(each[best])} if they are {best}"
    return f"{beginning}:{MISALIGNED_POSES_MESSAGE.partition(':')[2]}"
