"""ARCTIC (Fan et al., CVPR 2023): two hands use objects with a joint; true poses by motion capture.

The raw sequences are read, as ARCTIC's own code (https://github.com/zc-alexfan/arctic) describes them:

    raw_seqs/<subject>/<sequence>.object.npy        (T, 7): angle of the joint [rad], rotation vector, translation [mm]
    raw_seqs/<subject>/<sequence>.mano.npy          left, right: rot (T, 3), pose (T, 45), trans (T, 3) [m], shape (10,)
    raw_seqs/<subject>/<sequence>.egocam.dist.npy   R_k_cam_np (T, 3, 3), T_k_cam_np (T, 3, 1) [m], intrinsics (3, 3)
    meta/misc.json                                  by subject: world2cam, intris_mat (8), image_size (9), ioi_offset
    meta/object_vtemplates/<object>/mesh.obj        [mm], and parts.json: 0 for each vertex of the top, 1 of the bottom

ARCTIC's prose numbers the parts the other way round; its code turns part 0. Where ``top.obj`` and ``bottom.obj`` lie
beside the template, they decide, and must agree with ``parts.json``. The top turns by the angle about -z of the
template's frame; then the whole object is turned and moved. View 0 is the head camera, its lens undistorted; views 1 to
8 are the fixed cameras. Images are not read.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack, Joint, World
from getagrip.clip.timeline import SIDES, opposite_side
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MAX_MESH_BYTES, checked_mesh, drop_degenerate_faces
from getagrip.geometry.mesh_files.obj import parse_obj
from getagrip.hands.model import Side
from getagrip.io import arrays, pickles
from getagrip.io.files import MAX_JSON_BYTES, Json, is_portable_name, read_bytes, read_json, shorten_value
from getagrip.io.options import OptionalFolder
from getagrip.readers.datasets import mano_tracks
from getagrip.readers.datasets.cutting import SeveralCameras
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.mano_tracks import check_mano_numbers
from getagrip.readers.datasets.tracks import (
    SequenceSource,
    Track,
    check_length,
    check_pinhole,
    intrinsics_from_opencv,
)
from getagrip.readers.datasets.views import TrackView, with_further_views
from getagrip.stable_grasps.definition import GraspOptions

ARCTIC_GRASP_OPTIONS = GraspOptions(tau=0.5, contact_mm=0.0, points="fragments", rule="first", shortest=20)
"""Stable grasps of the authors' list (``stable_grasps_v3_frag_valid_min20``), as their published code finds them.

The paper defines them by vertices and all pairs (Eq. 2), and states no minimum length."""
N_ARCTIC_VIEWS = 9
ARCTIC_FPS = 30.0
ARCTIC_IMAGE_SCALE = 0.3
"""Size of masks over the size of images: 840 x 600 for view 0, as in the paper."""
METRES_PER_MM = 1e-3
TOP_PART_NUMBER = 0
"""Number of the top in ``parts.json``: ARCTIC's code adds 1 and turns part 1."""
MIN_PART_MARGIN_M = 0.002
"""Minimum difference of a vertex's distances to both parts that assigns it to the nearer part [m]; below,
``parts.json`` decides."""
MAX_PART_MISMATCH_FRACTION = 0.05
"""Maximum fraction of assigned vertices that differ from ``parts.json``: the template is coarser than its parts."""


@dataclass(frozen=True)
class Template:
    """An object whose top turns about a joint, in the object's neutral frame (``neutral_frame``)."""

    mesh: Mesh
    """In the neutral frame, the joint at 0."""
    joint: Joint
    T_neutral_template: Float[ndarray, "4 4"]


@dataclass(frozen=True)
class ArcticCamera:
    """A camera of ARCTIC."""

    number: int
    K: Float[ndarray, "3 3"]
    T_cam_world: Float[ndarray, "T 4 4"]
    size: tuple[int, int]

    @property
    def description(self) -> str:
        """Description for the provenance."""
        if self.number == 0:
            return "the camera on the head; its images are distorted, these masks are not"
        return f"fixed camera {self.number}"


