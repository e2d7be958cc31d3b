"""Initial poses: prior poses that a user names, then a uniform grid of rotations over SO(3).

Uniform rotations are placed by the hand and the masks; the ground truth is never used. Prior poses are a category's
(learnt, or of a folder), or another system's poses of the clip itself. A file of ``init learn`` of version 2 holds
grasps, which are clustered at use without those of the clip's own subject. A file of version 1 holds poses, and is
refused for the clips and subjects that they were learnt from.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import FINGERS, Clip, HandTrack, Masks
from getagrip.clip.object_poses import POSE_FILE_SUFFIXES, find_poses_path, read_poses
from getagrip.errors import InputError
from getagrip.fitting.motion import Fixed
from getagrip.fitting.options import Init, Options, PriorsFile
from getagrip.fitting.solver.cluster_poses import (
    CLUSTERINGS,
    MAX_CLUSTERS,
    PRIORS_VERSION,
    LearntGrasps,
    PosePriors,
    TrueGraspPose,
    Way,
    subject_from_provenance,
)
from getagrip.geometry import camera, se3
from getagrip.geometry.mesh import Mesh
from getagrip.io import arrays, files
from getagrip.io.terminal import format_count

PRIOR_NAME_KEYS = ("category", "side", "clips", "subjects")
"""Arrays of names in a file: one name per pose, clip and subject in version 1, per grasp in version 2."""
PRIOR_NUMBER_KEYS = ("version", "k", "seed", "R", "centre", "mesh_centre", "T_hand_obj")
HAND_SIDES = ("left", "right")
REPRESENTATIVE_DISTANCE_DIAMETERS = 0.15
"""Distance of the posed surfaces below which one pose of a track represents another."""
MAX_PRIOR_DISTANCE_M = 2.0
"""Maximum plausible distance of an object's origin from the hand frame's [m]."""


def initial_poses(
    clip: Clip,
    masks: Masks,
    inits: int,
    seed: int = 0,
    poses: Float[ndarray, "k 4 4"] | None = None,
    usual: Float[ndarray, "u 3 3"] | None = None,
) -> Fixed:
    """Make B = ``inits`` poses: the first of ``poses`` (``T_hand_obj``), then rotations spread uniformly over SO(3).

    ``usual`` rotations replace at most half of the uniform ones. Rotations place the object's centre at ``grip_point``.
    A free scale starts so that the object at this place is as large as its masks.
    """
    poses = np.zeros((0, 4, 4)) if poses is None else poses[:inits]
    offset = se3.exp_so3(np.random.default_rng(seed).uniform(-1.0, 1.0, 3)) if seed else np.eye(3)
    usual = np.zeros((0, 3, 3)) if usual is None else usual[: (inits - len(poses)) // 2]
    R = np.concatenate([usual, offset @ se3.super_fibonacci(inits - len(poses) - len(usual))])
    boxes = camera.bounding_boxes(masks.object).astype(float)
    point = grip_point(clip.hand, clip.K, (boxes[:, :2] + boxes[:, 2:]) / 2.0)
    scale = 1.0
    if clip.scale == "free":
        depth = se3.transform(clip.hand.T_cam_hand, point[None, None])[:, 0, 2]
        extent = np.linalg.norm(boxes[:, 2:] - boxes[:, :2], axis=1) * depth / clip.K[:, 0, 0]
        scale = float(np.clip(np.median(extent) / clip.mesh.diameter, 0.2, 5.0))
    centre = np.concatenate([se3.transform(poses, scale * clip.mesh.centre[None])[:, 0], np.tile(point, (len(R), 1))])
    R = np.concatenate([poses[:, :3, :3], R])
    return Fixed(R, centre, np.full(inits, np.log(scale)), len(clip), clip.scale == "free")


def grip_point(hand: HandTrack, K: Float[ndarray, "T 3 3"], uv: Float[ndarray, "T 2"]) -> Float[ndarray, "3"]:
    """Find the point of the hand frame nearest to the rays through the masks' centres and to the hand's grip [m].

    The grip is the mean of the five fingertips' contact regions, with a standard deviation of 5 cm. A ray's is 2 cm;
    together the rays count as four, since occlusion by the hand biases all of them alike.
    """
    grip = np.mean([hand.vertices[:, hand.regions[name]].mean(axis=(0, 1)) for name in FINGERS], axis=0)
    R_hand_cam = np.swapaxes(hand.T_cam_hand[:, :3, :3], 1, 2)
    eye = -(R_hand_cam @ hand.T_cam_hand[:, :3, 3, None])[..., 0]
    ray = (R_hand_cam @ camera.backproject(K, uv[:, None])[:, 0, :, None])[..., 0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    orthogonal = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    ray_weight, grip_weight = 4.0 / (len(ray) * 0.02**2), 1.0 / 0.05**2
    A = ray_weight * orthogonal.sum(axis=0) + grip_weight * np.eye(3)
    return np.linalg.solve(A, ray_weight * (orthogonal @ eye[..., None])[..., 0].sum(axis=0) + grip_weight * grip)


def priors_checksum(path: Path, init: Init) -> str:
    """Compute the checksum of a user's file or folder of prior poses. Raises ``InputError``."""
    return files.sha256(_list_prior_files(path, init))


