"""The paper's study of 3D-labelled sequences (Sec. 3.2): changes within a stable grasp, and outside it.

Every measure is one number per frame, in the frames of a grasp and before and after it:

- contact: mean IOU of the frame's contact with that of the grasp's (other) frames;
- fingertips: translation and rotation of the five finger pads from their mean pose in the grasp, in the hand frame, by
  the rigid motion nearest to that of their vertices;
- object: deviation from an approximation of its pose fitted to the grasp's frames: one pose in the hand, or a rotation
  about one axis (Eq. 3, ``axis``). Outside the grasp the axis is kept, and the angle is optimal as inside.

Time is normalised: 0 at the grasp's first frame, 1 at its last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS, Clip, Truth
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.stable_grasps.axis import AxisRotation, mean_rotation, pose_hinge, rotation_hinge
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import PairwiseIou, as_listed, segment
from getagrip.stable_grasps.grasp_lists import ListedGrasp

STUDY_MARGIN_FRACTION = 0.5
"""Time before and after a grasp that is measured, as a fraction of the grasp's length."""
NORMALISED_TIMES: Float[ndarray, "S"] = np.linspace(-STUDY_MARGIN_FRACTION, 1.0 + STUDY_MARGIN_FRACTION, 81)
"""Normalised times of the curves' samples."""
_DEG_PER_RAD, _MM_PER_M = float(np.degrees(1.0)), 1e3


@dataclass(frozen=True)
class StudyMeasure:
    """A quantity that is measured in every frame.

    Attributes:
        label: name in tables and figures.
        unit: unit in tables and figures.
        factor: factor from SI to this unit.
    """

    label: str
    unit: str
    factor: float


STUDY_MEASURES = {
    "contact_iou": StudyMeasure("contact IOU with the grasp", "", 1.0),
    "fingers_turned": StudyMeasure("fingertip rotation", "deg", _DEG_PER_RAD),
    "fingers_moved": StudyMeasure("fingertip translation", "mm", _MM_PER_M),
    "static_rotation": StudyMeasure("rotation error, static", "deg", _DEG_PER_RAD),
    "one_dof_rotation": StudyMeasure("rotation error, 1-DoF", "deg", _DEG_PER_RAD),
    "static_place": StudyMeasure("centre error, static", "mm", _MM_PER_M),
    "free_rotation": StudyMeasure("rotation error, 1-DoF of the full pose, axis anywhere", "deg", _DEG_PER_RAD),
    "free_place": StudyMeasure("centre error, 1-DoF of the full pose, axis anywhere", "mm", _MM_PER_M),
    "at_hand_rotation": StudyMeasure("rotation error, 1-DoF of the full pose, axis at the hand", "deg", _DEG_PER_RAD),
    "at_hand_place": StudyMeasure("centre error, 1-DoF of the full pose, axis at the hand", "mm", _MM_PER_M),
}
"""By name. ``one_dof_rotation`` belongs to the best approximation of rotations alone, as in the paper's figures."""


@dataclass(frozen=True)
class StudiedGrasp:
    """The measures of a stable grasp, in SI units.

    Attributes:
        clip: name of the clip.
        side: ``left`` or ``right`` hand.
        object: name of the object.
        start: first frame.
        end: last frame, included.
        duration: duration [s].
        listed: the grasp as a row of a list.
        inside: mean of each measure over the grasp's frames; NaN without a value.
        outside: mean of each measure over other frames within ``STUDY_MARGIN_FRACTION`` before and after the grasp.
        curves: (S,) each measure at ``NORMALISED_TIMES``; NaN beyond the sequence.
        turned: range of the angle about the best axis of the rotations [rad].
        hinge: best hinge of the full poses, its axis anywhere.
    """

    clip: str
    side: str
    object: str
    start: int
    end: int
    duration: float
    listed: ListedGrasp
    inside: dict[str, float]
    outside: dict[str, float]
    curves: dict[str, Float[ndarray, "S"]]
    turned: float
    hinge: AxisRotation