@dataclass(frozen=True, kw_only=True)
class Arctic(SeveralCameras):
    """ARCTIC's raw sequences: every visible stable grasp."""

    grasps: Annotated[GraspOptions, arg(name="")] = ARCTIC_GRASP_OPTIONS
    """Definition of a stable grasp."""

    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl."""
    view: Annotated[int, arg(metavar="N")] = 0
    """The clip's camera: 0 on the head, 1 to 8 fixed."""

    def sources(self) -> list[SequenceSource]:
        """List the sequences below ``root``: ARCTIC's folder of ``raw_seqs`` and ``meta``, or a folder above it."""
        if not 0 <= self.view < N_ARCTIC_VIEWS:
            raise UsageError(f"--view must be 0 (the head camera) to {N_ARCTIC_VIEWS - 1} (got {self.view})")
        mano = mano_tracks.mano_folder(self.mano, "ARCTIC")
        places = (self.root, self.root / "data", self.root / "arctic_data" / "data")
        base = next((place for place in places if (place / "raw_seqs").is_dir()), self.root)
        found = sorted(base.glob("raw_seqs/*/*.object.npy"))
        if not found:
            raise InputError(self.root, "", "no raw_seqs/<subject>/<sequence>.object.npy in it", "ARCTIC's folder")
        read = partial(_read_sequence, base, mano=mano, view=self.view, views=self.views)
        return [SequenceSource(f"{f.parent.name}/{_sequence_name(f)}", partial(read, f)) for f in found]


def _sequence_name(file: Path) -> str:
    return file.name.removesuffix(".object.npy")


def _read_sequence(
    base: Path, file: Path, note: Note, *, mano: Path, view: int, views: int | Literal["all"]
) -> Iterator[Track]:
    subject, sequence = file.parent.name, _sequence_name(file)
    name = sequence.partition("_")[0]
    if not (is_portable_name(name) and is_portable_name(subject)):
        raise InputError(file, "", f"the name {file.name!r}", "<object>_<use or grab>_<number>.object.npy")
    poses = arrays.floats(file, {"": arrays.parse_npy(file, "", read_bytes(file))}, "", (-1, 7))
    T = len(poses)
    check_length(file, "", T)
    subjects = base / "meta" / "misc.json"
    misc = read_json(subjects).get(subject)
    if not isinstance(misc, dict):
        raise InputError(subjects, subject, shorten_value(misc), "the cameras of this subject")
    read_camera = partial(
        _read_camera, subjects, misc, subject, egocam=file.with_name(f"{sequence}.egocam.dist.npy"), T=T
    )
    camera = read_camera(view)
    offset = misc.get("ioi_offset")
    if type(offset) is not int or not 0 <= offset < 10**6:
        raise InputError(subjects, f"{subject}.ioi_offset", shorten_value(offset), "a number of frames")
    template = read_template(base / "meta" / "object_vtemplates" / name)
    T_world_template = se3.rigid(se3.exp_so3(poses[:, 1:4]), METRES_PER_MM * poses[:, 4:])
    T_cam_obj = camera.T_cam_world @ T_world_template @ se3.inverse(template.T_neutral_template)
    hands = _read_hands(file.with_name(f"{sequence}.mano.npy"), mano, camera.T_cam_world, T)
    for side in SIDES:
        track = Track(
            file=file,
            subject=subject,
            sequence=sequence,
            category=name,
            side=side,
            fps=ARCTIC_FPS,
            numbers=np.arange(T) + offset,
            digits=5,
            size=camera.size,
            K=camera.K,
            hand=hands[side],
            T_cam_obj=T_cam_obj,
            mesh=template.mesh,
            joint=template.joint,
            articulation=poses[:, 0],
            origin=offset,
            other_hand=hands[opposite_side(side)],
            world=World(se3.inverse(camera.T_cam_world)),
            provenance={
                "source": f"ARCTIC, {subject}/{sequence}, view {view}",
                "licence": "made from ARCTIC, for non-commercial research only",
                "hands": "ARCTIC's MANO parameters (true), by the user's MANO files",
                "camera": camera.description,
                "image": f"masks are {ARCTIC_IMAGE_SCALE:g} times as large as the images",
                "scale": "ARCTIC's template, true size",
                "frame": "z along the principal axis about which the closed object is most nearly round, origin in the "
                "middle; ARCTIC's own frame has z along the joint",
            },
        )
        yield with_further_views(track, views, partial(_further_views, camera, read_camera), note)


