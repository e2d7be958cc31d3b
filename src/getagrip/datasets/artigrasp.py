"""ArtiGrasp's copy of ARCTIC: true joints of both hands and true poses of objects, without MANO and cameras.

ArtiGrasp (Zhang et al., 3DV 2024; https://github.com/zdchan/artigrasp) keeps most of ARCTIC's motion in its folder
``rsc``. Read are

    mano_double/ee/<subject>/<sequence>_l.npy, _r.npy  (T, 21, 3): joints in the world [m], HO-3D's order
    arctic/<object>/<subject>/<sequence>.object.npy    (T, 7): joint angle [rad], rotation vector, translation [mm]
    arctic/<object>/{bottom,top}_watertight_tiny.obj   the object's two parts, the joint at 0 [m]

What to know of it:

- Subjects are ``s1``, not ``s01``; there is no ``s03``, and scissors have joints but no poses.
- ``s5_recon`` holds what was estimated from images: ``artigrasp_estimated`` reads it.
- Joints are wrong in frames 0 to 2 and from 32 * floor(T / 32) on: those frames are left out.
- The top turns about -z of the template's frame; the object's origin is not in its middle.
- The world is in metres with z up, object translations are in mm.
- The meshes have 500 vertices. Contact is counted by vertices, so long edges are halved until there are about 4,500.
- Cameras are missing (``egocam``, ``misc.json``): one is assumed (``assumed_camera``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.datasets.arctic import FPS, MM, Template, in_neutral_frame
from getagrip.datasets.cutting import TrackedDataset
from getagrip.datasets.dataset import Note
from getagrip.datasets.joint_tracks import Motion, tracks
from getagrip.datasets.tracks import Source, Track, check_length
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.subdivide import fine
from getagrip.grasps.definition import FEWEST
from getagrip.grasps.options import GraspOptions
from getagrip.hands.fit import ORDERS
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.io.files import is_plain_name, read_bytes

WITHIN_10_MM = GraspOptions(contact_mm=10.0, shortest=FEWEST)
"""As of ``arctic``, but for the contact: within 10 mm the fitted hands touch objects in the frames in which the true
ones do (docs/arctic.md), at 0 mm not."""
SUBJECT = re.compile(r"s\d+")
"""Folders of true motion."""
WRONG_AT_START, BATCH = 3, 32
"""Joints are wrong in the first frames, and after the last full batch."""
LETTERS: dict[Side, str] = {"left": "l", "right": "r"}
PARTS = ("bottom", "top")


@dataclass(frozen=True, kw_only=True)
class ArtiGrasp(TrackedDataset):
    """ARCTIC's motion as ArtiGrasp's code holds it, hands as joints: every visible stable grasp, without MANO."""

    grasps: Annotated[GraspOptions, arg(name="")] = WITHIN_10_MM
    """What counts as a stable grasp."""

    def sources(self) -> list[Source]:
        """The sequences below ``root``, ArtiGrasp's folder or its ``rsc``."""
        rsc = folder_rsc(self.root)
        found = sorted(f for f in rsc.glob("arctic/*/*/*.object.npy") if SUBJECT.fullmatch(f.parent.name))
        if not found:
            given = "no arctic/<object>/<subject>/<sequence>.object.npy in it"
            raise InputError(self.root, "", given, "ArtiGrasp's folder, or its rsc")
        return [Source(f"{f.parent.name}/{sequence_of(f)}", partial(_read, rsc, f)) for f in found]


def folder_rsc(root: Path) -> Path:
    """ArtiGrasp's ``rsc``, of its folder or of itself."""
    return root / "rsc" if (root / "rsc").is_dir() else root


def sequence_of(file: Path) -> str:
    """The name of the sequence of an object's file."""
    return file.name.removesuffix(".object.npy")


def _read(rsc: Path, file: Path, note: Note) -> Iterator[Track]:
    """The object in each hand over a sequence."""
    motion = true_motion(rsc, file, note)
    if motion is not None:
        yield from tracks(motion)


def true_motion(rsc: Path, file: Path, note: Note, ends: int = 0) -> Motion | None:
    """A sequence, by the file of its object; the given number of frames at either end is left out, too.

    None where fewer than 2 frames are left. Raises ``InputError``.
    """
    subject, sequence, name = file.parent.name, sequence_of(file), file.parent.parent.name
    if not all(map(is_plain_name, (subject, sequence, name))):
        raise InputError(file, "", f"the name {file.name!r}", "<object>_<use or grab>_<number>.object.npy")
    poses = numbers(file, (-1, 7))
    T = len(poses)
    check_length(file, "", T)
    rows = np.arange(max(WRONG_AT_START, ends), min(BATCH * (T // BATCH), T - ends))
    if rows.size < 2:
        note(f"{subject}/{sequence}: joints are right in fewer than 2 of {T} frames: skipped")
        return None
    template = read_template(rsc / "arctic" / name)
    return Motion(
        file=file,
        subject=subject,
        sequence=sequence,
        category=name,
        fps=FPS,
        numbers=rows,
        joints={side: j[rows] for side, j in read_joints(rsc / "mano_double" / "ee" / subject, sequence, T).items()},
        T_world_obj=(rigid(poses) @ se3.inverse(template.T_neutral_template))[rows],
        mesh=template.mesh,
        joint=template.joint,
        articulation=poses[rows, 0],
        provenance={
            "source": f"ARCTIC, {subject}/{sequence}, in ArtiGrasp's copy",
            "licence": "made from ARCTIC, for non-commercial research only",
            "scale": f"ArtiGrasp's mesh, true size, its long edges halved: {len(template.mesh.vertices)} vertices",
            "frame": "as of clips made by the ARCTIC reader",
        },
    )


def read_joints(folder: Path, sequence: str, frames: int) -> dict[Side, Float[ndarray, "T 21 3"]]:
    """Joints of both hands in all frames of a sequence [m], in this package's order. Raises ``InputError``."""
    found = {side: numbers(folder / f"{sequence}_{letter}.npy", (frames, 21, 3)) for side, letter in LETTERS.items()}
    return {side: joints[:, ORDERS["ho3d"]] for side, joints in found.items()}


def rigid(poses: Float[ndarray, "T 7"]) -> Float[ndarray, "T 4 4"]:
    """Poses of the template [m], from an object's file."""
    return se3.rigid(se3.exp_so3(poses[:, 1:4]), MM * poses[:, 4:])


def numbers(file: Path, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    """The array in a ``.npy``. Raises ``InputError``."""
    return arrays.floats(file, {"": arrays.parse_npy(file, "", read_bytes(file))}, "", shape)


@lru_cache
def read_template(folder: Path) -> Template:
    """An object of its two parts. Raises ``InputError``."""
    bottom, top = (read_mesh(folder / f"{part}_watertight_tiny.obj") for part in PARTS)
    mesh, part = fine([bottom, top])
    return in_neutral_frame(mesh, part == 1)