def read_initial_poses(clip: Clip, options: Options) -> tuple[Float[ndarray, "k 4 4"], tuple[str, ...]]:
    """Read the prior poses of the search, and notes on them.

    Raises ``InputError`` for files that are missing, malformed or changed since the options were made, for poses of
    version 1 learnt from this clip or from its subject, and for prior poses that are missing but shall be used alone.
    """
    if options.priors is None:
        return np.zeros((0, 4, 4)), ()
    if options.init == "poses":
        return _read_external_poses(options.priors, clip, options)
    path, learnt = options.priors.path, _read_priors(options.priors, options.init)
    without = ""
    if isinstance(learnt, LearntGrasps):
        subject = subject_from_provenance(clip)
        priors = _without_own(options.priors, clip.category, clip.side, clip.name, subject)
        left_out = len(learnt.holds) - len(learnt.without(clip.name, subject).holds)
        without = f" without {format_count(left_out, 'grasp')} of its own subject" if left_out else ""
    else:
        priors = learnt
        _refuse_own(path, priors, clip)
    poses = priors.of(clip.category, clip.side)[: options.inits]
    more = "no others" if options.priors_only else f"{options.inits - len(poses)} uniform rotations"
    if not len(poses):
        none = f"no poses of {files.printable(clip.category)} in a {clip.side} hand"
        if options.priors_only:
            raise InputError(path, "", f"{none}{without}", "some, or uniform rotations as well (no --priors-only)")
        return poses, (f"{path.name}{without} has {none}: {more}",)
    whence = "" if priors.clips else ", which does not say what they were learnt from"
    return poses, (f"started from {len(poses)} poses of {path.name}{without}{whence}, and {more}",)


def _read_external_poses(
    file: PriorsFile, clip: Clip, options: Options
) -> tuple[Float[ndarray, "k 4 4"], tuple[str, ...]]:
    """Read another system's poses of the clip, similar ones represented by one. Raises ``InputError``."""
    _check_unchanged(file, "poses")
    poses = read_poses(find_poses_path(file.path, clip.name), clip, file.first)
    T = _representatives(poses.T_hand_obj[poses.found], clip.mesh, options.inits)
    more = "no others" if options.priors_only else f"{options.inits - len(T)} uniform rotations"
    count = format_count(int(poses.found.sum()), "pose")
    return T, (f"started from {len(T)} of {count} of {file.path.name}, which represent the others, and {more}",)