def _further_views(own: ArcticCamera, read: Callable[[int], ArcticCamera]) -> list[TrackView]:
    others = [read(number) for number in range(N_ARCTIC_VIEWS) if number != own.number]
    return [
        TrackView(
            name=f"view{other.number}",
            K=other.K,
            size=other.size,
            T_cam_view=own.T_cam_world @ se3.inverse(other.T_cam_world),
            camera=other.description,
        )
        for other in others
    ]


def _read_hands(file: Path, mano: Path, T_cam_world: Float[ndarray, "T 4 4"], T: int) -> dict[Side, HandTrack]:
    """Read both hands. ARCTIC's annotations were fitted with the published left hand, faults included."""
    value = pickles.read_pickle_file(file, "ARCTIC's MANO parameters")
    hands: dict[Side, HandTrack] = {}
    for side in SIDES:
        values = value.get(side)
        if not isinstance(values, dict):
            raise InputError(file, side, shorten_value(values), "the parameters of this hand")
        widths = {"rot": 3, "pose": 45, "trans": 3}
        rot, pose, trans = (check_mano_numbers(file, values, key, (T, n), side) for key, n in widths.items())
        of_frames = np.size(values.get("shape", ())) != 10
        shape = check_mano_numbers(file, values, "shape", (T, 10) if of_frames else (10,), side)
        model = mano_tracks.load_mano_hand(mano, side, repaired=False)
        hands[side] = mano_tracks.mano_hand_track(model, rot, pose, trans, shape.reshape(-1, 10)[0], False, T_cam_world)
    return hands


def _read_camera(file: Path, misc: Json, subject: str, number: int, egocam: Path, T: int) -> ArcticCamera:
    of = {key: np.array(misc[key]) for key in ("image_size", "world2cam", "intris_mat") if _is_table(misc.get(key))}
    sizes = check_mano_numbers(file, of, "image_size", (N_ARCTIC_VIEWS, 2), subject)
    width, height = (round(ARCTIC_IMAGE_SCALE * float(side)) for side in sizes[number])
    if not (0 < width < 10_000 and 0 < height < 10_000):
        got = shorten_value(sizes[number].tolist())
        raise InputError(file, f"{subject}.image_size", got, "width and height in pixels")
    if number == 0:
        file, subject = egocam, ""
        value = pickles.read_pickle_file(egocam, "ARCTIC's camera on the head")
        K = check_mano_numbers(egocam, value, "intrinsics", (3, 3))
        T_cam_world = se3.rigid(
            check_mano_numbers(egocam, value, "R_k_cam_np", (T, 3, 3)),
            check_mano_numbers(egocam, value, "T_k_cam_np", (T, 3, 1))[..., 0],
        )
    else:
        K = check_mano_numbers(file, of, "intris_mat", (N_ARCTIC_VIEWS - 1, 3, 3), subject)[number - 1]
        poses = check_mano_numbers(file, of, "world2cam", (N_ARCTIC_VIEWS - 1, 4, 4), subject)
        T_cam_world = np.tile(poses[number - 1], (T, 1, 1))
    if not se3.is_rigid(T_cam_world).all():
        raise InputError(file, subject, f"a view {number} that is not rigid", "rotations and translations [m]")
    K = intrinsics_from_opencv(check_pinhole(file, subject, K, skew=1e-6), ARCTIC_IMAGE_SCALE)
    return ArcticCamera(number, K, T_cam_world, (width, height))


def _is_table(value: object) -> bool:
    table = arrays.from_lists(value)
    return table is not None and table.dtype.kind in "if"


def read_template(folder: Path) -> Template:
    """Read an object's template. Raises ``InputError``."""
    mesh = _read_mesh_in_mm(folder / "mesh.obj")
    return make_neutral_template(mesh, read_top_vertices(folder, mesh))


