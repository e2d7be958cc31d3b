"""The errors of a draft from pixels beside the truth: its masks, its hand, its object, its candidates, and its words.

Benchmarks of images with known poses share them. The object is in the camera, up to its symmetries; an error is split
into the part along the ray from the camera to the object's centre, which one view hardly tells, and the part across it.
A stage's error says which stage is to blame: of masks, of the hand as it was found, of the hand as it was solved.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io.array_data import ArrayData
from getagrip.metrics.mask import iou_of_poses
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import Symmetries, find_symmetries
from getagrip.result import Reconstruction

PALM_JOINTS = (0, 5, 9, 13, 17)
"""Wrist and knuckles among the 21 joints: what turns with the palm."""
MIN_PALM_JOINTS = 3
"""Least number of known palm joints from which a palm's rotation is computed."""


@dataclass(frozen=True, eq=False)
class PixelTruth(ArrayData):
    """The truth of the frames of a view.

    Attributes:
        frames: names of the frames, as a draft's clip has them.
        mesh: the object's mesh [m].
        T_cam_obj: (T, 4, 4) true pose of the object, object frame to camera frame [m].
        joints: (T, 21, 3) true joints of the hand in the camera frame [m], wrist first, then thumb to little finger;
            NaN where unknown. None if no joint is known.
        masks: (T, H, W) true visible pixels of the object; None if unknown.
        T_cam_hand: (T, 4, 4) true pose of the hand, hand frame to camera frame [m]; None if unknown.
    """

    frames: tuple[str, ...]
    mesh: Mesh
    T_cam_obj: Float[ndarray, "T 4 4"]
    joints: Float[ndarray, "T 21 3"] | None = None
    masks: Bool[ndarray, "T H W"] | None = None
    T_cam_hand: Float[ndarray, "T 4 4"] | None = None

    def rows(self, frames: Sequence[str]) -> Int[ndarray, "n"]:
        """Return the rows of some frames. Raises ``UsageError`` for a frame without truth."""
        place = {name: row for row, name in enumerate(self.frames)}
        unknown = next((name for name in frames if name not in place), None)
        if unknown is not None:
            raise UsageError(f"frame {unknown} has no truth: known are {self.frames[0]} to {self.frames[-1]}")
        return np.array([place[name] for name in frames], dtype=np.int64)


@dataclass(frozen=True)
class ObjectErrors:
    """Errors of an object in the camera over some frames, up to its symmetries.

    Attributes:
        right: whether the mean ADD is below 10 % of the diameter.
        add_mm: mean over vertices and frames of the distance between corresponding vertices [mm].
        add_percent: the same [% of the diameter].
        along_mm: median shift of the object's centre along the true ray, positive away from the camera [mm].
        across_mm: median distance of the centre across the true ray [mm].
        rotation_deg: median angle between the rotations [degrees].
        turned_deg: the same, symmetries of the shape not counted: by its texture a box has none.
    """

    right: bool
    add_mm: float
    add_percent: float
    along_mm: float
    across_mm: float
    rotation_deg: float
    turned_deg: float


@dataclass(frozen=True)
class HandErrors:
    """Errors of a hand in the camera, over the frames and joints whose truth is known.

    Attributes:
        joints_mm: median over frames of the mean distance of the joints [mm].
        along_mm: median over frames of the joints' mean shift along the true ray, positive away from the camera [mm].
        palm_deg: median rotation of the palm, by wrist and knuckles [degrees]; NaN where fewer than three are known.
        tilt_deg: median angle between the palm's normals, a part of that rotation [degrees].
    """

    joints_mm: float
    along_mm: float
    palm_deg: float
    tilt_deg: float