@dataclass(frozen=True)
class Spread:
    """The distribution of a measure over grasps.

    Attributes:
        mean: mean.
        std: standard deviation, divided by n.
        low: first quartile.
        middle: median.
        high: third quartile.
        grasps: number of grasps with a value.
    """

    mean: float
    std: float
    low: float
    middle: float
    high: float
    grasps: int

    @staticmethod
    def of(values: Sequence[float] | Float[ndarray, "n"]) -> Spread:
        """Compute the spread of values without NaN; without any value all but the number is NaN."""
        value = np.asarray(values, dtype=float)
        value = value[np.isfinite(value)]
        if len(value) == 0:
            return Spread(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
        low, middle, high = map(float, np.percentile(value, [25.0, 50.0, 75.0]))
        return Spread(float(value.mean()), float(value.std()), low, middle, high, len(value))


def study(
    clip: Clip, definition: Definition | None = None, progress: Callable[[float], None] = lambda _: None
) -> list[StudiedGrasp]:
    """Measure the stable grasps of a clip, ordered by start. Raises ``InputError`` for a clip without ground truth."""
    iou, grasps = segment(clip, definition, progress)
    return [study_grasp(clip, iou, first, last) for first, last in grasps]


def study_grasp(clip: Clip, iou: PairwiseIou, first: int, last: int) -> StudiedGrasp:
    """Measure one grasp, from its first to its last frame. Raises ``InputError`` for a clip without ground truth."""
    margin = int(np.ceil(STUDY_MARGIN_FRACTION * (last - first)))
    frames = slice(max(0, first - margin), min(len(clip), last + 1 + margin))
    grasp = slice(first - frames.start, last + 1 - frames.start)
    R, c, size = object_in_hand(clip)
    R, c = R[frames], c[frames]
    rotations = rotation_hinge(R[grasp], c[grasp])
    free = pose_hinge(R[grasp], c[grasp], size)
    at_hand = pose_hinge(R[grasp], c[grasp], size, through=np.zeros(3))
    pads = [clip.hand.regions[finger] for finger in FINGERS]
    rotated, moved = fingertip_motion(_require_truth(clip).hand_vertices[frames], pads, grasp)
    values = {
        "contact_iou": mean_contact_iou(iou, frames, slice(first, last + 1)),
        "fingers_turned": rotated,
        "fingers_moved": moved,
        "static_rotation": se3.angle_between(mean_rotation(R[grasp]), R),
        "one_dof_rotation": _hinge_errors(rotations, R, c)[0],
        "static_place": np.linalg.norm(c - c[grasp].mean(axis=0), axis=1),
    }
    values["free_rotation"], values["free_place"] = _hinge_errors(free, R, c)
    values["at_hand_rotation"], values["at_hand_place"] = _hinge_errors(at_hand, R, c)
    is_inside = np.zeros(len(R), dtype=bool)
    is_inside[grasp] = True
    time = (np.arange(len(R)) - grasp.start) / max(last - first, 1)
    return StudiedGrasp(
        clip=clip.name,
        side=clip.side,
        object=clip.category,
        start=first,
        end=last,
        duration=(last + 1 - first) / clip.fps,
        listed=as_listed(clip, first, last),
        inside={name: Spread.of(values[name][is_inside]).mean for name in STUDY_MEASURES},
        outside={name: Spread.of(values[name][~is_inside]).mean for name in STUDY_MEASURES},
        curves={name: np.interp(NORMALISED_TIMES, time, values[name], np.nan, np.nan) for name in STUDY_MEASURES},
        turned=float(np.ptp(np.unwrap(rotations.angles(R[grasp], c[grasp])))),
        hinge=free,
    )


def _hinge_errors(
    hinge: AxisRotation, R: Float[ndarray, "N 3 3"], c: Float[ndarray, "N 3"]
) -> tuple[Float[ndarray, "N"], Float[ndarray, "N"]]:
    """Errors of a hinge's nearest poses: angle [rad], and distance of the centre [m]."""
    R_found, c_found = hinge.nearest(R, c)
    return se3.angle_between(R_found, R), np.linalg.norm(c_found - c, axis=1)


def object_in_hand(clip: Clip) -> tuple[Float[ndarray, "T 3 3"], Float[ndarray, "T 3"], float]:
    """Compute rotation, position of the centre [m] and ``size`` [m] of the object in the true hand's frame (Eq. 3).

    The centre is that of the object's surface, the size its radius of gyration over the root of 3. Raises
    ``InputError`` for a clip without ground truth.
    """
    truth = _require_truth(clip)
    areas = clip.mesh.vertex_areas / clip.mesh.vertex_areas.sum()
    centre = areas @ clip.mesh.vertices
    size = truth.scale * float(np.sqrt(areas @ np.sum((clip.mesh.vertices - centre) ** 2, axis=1) / 3.0))
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    return T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, truth.scale * centre[None])[:, 0], size


def _require_truth(clip: Clip) -> Truth:
    if clip.truth is None:
        raise InputError(clip.origin / "truth.npz", "", "no such file", "the true poses, which are studied")
    return clip.truth


def mean_contact_iou(iou: PairwiseIou | Float[ndarray, "T T"], frames: slice, grasp: slice) -> Float[ndarray, "N"]:
    """Compute the mean contact IOU of each of ``frames`` with all other frames of ``grasp``; NaN without others.

    Both slices count the sequence's frames.
    """
    pairs = iou[frames, grasp]
    rows, columns = np.arange(frames.start, frames.stop)[:, None], np.arange(grasp.start, grasp.stop)
    others = rows != columns
    count = others.sum(axis=1)
    return np.divide((pairs * others).sum(axis=1), count, out=np.full(len(rows), np.nan), where=count > 0)


def fingertip_motion(
    vertices: Float[ndarray, "N V 3"], pads: Sequence[Int[ndarray, "_"]], grasp: slice
) -> tuple[Float[ndarray, "N"], Float[ndarray, "N"]]:
    """Compute the mean rotation [rad] and translation [m] of a hand's pads from their mean pose in the grasp.

    ``pads`` are indices of vertices; motion is relative to the hand frame. Rotations are NaN where a pad has too few
    vertices to determine them.
    """
    rotated, moved = [], []
    for ids in pads:
        pad = vertices[:, ids]
        centre = pad.mean(axis=1, keepdims=True)
        R = _fit_rotations(pad - centre, grasp)
        rotated.append(np.full(len(pad), np.nan) if R is None else se3.angle_between(mean_rotation(R[grasp]), R))
        moved.append(np.linalg.norm((centre - centre[grasp].mean(axis=0))[:, 0], axis=1))
    return np.mean(rotated, axis=0), np.mean(moved, axis=0)


def _fit_rotations(pad: Float[ndarray, "N P 3"], grasp: slice) -> Float[ndarray, "N 3 3"] | None:
    """Rotations of points about their mean, from the grasp's first frame (Kabsch); None for points on a line."""
    model = pad[grasp][0]
    if len(model) < 3 or np.linalg.svd(model, compute_uv=False)[1] < 1e-6:
        return None
    return se3.nearest_rotation(np.swapaxes(pad, -1, -2) @ model)


def mean_curves(studied: Sequence[StudiedGrasp]) -> dict[str, list[Spread]]:
    """Compute the spread of each measure over grasps at each of ``NORMALISED_TIMES``."""
    curves = {name: np.array([one.curves[name] for one in studied]).T for name in STUDY_MEASURES}
    return {name: [Spread.of(values) for values in curve] for name, curve in curves.items()}
