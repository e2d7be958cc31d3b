"""ArtiGrasp's copy of ARCTIC's motion as tracks, which `getagrip import tracks` reads (docs/datasets.md).

    python scripts/convert/artigrasp.py ARTIGRASP TRACKS [--subjects s1 s4 ...] [--estimated]

ARTIGRASP is the folder of https://github.com/zdchan/artigrasp (Zhang et al., 3DV 2024), or its ``rsc``. Read are

    mano_double/ee/<subject>/<sequence>_l.npy, _r.npy  (T, 21, 3): joints in the world [m], HO-3D's order
    arctic/<object>/<subject>/<sequence>.object.npy    (T, 7): joint angle [rad], rotation vector, translation [mm]
    arctic/<object>/{bottom,top}_watertight_tiny.obj   the object's two parts, the joint at 0 [m]

The world has z up, the top turns about -z of the template's frame, and subjects are ``s1``, not ``s01``. Joints are
wrong in frames 0 to 2 and from 32 * floor(T / 32) on: those frames are left out. Cameras are missing.

``--estimated`` reads the sequences of which ``ee_recon`` and ``<subject>_recon`` hold the same as an estimator found it
in images, in the camera's axes. The first and last 10 frames hold a hand at rest. The object's translation is the same
in all frames, so an estimated hand is put as far from the true origin of the object as from the estimated one. The
camera's orientation is that which takes the true rotations of the object to the estimated ones, their median over the
sequence. The estimated object goes to ``TRACKS/estimated/<subject>-<sequence>.npz``, placed by the true origin as well,
so that its place in the camera is right by construction; ``--poses CLIPS POSES`` writes it for each clip of these, for
``bench --with``.
"""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import read_clip
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import subdivide_parts
from getagrip.geometry.mesh_files import read_mesh
from getagrip.io import arrays
from getagrip.io.files import read_bytes
from getagrip.readers.datasets.arctic import ARCTIC_FPS, METRES_PER_MM, Template, make_neutral_template
from getagrip.readers.datasets.track_files import camera_facing_object
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR

SUBJECT = re.compile(r"s\d+")
"""Folders of true motion."""
WRONG_AT_START, BATCH, NOT_ESTIMATED = 3, 32, 10
LETTERS = {"left": "l", "right": "r"}
PARTS = ("bottom", "top")


def main(arguments: list[str]) -> None:
    parser = ArgumentParser(description="ArtiGrasp's copy of ARCTIC's motion as tracks.")
    parser.add_argument("artigrasp", type=Path)
    parser.add_argument("tracks", type=Path)
    parser.add_argument("--subjects", nargs="+", help="only these (default: all)")
    parser.add_argument("--estimated", action="store_true", help="with hands as estimated from images")
    parser.add_argument("--poses", nargs=2, type=Path, metavar=("CLIPS", "POSES"), help="estimated objects of clips")
    given = parser.parse_args(arguments)
    if given.poses:
        write_poses(given.tracks, *given.poses)
        return
    rsc = folder_rsc(given.artigrasp)
    found = [f for f in sequences(rsc) if given.subjects is None or f.parent.name in given.subjects]
    if given.estimated:
        found = [f for f in found if _recon(f).is_file()]
    if not found:
        sys.exit(f"{rsc}: no arctic/<object>/<subject>/<sequence>.object.npy of these")
    given.tracks.mkdir(parents=True, exist_ok=True)
    for file in found:
        try:
            convert(rsc, file, given.tracks, given.estimated)
        except InputError as error:
            print(f"{error}: skipped", file=sys.stderr)


def folder_rsc(root: Path) -> Path:
    """Return the folder ``rsc``, from ArtiGrasp's checkout or ``rsc`` itself."""
    return root / "rsc" if (root / "rsc").is_dir() else root


def sequences(rsc: Path) -> list[Path]:
    """List the files of the objects of all sequences of true motion."""
    return sorted(f for f in rsc.glob("arctic/*/*/*.object.npy") if SUBJECT.fullmatch(f.parent.name))


def sequence_of(file: Path) -> str:
    return file.name.removesuffix(".object.npy")


