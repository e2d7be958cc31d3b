"""Files of HaMeR's and WiLoR's demos: meshes (``--save_mesh``) and joints (HaMeR, ``--save_keypoints``).

``<image>_<person>.obj`` has MANO's 778 vertices [m] before the demo's camera (focal length 5000 / 256 times the larger
side of the image, central principal point), in OpenGL's axes. Faces that close the wrist follow MANO's faces; the order
of their corners tells the side: reversed for left hands.

``<image>_<person>_3dkeypoints.npy`` has the joints (n, 21, 3) of all hands in the person's batch of eight, before the
same camera. Left hands are mirrored about MANO's origin, as the network sees them; the file does not state the side.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.match_frames import frame_of
from getagrip.errors import InputError, MissingOptionError, UsageError
from getagrip.geometry.mesh_files.obj import parse_obj
from getagrip.hands.model import SIDE_MIRROR, Side
from getagrip.io import arrays, files
from getagrip.provenance import estimated
from getagrip.readers.trackers import records
from getagrip.readers.trackers.estimates import Estimate, Request, WeakPerspective, hamer_focal
from getagrip.readers.trackers.read_hands import load_mano, mano_joints, network_model
from getagrip.readers.trackers.tracker import unmatched_names_error

DEMO_JOINTS_SUFFIX = "_3dkeypoints"
DEMO_BATCH_SIZE = 8
OPENGL_AXIS_SIGNS = np.array([1.0, -1.0, -1.0])
WRIST_FACE = (92, 38, 234)
"""A face that closes the wrist of a right hand."""
MANO_WRIST_M = np.array([0.0957, 0.0064, 0.0062])
"""MANO's wrist joint in the mean right hand [m]."""
MAX_DEMO_MESH_BYTES = 4 * 2**20
DEMO_DEPTH_SOURCE = estimated(
    "the demo's mesh or joints, its focal length (5000 / 256 times the larger side) divided out, the clip's put in"
)


@dataclass
class SavedHand:
    """The files of one hand in one frame."""

    mesh: Path | None = None
    joints: Path | None = None


def is_demo_file(path: Path) -> bool:
    """Return whether a file is a mesh or joints of a demo, by its suffix."""
    return path.suffix.lower() in {*records.RECORD_MESH_SUFFIXES, ".npy"}


def demo_estimates(paths: Sequence[Path], request: Request, only: Side | None) -> Iterator[Estimate]:
    """Yield the hands of the requested side; ``only`` is the side of all joints without a mesh.

    Raises ``InputError`` for malformed files, ``UsageError`` for hands of an unknown side.
    """
    found: dict[tuple[int, int], SavedHand] = {}
    request.check_numbers(paths[0].parent, [path.stem.removesuffix(DEMO_JOINTS_SUFFIX) for path in paths])
    for path in paths:
        stem = path.stem.removesuffix(DEMO_JOINTS_SUFFIX)
        numbered = re.search(r"_(\d{1,2})$", stem)
        frame = frame_of(stem, request.frames)
        if frame is not None:
            saved = found.setdefault((frame, int(numbered[1]) if numbered else 0), SavedHand())
            saved.mesh, saved.joints = (path, saved.joints) if path.suffix.lower() != ".npy" else (saved.mesh, path)
    if not found:
        raise unmatched_names_error(paths, paths[0].name, request)
    for (frame, person), saved in sorted(found.items(), key=lambda item: item[0]):
        hand = _estimate_saved_hand(saved, frame, person, request, only)
        if hand is not None:
            yield hand


def _estimate_saved_hand(
    saved: SavedHand, frame: int, person: int, request: Request, only: Side | None
) -> Estimate | None:
    """Estimate one hand before the clip's camera; None for the other side."""
    model = load_mano(request.mano, "right")
    root = MANO_WRIST_M if model is None else model.model.joints[0]
    vertices, side = (None, only) if saved.mesh is None else _read_demo_mesh(saved.mesh)
    if side is None:
        raise UsageError(
            f"{saved.joints}: these files do not state the hand's side: run the demo with --save_mesh, too, and name "
            "both; or state the side of all joints with --joints-of left or right"
        )
    if side != request.side:
        return None
    if vertices is not None and request.mano is not None:
        path, joints = saved.mesh, mano_joints(network_model(side, request.mano), vertices)
        origin = joints[0] - (root if side == "right" else root * SIDE_MIRROR)
    elif saved.joints is not None:
        path, joints = saved.joints, _read_demo_joints(saved.joints, person)
        origin, vertices = joints[0] - root, None
        joints = joints if side == "right" else (joints - origin) * SIDE_MIRROR + origin
    else:
        raise MissingOptionError(
            f"missing --mano: the folder of MANO_RIGHT.pkl: {saved.mesh} has no joints. "
            "Or run HaMeR's demo with --save_keypoints, too, and name both"
        )
    assert path is not None
    if not origin[2] > 0:
        raise InputError(path, "", f"a hand at the depth {origin[2]:.3g} m", "a hand before the demo's camera")
    weak = WeakPerspective.of_translation(origin, hamer_focal(request.size), np.array(request.size) / 2.0)
    shift = weak.before(request.camera(frame)) - origin
    moved = None if vertices is None else vertices + shift
    return Estimate(path, frame, DEMO_DEPTH_SOURCE, None, joints + shift, moved)


def _read_demo_mesh(path: Path) -> tuple[Float[ndarray, "778 3"], Side]:
    """Read the vertices before the demo's camera, and the hand's side. Raises ``InputError``."""
    vertices, faces = parse_obj(path, files.read_bytes(path, MAX_DEMO_MESH_BYTES))
    if vertices.shape != (778, 3):
        raise InputError(path, "", f"{len(vertices)} vertices", "MANO's 778, as the demo saves them")
    vertices = arrays.floats(path, {"v": vertices}, "v", (778, 3))
    if np.abs(vertices).max() > records.MAX_RECORD_VALUE:
        raise InputError(path, "v", f"the number {np.abs(vertices).max():.3g}", "plausible ones")
    sides: dict[Side, tuple[int, ...]] = {"right": WRIST_FACE, "left": WRIST_FACE[::-1]}
    for side, face in sides.items():
        if any((np.roll(faces, n, axis=1) == face).all(axis=1).any() for n in range(3)):
            return vertices * OPENGL_AXIS_SIGNS, side
    expected = f"the face {WRIST_FACE} of the closed wrist, or its mirror image, which tells the side"
    raise InputError(path, "f", f"{len(faces)} faces without it", expected)


def _read_demo_joints(path: Path, person: int) -> Float[ndarray, "21 3"]:
    """Read the joints of a person before the demo's camera, left hands mirrored. Raises ``InputError``."""
    rows = records.record_numbers(path, records.read_tracker_record(path), "joints", (-1, 21, 3))
    if person % DEMO_BATCH_SIZE >= len(rows):
        expected = f"at least {person % DEMO_BATCH_SIZE + 1}: it is named after hand {person}"
        raise InputError(path, "", f"{len(rows)} hands", expected)
    return rows[person % DEMO_BATCH_SIZE]
