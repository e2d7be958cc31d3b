"""ARCTIC's s05 with hands as they were estimated from images, beside the true tracks: in ArtiGrasp's repository.

ArtiGrasp's authors ran an estimator of hands and object on images of ARCTIC's fixed cameras (no file says which) and
keep what it found of 31 sequences, in the camera's axes:

    mano_double/ee_recon/s5/<sequence>_l.npy, _r.npy        (T, 21, 3): joints [m], HO-3D's order
    arctic/<object>/s5_recon/<sequence>.object.npy          (T, 7): joint angle, rotation vector, translation [mm]

beside the true tracks of the same frames (``artigrasp``). What to know of it:

- The first and last ``NOT_ESTIMATED`` frames hold a hand at rest, no estimate.
- The object's translation is the same in all frames: only where hands are relative to the object is known. So an
  estimated hand stands here as far from the true origin of the object as from the estimated one, and what is off in
  both, or in the object's place, counts as the hand's error.
- The camera is not given. It stands still, so its orientation is that which takes the true rotations of the object to
  the estimated ones, their median over the sequence: a constant error of the object's rotation counts as the hand's,
  too. Its distance and focal length are assumed.

The generic hand is fitted to the estimated joints as to the true ones. Clips are given the estimated hand; the true one
is the ground truth, cuts sequences to grasps and hides the object in the masks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.datasets import artigrasp
from getagrip.datasets.assumed_camera import facing
from getagrip.datasets.cutting import TrackedDataset
from getagrip.datasets.dataset import Note
from getagrip.datasets.fitted_hands import describe_fit, fit_hand
from getagrip.datasets.joint_tracks import Motion, tracks
from getagrip.datasets.tracks import Source, Track
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.grasps.options import GraspOptions
from getagrip.hands.model import Side

NOT_ESTIMATED = 10
"""Frames at either end without an estimate."""
ESTIMATED = "_recon"
"""What a subject's folder of estimates is called besides its name."""


@dataclass(frozen=True, kw_only=True)
class EstimatedArtiGrasp(TrackedDataset):
    """ARCTIC's s05 in ArtiGrasp's repository, hands as estimated from images beside the true ones."""

    grasps: Annotated[GraspOptions, arg(name="")] = artigrasp.WITHIN_10_MM
    """What counts as a stable grasp."""

    def sources(self) -> list[Source]:
        """The sequences with estimates below ``root``, ArtiGrasp's folder or its ``rsc``."""
        rsc, found = files(self.root)
        return [Source(f"{f.parent.name}/{artigrasp.sequence_of(f)}", partial(_read, rsc, f)) for f in found]


def files(root: Path) -> tuple[Path, list[Path]]:
    """ArtiGrasp's ``rsc``, and the file of the estimated object of each sequence. Raises ``InputError``."""
    rsc = artigrasp.folder_rsc(root)
    found = sorted(rsc.glob(f"arctic/*/*{ESTIMATED}/*.object.npy"))
    if not found:
        given = f"no arctic/<object>/<subject>{ESTIMATED}/<sequence>.object.npy in it"
        raise InputError(root, "", given, "ArtiGrasp's folder, or its rsc")
    return rsc, found


@dataclass(frozen=True)
class Estimates:
    """A sequence as it truly was, before the camera of the estimates, and joints of the estimated hands there."""

    true: Motion
    T_cam_world: Float[ndarray, "T 4 4"]
    joints: dict[Side, Float[ndarray, "T 21 3"]]
    """In the camera frame [m], in this package's order."""


def _read(rsc: Path, file: Path, note: Note) -> Iterator[Track]:
    """The object in each hand over a sequence, by the file of the estimated object."""
    estimates = read_estimates(rsc, file, note)
    if estimates is None:
        return
    for track in tracks(estimates.true):
        given = fit_hand(file, f"{track.side} joints", track.side, estimates.joints[track.side])
        provenance = {
            "hands": "the generic hand, fitted to 21 joints that were estimated from images; placed by the object's "
            "true place, since the estimates hold the object still",
            "truth": f"the generic hand, fitted to the true 21 joints: {track.provenance['hand_fit']}",
            "hand_fit": describe_fit(given.residuals) + ", over the sequence",
        }
        yield replace(track, given_hand=given.track, provenance=track.provenance | provenance)


def read_estimates(rsc: Path, file: Path, note: Note) -> Estimates | None:
    """A sequence, by the file of the estimated object; None where too few frames are right. Raises ``InputError``."""
    subject, sequence = file.parent.name.removesuffix(ESTIMATED), artigrasp.sequence_of(file)
    motion = artigrasp.true_motion(rsc, file.parents[1] / subject / file.name, note, NOT_ESTIMATED)
    if motion is None:
        return None
    poses = artigrasp.numbers(file, (-1, 7))
    if len(poses) <= motion.numbers[-1]:
        raise InputError(file, "", f"{len(poses)} frames", f"{motion.numbers[-1] + 1} or more, as of {motion.file}")
    rows, template = motion.numbers, artigrasp.read_template(rsc / "arctic" / motion.category)
    folder = rsc / "mano_double" / f"ee{ESTIMATED}" / subject
    estimated = {side: j[rows] for side, j in artigrasp.read_joints(folder, sequence, len(poses)).items()}
    T_estimate_obj = (artigrasp.rigid(poses) @ se3.inverse(template.T_neutral_template))[rows]
    R_cam_world = median_rotation(T_estimate_obj[:, :3, :3] @ np.swapaxes(motion.T_world_obj[:, :3, :3], 1, 2))
    centres = se3.transform(motion.T_world_obj, motion.mesh.centre[None])[:, 0]
    camera = facing(R_cam_world, centres, "a guess but for its orientation, which is that of the estimates; fixed")
    origin = template.joint.point[None]  # the template's: what an estimate of the object places
    displaced = se3.transform(camera.T_cam_world @ motion.T_world_obj, origin) - se3.transform(T_estimate_obj, origin)
    return Estimates(
        replace(motion, camera=camera), camera.T_cam_world, {side: j + displaced for side, j in estimated.items()}
    )


def median_rotation(R: Float[ndarray, "T 3 3"]) -> Float[ndarray, "3 3"]:
    """The rotation with the least sum of angles to others (Weiszfeld's iteration from the best of some of them)."""
    some = R[:: max(1, len(R) // 200)]
    median = some[np.argmin(se3.angle_between(some[:, None], some[None]).sum(axis=1))]
    for _ in range(20):
        off = se3.log_so3(R @ median.T)
        weights = 1.0 / np.maximum(np.linalg.norm(off, axis=1), np.radians(0.1))
        median = se3.exp_so3(weights @ off / weights.sum()) @ median
    return median