@dataclass(frozen=True)
class Said:
    """The words of a result about itself.

    Attributes:
        in_hand: probability that its poses are right in the hand; None if it states none.
        in_camera: the same, in the camera.
        extrapolated: signs that were worse than in nearly all of the calibration's clips.
        ambiguous: whether another candidate explains the masks almost as well.
        serious: names of the checks with serious findings.
        notes: names of the checks with other findings.
        refused: whether the result is failed, or has a serious finding.
        distance_interval_mm: interval that contains the object's distance with 90 %; None if it states none.
        signs: measures from which the probabilities are computed, by name.
    """

    in_hand: float | None
    in_camera: float | None
    extrapolated: tuple[str, ...]
    ambiguous: bool
    serious: tuple[str, ...]
    notes: tuple[str, ...]
    refused: bool
    distance_interval_mm: tuple[float, float] | None = None
    signs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PixelErrors:
    """Errors of a draft, by stage, and its words.

    Attributes:
        frames: number of frames of the result.
        iou: mean IOU of the result's silhouettes with the draft's masks: what the fit sees.
        mask_iou: median IOU of the draft's masks with the true ones; None where these are unknown.
        true_pose_iou: mean IOU of the true poses' silhouettes with the draft's masks; where it is below ``iou``, masks
            of object or hand are to blame for a wrong pose. None without masks.
        object: of the result.
        candidates: of each kept candidate, the result first.
        distance_mm: median over frames of the true distance from the camera to the object's centre [mm].
        right_in_hand: of each kept candidate, whether its mean ADD in the hand is below 10 % of the diameter; None
            where the true hand is unknown.
        hand_found: of the hand that the fit started from; None without known joints.
        hand_solved: of the hand of the result.
        said: words of the result.
    """

    frames: int
    iou: float
    mask_iou: float | None
    object: ObjectErrors
    candidates: tuple[ObjectErrors, ...]
    hand_found: HandErrors | None
    hand_solved: HandErrors | None
    said: Said
    true_pose_iou: float | None = None
    distance_mm: float = 0.0
    right_in_hand: tuple[bool, ...] | None = None

    @property
    def right_among_candidates(self) -> bool:
        """True if a kept candidate is right."""
        return any(each.right for each in self.candidates)

    @property
    def nearest_candidate(self) -> ObjectErrors:
        """The kept candidate with the least ADD."""
        return min(self.candidates, key=lambda each: each.add_mm)


def measure(truth: PixelTruth, clip: Clip, result: Reconstruction, masks: Masks | None = None) -> PixelErrors:
    """Measure a draft's clip and result; ``masks`` are the clip's, to be compared with the true ones.

    Raises ``UsageError`` for frames without truth.
    """
    rows, symmetries = truth.rows(result.frames), find_symmetries(truth.mesh)
    known = result.T_cam_hand
    T_cam_hand = clip.hand.T_cam_hand[clip.index_of(result.frames)] if known is None else known
    size = clip.mesh.diameter / truth.mesh.diameter  # a draft may have scaled the mesh as it read it
    true = truth.T_cam_obj[rows]
    each = [
        object_errors(truth.mesh, ObjectTrack(T_cam_hand @ T, size * scale), true, symmetries)
        for T, scale in zip(result.candidates.T_hand_obj, result.candidates.scale, strict=True)
    ]
    own = object_errors(truth.mesh, ObjectTrack(T_cam_hand @ result.T_hand_obj, size * result.scale), true, symmetries)
    found = solved = None
    if truth.joints is not None and clip.hand.joints is not None:
        joints = clip.hand.joints
        found = hand_errors(se3.transform(clip.hand.T_cam_hand, joints), truth.joints[truth.rows(clip.frames)])
        moved = result.hand_scale * joints[clip.index_of(result.frames)]
        solved = hand_errors(se3.transform(T_cam_hand, moved), truth.joints[rows])
    overlap = None
    if truth.masks is not None and masks is not None:
        overlap = mask_overlap(masks.object, truth.masks[truth.rows(clip.frames)])
    of_truth = None
    if masks is not None:
        of_clip = truth.T_cam_obj[truth.rows(clip.frames)]
        of_truth = float(np.nanmean(iou_of_poses(truth.mesh, 1.0, of_clip, clip.K, masks).full))
    in_hand = None
    if truth.T_cam_hand is not None:
        T_hand_obj = se3.inverse(truth.T_cam_hand[rows]) @ true
        tracks = zip(result.candidates.T_hand_obj, size * result.candidates.scale, strict=True)
        in_hand = tuple(object_errors(truth.mesh, ObjectTrack(*one), T_hand_obj, symmetries).right for one in tracks)
    distance = float(np.median(np.linalg.norm(se3.transform(true, truth.mesh.centre[None])[:, 0], axis=1)))
    return PixelErrors(
        len(rows), result.mean_iou, overlap, own, tuple(each), found, solved, said_by(result), of_truth,
        1e3 * distance, in_hand,
    )  # fmt: skip


