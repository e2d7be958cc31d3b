"""Poses in which objects of a category are held, for the search to start from: a file that ``learn_priors`` has made,
or a folder that the user brings. A file says which clips and whose hands it was learnt from, and is not used for those.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.errors import InputError
from getagrip.fitting.options import Init, Options, PriorsFile
from getagrip.geometry import se3
from getagrip.io import arrays, files

VERSION = 1
NAMES = ("category", "side", "clips", "subjects")
"""Arrays of names in a file of learnt poses, besides ``T_hand_obj`` and ``version``."""
SIDES = ("left", "right")
FARTHEST = 2.0
"""Largest plausible distance of an object's origin from that of the hand frame [m]."""


@dataclass(frozen=True)
class Priors:
    """Poses of objects in hands: N of them.

    Attributes:
        category: category of the object of each pose.
        side: ``left`` or ``right`` hand of each pose.
        T_hand_obj: (N, 4, 4) poses, object frame to hand frame [m].
        clips: names of the clips they were learnt from; empty for poses from elsewhere.
        subjects: people whose hands were in those clips.
    """

    category: tuple[str, ...]
    side: tuple[str, ...]
    T_hand_obj: Float[ndarray, "N 4 4"]
    clips: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()

    def of(self, category: str, side: str) -> Float[ndarray, "k 4 4"]:
        """The poses of a category in a hand, those of most grasps first."""
        here = [n for n, key in enumerate(zip(self.category, self.side, strict=True)) if key == (category, side)]
        return self.T_hand_obj[here]


def subject_of(clip: Clip) -> str:
    """Whose hand is in a clip, as its provenance says; empty where it does not."""
    return str(clip.provenance.get("subject", ""))


def write(priors: Priors, path: Path) -> None:
    """Write learnt poses as an ``.npz`` file."""
    names = {name: np.array(getattr(priors, name), np.str_) for name in NAMES}
    arrays.write(path, {"version": np.array(VERSION), "T_hand_obj": priors.T_hand_obj, **names})


def given(path: Path, init: Init) -> PriorsFile:
    """The file or folder that a user names for a way of starting, and its checksum. Raises ``InputError``."""
    return PriorsFile(path, files.sha256(_parts(path, init)))


def poses_for(clip: Clip, options: Options) -> tuple[Float[ndarray, "k 4 4"], tuple[str, ...]]:
    """The poses that the search may start from before uniform rotations, and what to say about them.

    Raises ``InputError`` for files that are missing, malformed or not what they were when the options were made, and
    for poses learnt from this clip or from other grasps of the same subject.
    """
    if options.priors is None:
        return np.zeros((0, 4, 4)), ()
    priors = _read(options.priors, options.init)
    path = options.priors.path
    _refuse_own(path, priors, clip)
    poses = priors.of(clip.category, clip.side)[: options.inits]
    uniform = f"{options.inits - len(poses)} uniform rotations"
    if not len(poses):
        return poses, (f"{path.name} has no poses of {files.plain(clip.category)} in a {clip.side} hand: {uniform}",)
    whence = "" if priors.clips else ", which does not say what they were learnt from"
    return poses, (f"started from {len(poses)} poses of {path.name}{whence}, and {uniform}",)


def _refuse_own(path: Path, priors: Priors, clip: Clip) -> None:
    """Raise ``InputError`` for poses that were learnt from the clip, or from its subject."""
    subject = subject_of(clip)
    if clip.name in priors.clips:
        raise InputError(path, "clips", f"poses learnt from {clip.name} itself", "poses learnt from other clips")
    if subject and subject in priors.subjects:
        expected = f"poses learnt from others, for {clip.name}: init learn --leave-out {files.plain(subject)}"
        raise InputError(path, "subjects", f"poses learnt from the hands of {files.plain(subject)}", expected)


@lru_cache(maxsize=4)
def _read(file: PriorsFile, init: Init) -> Priors:
    """The poses of a file or folder, checked. Raises ``InputError``."""
    if given(file.path, init).sha256 != file.sha256:
        raise InputError(file.path, "", "another content than a moment ago", "a file that stays as it is")
    return read_learnt(file.path) if init == "clusters" else read_folder(file.path)


def read_learnt(path: Path) -> Priors:
    """The poses that ``write`` has written. Raises ``InputError``."""
    content = arrays.read(path, lambda key: key in {"version", "T_hand_obj", *NAMES})
    version = content.get("version", np.array(0))
    if version.shape != () or version != VERSION:
        raise InputError(path, "version", files.shown(version.tolist()), str(VERSION))
    T = arrays.floats(path, content, "T_hand_obj", (-1, 4, 4))
    _check_poses(path, T)
    names = {key: _texts(path, content, key) for key in NAMES}
    for key in ("category", "side"):
        if len(names[key]) != len(T):
            raise InputError(path, key, f"{len(names[key])} names", f"{len(T)}, one for each pose")
    return Priors(T_hand_obj=T, **names)


def read_folder(folder: Path) -> Priors:
    """The poses of a folder ``<category>/<left or right>_<anything>.npy``: a 4x4 ``T_hand_obj`` each.

    So the authors keep theirs. A factor on a rotation is dropped, as their code does. Raises ``InputError``.
    """
    category, side, poses = list[str](), list[str](), list[ndarray]()
    for name, path in _parts(folder, "priors").items():
        T = arrays.floats(path, {"": arrays.parse_npy(path, "", files.read_bytes(path))}, "", (4, 4))
        factor = np.cbrt(np.linalg.det(T[:3, :3]))
        if factor > 0:
            T[:3, :3] /= factor
        _check_poses(path, T[None])
        poses.append(T)
        category.append(name.split("/")[0])
        side.append(path.name.split("_")[0])
    return Priors(tuple(category), tuple(side), np.stack(poses))


def _parts(path: Path, init: Init) -> dict[str, Path]:
    """The files that a user's choice is made of, by name. Raises ``InputError`` where there are none."""
    if init == "clusters":
        if not path.is_file():
            raise InputError(path, "", "no such file", "a file that init learn has written")
        return {"": path}
    found = {f"{p.parent.name}/{p.name}": p for side in SIDES for p in sorted(path.glob(f"*/{side}_*.npy"))}
    if not found:
        raise InputError(path, "", "no poses", "a folder with <category>/<left or right>_<anything>.npy in it")
    return found


def _check_poses(path: Path, T: Float[ndarray, "N 4 4"]) -> None:
    """Raise ``InputError`` for what is no rigid motion in metres."""
    with np.errstate(over="ignore", invalid="ignore"):
        rigid = se3.is_rigid(T)
    if not rigid.all():
        given = f"a matrix that is no rigid motion ({int(np.argmin(rigid))})"
        raise InputError(path, "T_hand_obj", given, "rotations and translations [m]")
    far = float(np.linalg.norm(T[:, :3, 3], axis=1).max())
    if far > FARTHEST:
        given = f"an object {far:.4g} m from the hand"
        raise InputError(path, "T_hand_obj", given, f"at most {FARTHEST:g} m; are these millimetres?")


def _texts(path: Path, content: dict[str, ndarray], key: str) -> tuple[str, ...]:
    """An array of names, which may be empty."""
    array = content.get(key)
    if array is None or array.dtype.kind != "U" or array.ndim != 1:
        raise InputError(path, key, "no array of names", "a list of names")
    try:
        return tuple(str(text) for text in array)
    except ValueError as error:  # code points that do not exist
        raise InputError(path, key, "a damaged text", "a list of names") from error