def _read_mesh_in_mm(file: Path) -> Mesh:
    """Read a mesh [mm] in metres, with all of its vertices, as the parts' numbers count them."""
    vertices, faces = parse_obj(file, read_bytes(file, MAX_MESH_BYTES))
    vertices, faces = METRES_PER_MM * vertices, drop_degenerate_faces(METRES_PER_MM * vertices, faces)
    checked_mesh(file, vertices, faces)
    return Mesh(vertices, faces)


def make_neutral_template(mesh: Mesh, top: Bool[ndarray, "V"]) -> Template:
    """Make the template of an object in ARCTIC's frame [m]; the ``top`` vertices turn about -z of the frame."""
    T = neutral_frame(mesh)
    joint = Joint(moves=top, point=T[:3, 3], direction=-T[:3, 2])
    return Template(Mesh(se3.transform(T, mesh.vertices), mesh.faces), joint, T)


def neutral_frame(mesh: Mesh) -> Float[ndarray, "4 4"]:
    """Return ``T_neutral_mesh``: z along the axis about which a mesh is most nearly round, the origin in its middle.

    The principal axes of the surface's second moments, by area: z is the axis whose moment is farther from the middle
    moment, x the axis of the larger of the other two. z and x point towards the side on which the surface reaches
    farther from its centroid (third moments).
    """
    area = mesh.vertex_areas / mesh.vertex_areas.sum()
    x = mesh.vertices - area @ mesh.vertices
    moments, axes = np.linalg.eigh((area[:, None] * x).T @ x)  # the smallest first
    z, first = (2, 1) if moments[2] - moments[1] > moments[1] - moments[0] else (0, 2)
    R = np.empty((3, 3))
    for row, k in ((2, z), (0, first)):
        along = x @ axes[:, k]
        R[row] = axes[:, k] * (1.0 if area @ along**3 >= 0.0 else -1.0)
    R[1] = np.cross(R[2], R[0])
    turned = mesh.vertices @ R.T
    return se3.rigid(R, -(turned.min(axis=0) + turned.max(axis=0)) / 2.0)


def read_top_vertices(folder: Path, mesh: Mesh) -> Bool[ndarray, "V"]:
    """Read which vertices of the template in ``folder`` belong to the turning top. Raises ``InputError``."""
    numbered = _read_part_numbers(folder / "parts.json", len(mesh.vertices)) == TOP_PART_NUMBER
    top, bottom = folder / "top.obj", folder / "bottom.obj"
    if not (top.is_file() and bottom.is_file()):
        return numbered
    nearer = _distance_to_mesh(bottom, mesh.vertices) - _distance_to_mesh(top, mesh.vertices)
    clear = np.abs(nearer) > MIN_PART_MARGIN_M
    differ = clear & ((nearer > 0.0) != numbered)
    if differ.sum() > MAX_PART_MISMATCH_FRACTION * clear.sum():
        got = f"{differ.sum()} of {clear.sum()} vertices numbered against top.obj and bottom.obj, which lie beside it"
        expected = f"{TOP_PART_NUMBER} for each vertex of mesh.obj at top.obj, else 1"
        raise InputError(folder / "parts.json", "", got, expected)
    return np.where(clear, nearer > 0.0, numbered)


def _read_part_numbers(file: Path, count: int) -> ndarray:

    try:
        part = arrays.from_lists(json.loads(read_bytes(file, MAX_JSON_BYTES)))
    except (ValueError, RecursionError) as error:
        raise InputError(file, "", f"invalid JSON ({error})", "a JSON list") from error
    if part is None or part.shape != (count,) or not np.isin(part, (0, 1)).all():
        got = f"{len(part)} numbers" if part is not None and part.ndim == 1 else "something else"
        raise InputError(file, "", got, f"0 or 1 for each of the {count} vertices of mesh.obj")
    return part


def _distance_to_mesh(file: Path, points: Float[ndarray, "V 3"]) -> Float[ndarray, "V"]:
    import igl

    mesh, tree = _read_mesh_in_mm(file), igl.AABB()
    tree.init(mesh.vertices, mesh.faces)
    return np.sqrt(tree.squared_distance(mesh.vertices, mesh.faces, points)[0])