def object_errors(
    mesh: Mesh, found: ObjectTrack, T_cam_obj: Float[ndarray, "T 4 4"], symmetries: Symmetries | None = None
) -> ObjectErrors:
    """Measure an object in the camera against its true poses; without ``symmetries``, up to those that it finds."""
    true = ObjectTrack(T_cam_obj, 1.0)
    S = best_symmetry(mesh, found, true, find_symmetries(mesh) if symmetries is None else symmetries)
    errors = pose_errors(mesh, found, true, S)
    centre, moved = (track.placed(mesh.centre[None])[:, 0] for track in (true, found))
    along, across = _split_by_ray(centre, moved - centre)
    return ObjectErrors(
        errors.success,
        1e3 * float(errors.add.mean()),
        100.0 * float(errors.add.mean()) / errors.diameter,
        1e3 * float(np.median(along)),
        1e3 * float(np.median(across)),
        float(np.degrees(np.median(errors.rotation))),
        float(np.degrees(np.median(se3.angle_between(found.T_ref_obj[:, :3, :3], T_cam_obj[:, :3, :3])))),
    )


def hand_errors(found: Float[ndarray, "T 21 3"], true: Float[ndarray, "T 21 3"]) -> HandErrors | None:
    """Measure a hand's joints in the camera frame [m]; NaN in ``true`` is unknown. None where no joint is known."""
    known = np.isfinite(true).all(axis=2)
    shown = known.any(axis=1)
    if not shown.any():
        return None
    off, along, turns, tilts = [], [], [], []
    for hand, joints, at in zip(found[shown], true[shown], known[shown], strict=True):
        off.append(np.linalg.norm(hand[at] - joints[at], axis=1).mean())
        centre = joints[at].mean(axis=0)
        along.append(_split_by_ray(centre[None], (hand[at].mean(axis=0) - centre)[None])[0][0])
        palm = [joint for joint in PALM_JOINTS if at[joint]]
        if len(palm) >= MIN_PALM_JOINTS:
            R = _rotation_onto(hand[palm], joints[palm])
            normal = np.linalg.svd(hand[palm] - hand[palm].mean(axis=0))[2][2]
            turns.append(se3.angle_between(R, np.eye(3)))
            tilts.append(np.arccos(np.clip(normal @ R @ normal, -1.0, 1.0)))
    palm_deg, tilt_deg = (float(np.degrees(np.median(each))) if each else float("nan") for each in (turns, tilts))
    return HandErrors(1e3 * float(np.median(off)), 1e3 * float(np.median(along)), palm_deg, tilt_deg)


def mask_overlap(found: Iterable[Bool[ndarray, "H W"]], true: Iterable[Bool[ndarray, "H W"]]) -> float:
    """Return the median IOU over frames; 1 in a frame where both are empty."""
    each = []
    for one, other in zip(found, true, strict=True):
        union = np.count_nonzero(one | other)
        each.append(np.count_nonzero(one & other) / union if union else 1.0)
    return float(np.median(each))


def said_by(result: Reconstruction) -> Said:
    """Return the words of a result about itself."""
    hand, camera = result.probability_right, result.probability_right_in_camera
    serious, notes = (tuple(each.check for each in result.findings if each.serious == s) for s in (True, False))
    return Said(
        None if hand is None else hand.value,
        None if camera is None else camera.value,
        () if hand is None else hand.beyond,
        result.ambiguous,
        serious,
        notes,
        refused=result.status.failed or bool(serious),
        distance_interval_mm=result.distance_interval_mm,
        signs=result.signs,
    )


def _split_by_ray(
    centre: Float[ndarray, "T 3"], shift: Float[ndarray, "T 3"]
) -> tuple[Float[ndarray, "T"], Float[ndarray, "T"]]:
    """Split shifts into the part along the ray to a point, with its sign, and the length of the rest [m]."""
    ray = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    along = np.sum(shift * ray, axis=1)
    return along, np.linalg.norm(shift - along[:, None] * ray, axis=1)


def _rotation_onto(points: Float[ndarray, "n 3"], onto: Float[ndarray, "n 3"]) -> Float[ndarray, "3 3"]:
    """Return the rotation that turns centred points best onto others."""
    return se3.nearest_rotation((onto - onto.mean(axis=0)).T @ (points - points.mean(axis=0)))
