"""Meshes that another system made, one for each frame, against a clip: what can be told of them without a CAD.

No vertex of such a mesh is known to be a vertex of the true one, so there is no ADD. IOU is that of our own results.
Penetration and SCA are those of the hand that the clip gives, which is not moved; SCA on the sides that can be compared
(``metrics.meshes``). A frame without a mesh shows nothing and touches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.naming import frame_of
from getagrip.clip.plausible import FARTHEST, NEAREST
from getagrip.errors import InputError
from getagrip.evaluation.results import add, add_iou, contact_metrics, judged, penetration, sca_metrics, true_track
from getagrip.geometry import se3
from getagrip.geometry.mesh import SUFFIXES, Mesh, checked_mesh, parse_mesh, with_area
from getagrip.metrics.contact import ContactDistances, contact_distances_of
from getagrip.metrics.mask import iou_of_meshes
from getagrip.metrics.meshes import mesh_distances

MeshFrame = Literal["camera", "hand"]
"""What the vertices are in [m]: the clip's camera frame, or its hand frame."""
FROM_HAND = 0.5
"""Largest distance of an object's middle from the origin of the hand frame [m]."""
MOST_FACES = 20_000_000
"""Of all meshes of a clip."""


def evaluate_meshes(meshes: Sequence[Mesh | None], clip: Clip, masks: Masks | None, method: str) -> dict[str, Any]:
    """IOU, SCA and penetration of a mesh for each of the clip's frames, in the hand frame; in the form of ``evaluate``.

    Besides, ``frames_without_mesh`` counts these, and ``closed`` is the share of meshes without holes: only of these is
    it certain what is inside.
    """
    there = np.array([mesh is not None for mesh in meshes])
    distances, sides = mesh_distances(meshes, clip.hand.vertices, clip.hand.faces)
    metrics, per_frame = sca_metrics(distances, sides)
    if there.any():
        parts = ContactDistances(distances.object[there], distances.hand[there], distances.area[there])
        depths, frames = penetration(parts)
        add(metrics, per_frame, "", (depths, {key: _spread(values, there) for key, values in frames.items()}))
    metrics["frames_without_mesh"] = float(np.count_nonzero(~there))
    if there.any():
        metrics["closed"] = float(np.mean([mesh.is_closed for mesh in meshes if mesh is not None]))
    true = true_track(clip)
    if clip.truth is not None and true is not None:
        (of_truth,) = contact_distances_of(clip.mesh, [true], clip.truth.hand_vertices, clip.hand.faces)
        add(metrics, per_frame, "truth_", contact_metrics(of_truth))
    if masks is not None:
        seen = [None if mesh is None else _moved(mesh, T) for mesh, T in zip(meshes, clip.hand.T_cam_hand, strict=True)]
        add_iou(metrics, per_frame, iou_of_meshes(seen, clip.K, judged(clip, masks)))
    return {
        "clip": clip.name,
        "category": clip.category,
        "method": method,
        "frames": list(clip.frames),
        "symmetry": None,
        "metrics": metrics,
        "per_frame": {key: values.tolist() for key, values in per_frame.items()},
    }


def _spread(values: Float[ndarray, "n"], there: Bool[ndarray, "T"]) -> Float[ndarray, "T"]:
    """Values of some frames among all of them; not a number in the others."""
    out = np.full(len(there), np.nan)
    out[there] = values
    return out


def read_meshes(folder: Path, clip: Clip, frame: MeshFrame) -> tuple[list[Mesh | None], list[InputError]]:
    """The mesh of each of the clip's frames, in the hand frame, or nothing; and what was wrong with files.

    Files are named like the frames, or by the same numbers; those of other frames are passed over. Raises
    ``InputError`` where no file is named like a frame.
    """
    named: dict[int, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        n = frame_of(path.stem, clip.frames) if path.suffix.lower() in SUFFIXES else None
        if n is not None:
            named.setdefault(n, []).append(path)
    if not named:
        expected = f"{clip.frames[0]}.obj (or {', '.join(SUFFIXES[1:])}) and so on, as the frames of {clip.name}"
        raise InputError(folder, "", "no mesh named like a frame", expected)
    meshes: list[Mesh | None] = [None] * len(clip)
    errors = []
    faces = 0
    for n, paths in named.items():
        try:
            if len(paths) > 1:
                raise InputError(paths[1], "", f"another mesh of the frame of {paths[0].name}", "one for each frame")
            meshes[n] = mesh = _read(paths[0], frame, clip.hand.T_cam_hand[n])
        except InputError as error:
            errors.append(error)
            continue
        faces += len(mesh.faces)
        if faces > MOST_FACES:
            raise InputError(folder, "", f"meshes of more than {MOST_FACES} faces in all", "fewer; decimate them")
    return meshes, errors


def _read(path: Path, frame: MeshFrame, T_cam_hand: Float[ndarray, "4 4"]) -> Mesh:
    """A mesh in the hand frame; faces without area, which systems often make, are left out."""
    vertices, faces = parse_mesh(path)
    mesh = checked_mesh(path, vertices, with_area(vertices, faces))
    if frame == "camera":
        if not NEAREST < mesh.centre[2] < FARTHEST:
            given = f"a mesh whose middle is {mesh.centre[2]:.3g} m before the camera"
            raise InputError(path, "vertices", given, f"{NEAREST:g} to {FARTHEST:g} m; is it in the hand frame?")
        mesh = _moved(mesh, se3.inverse(T_cam_hand))
    away = float(np.linalg.norm(mesh.centre))
    if frame == "hand" and away > FROM_HAND:
        given = f"a mesh whose middle is {away:.3g} m from the hand's"
        raise InputError(path, "vertices", given, f"at most {FROM_HAND:g} m; is it in the camera frame?")
    return mesh


def _moved(mesh: Mesh, T: Float[ndarray, "4 4"]) -> Mesh:
    return Mesh(se3.transform(T, mesh.vertices), mesh.faces)
