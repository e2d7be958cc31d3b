"""Meshes of another system, one for each frame, against a clip: what can be measured without a CAD model.

No vertex of such a mesh is known to be a vertex of the true one, so there is no ADD. IOU is that of our own results.
Penetration and SCA are those of the hand that the clip gives, which is not moved; SCA on the sides that can be compared
(``metrics.meshes``). A frame without a mesh shows nothing and touches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.naming import check_frame_numbers, frame_of, renumber_frames
from getagrip.clip.plausible import MAX_CAMERA_RANGE_M, MIN_CAMERA_RANGE_M
from getagrip.errors import InputError
from getagrip.evaluation.comparison import Comparison
from getagrip.evaluation.results import Evaluation, evaluate_comparison
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MESH_SUFFIXES, checked_mesh, drop_degenerate_faces, parse_mesh
from getagrip.io import files
from getagrip.metrics.contact import ContactDistances, Side
from getagrip.metrics.mask import MaskIou, iou_of_meshes
from getagrip.metrics.meshes import mesh_distances

MeshFrame = Literal["camera", "hand"]
"""Frame of the vertices [m]: the clip's camera frame, or its hand frame."""
MAX_HAND_OBJECT_DISTANCE_M = 0.5
"""Largest distance of an object's middle from the origin of the hand frame [m]."""
MAX_EVALUATED_FACES = 20_000_000
"""Most faces of all meshes of a clip."""


def evaluate_meshes(meshes: Sequence[Mesh | None], clip: Clip, masks: Masks | None, method: str) -> Evaluation:
    """Compute IOU, SCA and penetration of a mesh for each of the clip's frames, in the hand frame.

    Besides, ``frames_without_mesh`` counts these, and ``closed`` is the share of meshes without holes: only of these is
    it certain what is inside.
    """
    return evaluate_comparison(_MeshComparison(clip, masks, tuple(meshes)), method, symmetry=None)


@dataclass(frozen=True, eq=False)
class _MeshComparison(Comparison):
    """A comparison by one mesh for each frame, in the hand frame [m]."""

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

    Files are named like the frames, or by the same numbers; those of other frames are passed over; ``first`` is the
    number of the first frame's, where they are counted from another start. Raises ``InputError`` where no file is named
    like a frame or none can be read, ``UsageError`` where they seem to be counted from another start.
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
            raise InputError(
                folder, "", f"meshes of more than {MAX_EVALUATED_FACES} faces in all", "fewer; decimate them"
            )
    if len(errors) == len(named):  # as in another unit or frame: the first says what is wrong with all
        raise errors[0]
    return meshes, errors


def _read_mesh_in_hand(path: Path, frame: MeshFrame, T_cam_hand: Float[ndarray, "4 4"]) -> Mesh:
    """Read a mesh in the hand frame; faces without area, which systems often make, are left out."""
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
