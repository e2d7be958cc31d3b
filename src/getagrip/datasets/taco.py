"""TACO (Liu et al., CVPR 2024; CC BY 4.0): a left hand moves an object; the two sequences that GeneOH Diffusion holds.

GeneOH Diffusion (Liu et al., ICLR 2024; https://github.com/Meowuu7/GeneOH-Diffusion) has them in
``data/taco/source_data``, a pair of files each:

    <sequence>.pkl   hand_verts (T, 778, 3) [m], hand_faces (1538, 3), hand_pose (T, 48): MANO's rotation vectors, the
                     global one first, hand_trans (T, 3) [m]: the wrist joint; obj_pose (T, 4, 4): object to camera [m]
    <sequence>.obj   the object [m], about 1,000 vertices

The vertices are MANO's own, so no MANO file is needed: the global rotation and the wrist joint give the hand's pose.
The hand is a left one: with the fingers ahead and the thumb up, the palm, to which they bend, is on the right. The
contact regions follow from the motion of the surface (``hands.from_motion``), since skinning weights are not given.
All is in the frame of a camera (x right, y down) whose intrinsics are not given: a pinhole is assumed. The files do not
say who the person is, nor what the object is: every clip is of the subject "unknown" and the category "object".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import FINGERS, HandTrack
from getagrip.clip.provenance import assumed
from getagrip.datasets import assumed_camera
from getagrip.datasets.cutting import TrackedDataset
from getagrip.datasets.dataset import Note
from getagrip.datasets.pickled import numbers
from getagrip.datasets.tracks import Source, Track, check_length
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.subdivide import fine
from getagrip.grasps.options import GraspOptions
from getagrip.hands import generic, mano
from getagrip.hands.from_motion import flat_hand
from getagrip.io import pickles

WITHIN_5_MM = GraspOptions(contact_mm=5.0)
FPS = 30.0
VERTICES, FACES = 778, 1538
PAD = 0.012
"""Radius of a fingertip's pad about MANO's vertex at the tip [m]."""


@dataclass(frozen=True, kw_only=True)
class Taco(TrackedDataset):
    """TACO's sequences as GeneOH Diffusion's code holds them: every visible stable grasp, without MANO."""

    grasps: Annotated[GraspOptions, arg(name="")] = WITHIN_5_MM
    """What counts as a stable grasp."""

    def sources(self) -> list[Source]:
        """The pairs of files in the folder ``root``."""
        found = [file for file in sorted(self.root.glob("*.pkl")) if file.with_suffix(".obj").is_file()]
        if not found:
            raise InputError(self.root, "", "no <sequence>.pkl with a <sequence>.obj", "the folder source_data")
        return [Source(file.stem, partial(_read, file)) for file in found]


def _read(file: Path, note: Note) -> Iterator[Track]:
    """The object in the hand over a sequence."""
    given = pickles.read_file(file, "a sequence of TACO")
    poses = numbers(file, given, "obj_pose", (-1, 4, 4))
    T = len(poses)
    check_length(file, "obj_pose", T)
    if not se3.is_rigid(poses).all():
        raise InputError(file, "obj_pose", "matrices that are no rigid motions", "rotations and translations [m]")
    mesh, _ = fine([read_mesh(file.with_suffix(".obj"))])
    K, size = assumed_camera.pinhole()
    yield Track(
        file=file,
        subject="unknown",
        sequence=file.stem,
        category="object",
        side="left",
        fps=FPS,
        numbers=np.arange(T),
        digits=6,
        size=size,
        K=K,
        hand=_hand(file, given, T, note),
        T_cam_obj=poses,
        mesh=mesh,
        provenance={
            "source": f"TACO, {file.stem}, in GeneOH Diffusion's copy",
            "licence": "made from TACO, CC BY 4.0",
            "hands": "TACO's MANO vertices (true)",
            "camera": assumed(f"a guess: the poses are the camera's, its focal length {K[0, 0]:g} px is assumed"),
            "fps": assumed(f"a guess: {FPS:g}, not in the files"),
            "scale": f"TACO's mesh, true size; long edges halved: {len(mesh.vertices)} vertices",
        },
    )


def _hand(file: Path, given: dict[str, object], T: int, note: Note) -> HandTrack:
    """The left hand: MANO's root joint, which the translation is, lies where the generic hand has its wrist."""
    vertices = numbers(file, given, "hand_verts", (T, VERTICES, 3))
    faces = numbers(file, given, "hand_faces", (FACES, 3))
    if not (np.all(faces % 1 == 0) and faces.min() >= 0 and faces.max() < VERTICES):
        raise InputError(file, "hand_faces", "other numbers", f"vertex ids, 0 to {VERTICES - 1}")
    faces = faces.astype(np.int64)
    pose = numbers(file, given, "hand_pose", (T, 48))
    R = se3.exp_so3(pose[:, :3])
    root = generic.load("left").joints[0]
    T_cam_hand = se3.rigid(R, numbers(file, given, "hand_trans", (T, 3)) - R @ root)
    in_hand = se3.transform(se3.inverse(T_cam_hand), vertices)
    flat = flat_hand(in_hand, root, pose[:, 3:])
    regions = {} if flat is None else mano.regions(flat[0], faces, *flat[1:])
    if not all(map(len, regions.values())) or not regions:
        note(f"{file.stem}: fingers move too little to tell the palm: contact regions are the fingertips alone")
        regions = _pads(in_hand[0])
    return HandTrack(in_hand, faces, T_cam_hand, regions)


def _pads(vertices: Float[ndarray, "V 3"]) -> dict[str, Int[ndarray, "_"]]:
    """The vertices near each fingertip."""
    tips = vertices[list(mano.TIPS["left"])]
    near = np.linalg.norm(vertices[:, None] - tips, axis=-1) < PAD
    return {finger: np.flatnonzero(near[:, n]) for n, finger in enumerate(FINGERS)}