def _representatives(T: Float[ndarray, "n 4 4"], mesh: Mesh, most: int) -> Float[ndarray, "k 4 4"]:
    """Choose poses, the most central first, then the farthest, up to ``REPRESENTATIVE_DISTANCE_DIAMETERS``."""
    points = se3.transform(T, mesh.vertices[:: max(1, len(mesh.vertices) // 50)]) / mesh.diameter

    def distance(n: int) -> Float[ndarray, "n"]:
        return np.asarray(np.sqrt(np.mean(np.sum((points - points[n]) ** 2, axis=-1), axis=-1)))

    middle = np.median(points, axis=0)
    chosen = [int(np.argmin(np.sum((points - middle) ** 2, axis=(1, 2))))]
    nearest = distance(chosen[0])
    while len(chosen) < most and nearest.max() > REPRESENTATIVE_DISTANCE_DIAMETERS:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, distance(chosen[-1]))
    return T[chosen]


@lru_cache(maxsize=4)
def _check_unchanged(file: PriorsFile, init: Init) -> None:
    """Raise ``InputError`` where the content has changed since the options were made."""
    if priors_checksum(file.path, init) != file.sha256:
        raise InputError(file.path, "", "content that has changed since it was named", "a file that stays unchanged")


@lru_cache(maxsize=256)
def _without_own(file: PriorsFile, category: str, side: str, clip: str, subject: str) -> PosePriors:
    """Learn the poses of other subjects' grasps of a category in a hand."""
    learnt = _read_priors(file, "clusters")
    assert isinstance(learnt, LearntGrasps)
    return learnt.without(clip, subject).of(category, side).poses()


def _refuse_own(path: Path, priors: PosePriors, clip: Clip) -> None:
    """Raise ``InputError`` for poses that were learnt from the clip, or from its subject."""
    subject = subject_from_provenance(clip)
    if clip.name in priors.clips:
        raise InputError(path, "clips", f"poses learnt from {clip.name} itself", "poses learnt from other clips")
    if subject and subject in priors.subjects:
        expected = f"poses learnt from others, for {clip.name}: init learn --leave-out {files.printable(subject)}"
        raise InputError(path, "subjects", f"poses learnt from the hands of {files.printable(subject)}", expected)


@lru_cache(maxsize=4)
def _read_priors(file: PriorsFile, init: Init) -> PosePriors | LearntGrasps:
    """Read and check the poses or grasps of a file or folder. Raises ``InputError``."""
    _check_unchanged(file, init)
    return read_learnt(file.path) if init == "clusters" else read_priors_folder(file.path)


def read_learnt(path: Path) -> PosePriors | LearntGrasps:
    """Read a file of ``init learn``: grasps, or poses by its first version. Raises ``InputError``."""
    content = arrays.read(path, lambda key: key in {*PRIOR_NUMBER_KEYS, *PRIOR_NAME_KEYS, "way"})
    version = content.get("version", np.array(0))
    if version.shape != () or version.dtype.kind not in "iu" or version not in (1, PRIORS_VERSION):
        raise InputError(path, "version", files.shorten_value(version.tolist()), f"1 or {PRIORS_VERSION}")
    names = {key: _read_text_array(path, content, key) for key in PRIOR_NAME_KEYS}
    if version == 1:
        T = arrays.floats(path, content, "T_hand_obj", (-1, 4, 4))
        _check_prior_poses(path, "T_hand_obj", T)
        _check_name_counts(path, names, ("category", "side"), len(T))
        return PosePriors(T_hand_obj=T, **names)
    R = arrays.floats(path, content, "R", (-1, 3, 3))
    centre, mesh_centre = (arrays.floats(path, content, key, (len(R), 3)) for key in ("centre", "mesh_centre"))
    _check_prior_poses(path, "R", se3.rigid(R))
    for key, at in (("centre", centre), ("mesh_centre", mesh_centre)):
        _check_prior_poses(path, key, se3.rigid(t=at))
    _check_name_counts(path, names, PRIOR_NAME_KEYS, len(R))
    way = content.get("way", np.array(""))
    if way.shape != () or str(way) not in CLUSTERINGS:
        raise InputError(path, "way", files.shorten_value(way.tolist()), f"one of {', '.join(CLUSTERINGS)}")
    k = _read_whole_number(path, content, "k", 1, MAX_CLUSTERS)
    seed = _read_whole_number(path, content, "seed", 0, 2**63 - 1)
    category, side, clips, subjects = (names[key] for key in PRIOR_NAME_KEYS)
    rows = zip(category, side, R, centre, mesh_centre, clips, subjects, strict=True)
    return LearntGrasps(tuple(TrueGraspPose(*row) for row in rows), k, cast(Way, str(way)), seed)


def _check_name_counts(path: Path, names: dict[str, tuple[str, ...]], keys: Sequence[str], count: int) -> None:
    for key in keys:
        if len(names[key]) != count:
            raise InputError(path, key, f"{len(names[key])} names", f"{count}, one for each pose")


def _read_whole_number(path: Path, content: dict[str, ndarray], key: str, least: int, most: int) -> int:
    number = content.get(key, np.array(-1.0))
    if number.shape != () or number.dtype.kind not in "iu" or not least <= int(number) <= most:
        raise InputError(path, key, files.shorten_value(number.tolist()), f"a whole number from {least} to {most}")
    return int(number)


def read_priors_folder(folder: Path) -> PosePriors:
    """Read the poses of a folder ``<category>/<left or right>_<anything>.npy``: a 4x4 ``T_hand_obj`` each.

    The paper's authors publish theirs so. A factor on a rotation is dropped, as in their code. Raises ``InputError``.
    """
    category, side, poses = list[str](), list[str](), list[ndarray]()
    for name, path in _list_prior_files(folder, "priors").items():
        T = arrays.floats(path, {"": arrays.parse_npy(path, "", files.read_bytes(path))}, "", (4, 4))
        with np.errstate(over="ignore", invalid="ignore"):  # the quotient is then refused as no rotation
            factor = np.cbrt(np.linalg.det(T[:3, :3]))
            if factor > 0:
                T[:3, :3] /= factor
        _check_prior_poses(path, "T_hand_obj", T[None])
        poses.append(T)
        category.append(name.split("/")[0])
        side.append(path.name.split("_")[0])
    return PosePriors(tuple(category), tuple(side), np.stack(poses))


def _list_prior_files(path: Path, init: Init) -> dict[str, Path]:
    """List the files of a user's choice, by name. Raises ``InputError`` without files."""
    if init == "poses":
        inside = [path] if path.is_file() and path.suffix.lower() in POSE_FILE_SUFFIXES else []
        for pattern in ("*", "*/*"):
            inside += files.list_files(path, POSE_FILE_SUFFIXES, pattern)
        tracks = {str(p.relative_to(path)): p for p in inside}
        if not tracks:
            raise InputError(path, "", "no poses", f"files of poses ({', '.join(POSE_FILE_SUFFIXES)})")
        return tracks
    if init == "clusters":
        if not path.is_file():
            raise InputError(path, "", "no such file", "a file that init learn has written")
        return {"": path}
    found = {f"{p.parent.name}/{p.name}": p for side in HAND_SIDES for p in sorted(path.glob(f"*/{side}_*.npy"))}
    if not found:
        raise InputError(path, "", "no poses", "a folder with <category>/<left or right>_<anything>.npy in it")
    return found


def _check_prior_poses(path: Path, key: str, T: Float[ndarray, "N 4 4"]) -> None:
    """Raise ``InputError`` for matrices that are no rigid motions in metres."""
    rigid = se3.is_rigid(T)
    if not rigid.all():
        got = f"a matrix that is no rigid motion ({int(np.argmin(rigid))})"
        raise InputError(path, key, got, "rotations and translations [m]")
    far = float(np.linalg.norm(T[:, :3, 3], axis=1).max())
    if far > MAX_PRIOR_DISTANCE_M:
        got = f"an object {far:.4g} m from the hand"
        raise InputError(path, key, got, f"at most {MAX_PRIOR_DISTANCE_M:g} m; are these millimetres?")


def _read_text_array(path: Path, content: dict[str, ndarray], key: str) -> tuple[str, ...]:
    """Read an array of names, which may be empty."""
    array = content.get(key)
    if array is None or array.dtype.kind != "U" or array.ndim != 1:
        raise InputError(path, key, "no array of names", "a list of names")
    try:
        return tuple(str(text) for text in array)
    except ValueError as error:  # code points that do not exist
        raise InputError(path, key, "a damaged text", "a list of names") from error