def convert(rsc: Path, file: Path, out: Path, estimated: bool = False) -> None:
    """Convert a sequence, by the file of its object, to ``<subject>-<sequence>.npz`` and the object's two meshes."""
    subject, sequence, name = file.parent.name, sequence_of(file), file.parent.parent.name
    poses = _array(file, (-1, 7))
    T, ends = len(poses), NOT_ESTIMATED if estimated else 0
    rows = np.arange(max(WRONG_AT_START, ends), min(BATCH * (T // BATCH), T - ends))
    if rows.size < 2:
        raise InputError(file, "", f"{T} frames", "more: joints are right in fewer than 2 of these")
    template = _object(rsc / "arctic" / name, out)
    T_world_obj = (_rigid(poses) @ se3.inverse(template.T_neutral_template))[rows]
    content = {
        "order": "ho3d", "fps": ARCTIC_FPS, "category": name, "subject": subject, "sequence": sequence, "frames": rows,
        "source": f"ARCTIC, {subject}/{sequence}, in ArtiGrasp's copy",
        "licence": "made from ARCTIC, for non-commercial research only",
        "T_world_obj": T_world_obj, "mesh": f"{name}-bottom.obj", "mesh_top": f"{name}-top.obj",
        "joint": np.stack([template.joint.point, template.joint.direction]), "articulation": poses[rows, 0],
        **{f"joints_{side}": j[rows] for side, j in _joints(rsc / "mano_double/ee" / subject, sequence, T).items()},
    }  # fmt: skip
    if estimated:
        content |= _estimates(rsc, file, T, rows, T_world_obj, template)
        (out / "estimated").mkdir(exist_ok=True)
        poses = {"frames": rows, "T_cam_obj": content.pop("estimated_object")}
        np.savez_compressed(out / "estimated" / f"{subject}-{sequence}.npz", **poses)
        content["source"] += "; estimated hands are placed by the object's true place"
    np.savez_compressed(out / f"{subject}-{sequence}.npz", **content)


def _estimates(
    rsc: Path, file: Path, T: int, rows: ndarray, T_world_obj: ndarray, template: Template
) -> dict[str, object]:
    """Return estimated joints in the world, and their camera as far as it follows from them."""
    subject = file.parent.name
    T_estimate_obj = (_rigid(_array(_recon(file), (T, 7))) @ se3.inverse(template.T_neutral_template))[rows]
    R_cam_world = median_rotation(T_estimate_obj[:, :3, :3] @ np.swapaxes(T_world_obj[:, :3, :3], 1, 2))
    places = se3.transform(T_world_obj, template.mesh.centre[None])[:, 0]
    camera = camera_facing_object(
        R_cam_world, places, "a guess but for its orientation, which is that of the estimates; fixed"
    )
    origin = template.joint.point[None]  # in the template's frame, which the estimate poses
    displaced = se3.transform(camera.T_cam_world @ T_world_obj, origin) - se3.transform(T_estimate_obj, origin)
    estimated = _joints(rsc / "mano_double/ee_recon" / subject, sequence_of(file), T)
    return {
        "K": camera.K,
        "size": camera.size,
        "T_cam_world": camera.T_cam_world[0],
        "assumed_camera": str(camera.described),
        "estimated_object": se3.rigid(T_estimate_obj[:, :3, :3], T_estimate_obj[:, :3, 3] + displaced[:, 0]),
    } | {
        f"estimated_{side}": se3.transform(se3.inverse(camera.T_cam_world), joints[rows] + displaced)
        for side, joints in estimated.items()
    }


def write_poses(tracks: Path, clips: Path, out: Path) -> None:
    """Convert the estimated object of each clip of these tracks, at the clip's frames."""
    out.mkdir(parents=True, exist_ok=True)
    for file in sorted(clips.glob("*/clip.json")):
        clip = read_clip(file.parent)
        subject, sequence, *_ = clip.name.split(CLIP_NAME_SEPARATOR)
        stored = arrays.read(tracks / "estimated" / f"{subject}-{sequence}.npz", {"frames", "T_cam_obj"}.__contains__)
        rows = np.searchsorted(stored["frames"], [int(name) for name in clip.frames])
        np.savez(out / f"{clip.name}.npz", frames=np.array(clip.frames), T_cam_obj=stored["T_cam_obj"][rows])


def median_rotation(R: Float[ndarray, "T 3 3"]) -> Float[ndarray, "3 3"]:
    """Compute the rotation with the least sum of angles to others (Weiszfeld's iteration from the best of a sample)."""
    some = R[:: max(1, len(R) // 200)]
    median = some[np.argmin(se3.angle_between(some[:, None], some[None]).sum(axis=1))]
    for _ in range(20):
        off = se3.log_so3(R @ median.T)
        weights = 1.0 / np.maximum(np.linalg.norm(off, axis=1), np.radians(0.1))
        median = se3.exp_so3(weights @ off / weights.sum()) @ median
    return median


def _recon(file: Path) -> Path:
    """Return the file of the estimated object, next to the true object's."""
    return file.parents[1] / f"{file.parent.name}_recon" / file.name


def _joints(folder: Path, sequence: str, frames: int) -> dict[str, Float[ndarray, "T 21 3"]]:
    return {side: _array(folder / f"{sequence}_{letter}.npy", (frames, 21, 3)) for side, letter in LETTERS.items()}


def _rigid(poses: Float[ndarray, "T 7"]) -> Float[ndarray, "T 4 4"]:
    """Return poses of the template [m]."""
    return se3.rigid(se3.exp_so3(poses[:, 1:4]), METRES_PER_MM * poses[:, 4:])


def _array(file: Path, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    return arrays.floats(file, {"": arrays.parse_npy(file, "", read_bytes(file))}, "", shape)


@lru_cache
def _object(folder: Path, out: Path) -> Template:
    """Read an object of two parts, which are stored in its neutral frame."""
    parts = [read_mesh(folder / f"{part}_watertight_tiny.obj") for part in PARTS]
    mesh, part = subdivide_parts(parts)  # the frame is that of finely meshed objects, such as ARCTIC's own
    template = make_neutral_template(mesh, part == 1)
    for name, rough in zip(PARTS, parts, strict=True):
        with (out / f"{folder.name}-{name}.obj").open("w") as obj:
            np.savetxt(obj, se3.transform(template.T_neutral_template, rough.vertices), "v %.9g %.9g %.9g")
            np.savetxt(obj, rough.faces + 1, "f %d %d %d")
    return template


if __name__ == "__main__":
    main(sys.argv[1:])
