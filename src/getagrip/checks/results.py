"""Checks of results: masks that agree with each other against the result, frames that fit less, and regrasps.

A right result differs from rough masks at random places in each frame. A wrong pose, hand, mesh or camera differs from
exact masks at the same side of the object in consecutive frames. If most masks are met, and consecutive ones much less,
these masks lack a part of the object, or their hands are wrong.

A regrasp is one step of the object in the hand that is far larger than all others: the hand lets go and grasps again,
but a clip is meant to have one stable grasp.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.evidence import Evidence
from getagrip.clip.clip import frame_indices
from getagrip.geometry import se3
from getagrip.geometry.mesh import squared_distances
from getagrip.geometry.rasterize import render_packed
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries, surface_points
from getagrip.result import Axis, Candidates

N_COMPARED_FRAMES, N_COMPARED_POINTS = 5, 200
"""Number of frames and of surface points at which candidates are compared."""
MAX_GOOD_MISFIT, MIN_GOOD_IOU = 3.0, 0.9
"""Limits beyond which the agreement of masks is checked: maximum misfit, minimum IOU."""
LOWER_MIN_IOU = 0.85
"""Minimum IOU for a built-in shape, which is not the object's, and beside further views: cameras and masks of each have
errors, of which every view's IOU has a share. The misfit is not checked for a built-in shape: in 45 grasps of videos it
was large for two right results and no wrong one."""
N_DIFFERENCE_CELLS = 8
"""Number of cells along either side of the square around a mask; cells are larger than the motion between frames."""
MIN_DIFFERENCE_CORRELATION = 0.5
"""Correlation of differences in consecutive frames above which masks agree. In trials on 8 synthetic clips, contours
off by 4 px anew in each frame had at most 0.43 beside right poses, and at least 0.85 in the four of 20 frames with
wrongly turned hands (no command repeats these trials)."""
UNEVEN_IOU_RATIO = 0.9
"""IOU relative to the median below which a frame is met less than the others."""
MIN_REGRASP_FRAMES = 8
"""Minimum number of frames in which a regrasp is looked for."""
USUAL_STEP_RANK = 3
"""Rank, by size, of the step that represents the clip's usual step."""
N_REGRASP_POINTS = 200
"""Number of surface points whose steps are averaged."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedEvidence(Evidence):
    """A solved clip at the sampled frames, with the hand in which its poses are given; features are computed from it.

    Attributes:
        T_hand_obj: (T, 4, 4) found poses.
        iou: (T,) IOU of rendered and observed mask.
        candidates: the best distinct solutions in these frames; the first is the result.
        axis: the found axis; None for methods without one.
        T_cam_hand_input: (T, 4, 4) poses of the input hand.
        spread: standard deviation of the pose that the energy leaves [diameters]; NaN if unknown.
        hand_spread: standard deviation of an object in the hand that the evidence on the hand leaves [m].
        joint_error: error of the hand's 2D joints, estimated from the clip [fractions of its box]; NaN without joints.
        distance_spread: standard deviation of the object's distance from the camera by sizes and depth [diameters]; NaN
            if unknown.
    """

    candidates: Candidates
    axis: Axis | None
    T_cam_hand_input: Float[ndarray, "T 4 4"]
    spread: float
    hand_spread: float
    joint_error: float = np.nan
    distance_spread: float = np.nan

    @property
    def poses(self) -> Float[ndarray, "T 4 4"]:
        """``T_hand_obj``, which is never None here."""
        assert self.T_hand_obj is not None
        return self.T_hand_obj

    @property
    def diameter(self) -> float:
        """Diameter of the object at the resulting scale [m]."""
        return self.scale * self.clip.mesh.diameter

    @property
    def energy_times(self) -> Float[ndarray, "K"]:
        """Energies of the candidates, relative to the least."""
        energy = np.maximum(self.candidates.energy, 1e-9)
        return np.asarray(energy / energy.min())

    @cached_property
    def apart(self) -> Float[ndarray, "K"]:
        """Distance of each candidate's surface from the first one's [diameters].

        Mean distance to the nearest point, so that it is 0 for symmetric poses.
        """
        few = frame_indices(len(self.clip), N_COMPARED_FRAMES)
        points = surface_points(self.clip.mesh, N_COMPARED_POINTS)
        T, scale = self.candidates.T_hand_obj[:, few], self.candidates.scale[:, None, None, None]
        surfaces = se3.transform(T, scale * points)
        off = [
            [np.sqrt(squared_distances(x, y).min(axis=1)).mean() for x, y in zip(surface, surfaces[0], strict=True)]
            for surface in surfaces
        ]
        nearest = [np.sqrt(np.partition(squared_distances(y, y), 1, axis=1)[:, 1]).mean() for y in surfaces[0]]
        return np.maximum(np.mean(off, axis=1) - 0.5 * np.mean(nearest), 0.0) / self.diameter

    def vertices_apart(self, k: int) -> float:
        """Compute the distance of a candidate's vertices from the first one's [diameters]: ADD, up to symmetries."""
        if k == 0:
            return 0.0
        few, mesh, found = frame_indices(len(self.clip), N_COMPARED_FRAMES), self.clip.mesh, self.candidates
        first, other = (ObjectTrack(found.T_hand_obj[n, few], float(found.scale[n])) for n in (0, k))
        symmetry = best_symmetry(mesh, other, first, find_symmetries(mesh))
        return float(pose_errors(mesh, other, first, symmetry).add.mean()) / self.diameter

    @cached_property
    def off_axis(self) -> float:
        """Angle between the motion and a rotation about its axis, root mean square [rad]."""
        R = self.poses[:, :3, :3]
        if self.axis is not None:
            R = se3.exp_so3(-self.axis.angle[:, None] * self.axis.direction) @ R
        return float(np.sqrt(np.mean(se3.angle_between(R, se3.nearest_rotation(R.mean(axis=0))) ** 2)))

    @property
    def hand_shift(self) -> float:
        """Shift of the hand's middle by the refinement, mean over frames [m]."""
        middle = self.clip.hand.vertices.mean(axis=(0, 1))[None]
        T, value = self.clip.hand.T_cam_hand, self.T_cam_hand_input
        return float(np.linalg.norm(se3.transform(T, middle) - se3.transform(value, middle), axis=-1).mean())

    @property
    def hand_turn(self) -> float:
        """Rotation of the hand by the refinement, mean over frames [rad]."""
        T, value = self.clip.hand.T_cam_hand, self.T_cam_hand_input
        return float(se3.angle_between(T[:, :3, :3], value[:, :3, :3]).mean())


def consistent_contour_misfit(it: Evidence) -> float:
    """Return the misfit of contours to masks that agree with each other; else, and for built-in shapes, NaN."""
    checked = it.misfit > MAX_GOOD_MISFIT and not it.shape_assumed
    return it.misfit if checked and _masks_agree(it) else np.nan


def consistent_mean_iou(it: Evidence) -> float:
    """Return the IOU with masks that agree with each other; NaN if they do not.

    It is NaN, too, where contours are near: then the object is small in the image.
    """
    iou, usual = float(np.nanmean(it.overlaps)), LOWER_MIN_IOU if it.met_less else MIN_GOOD_IOU
    return iou if iou < usual and not it.misfit <= MAX_GOOD_MISFIT and _masks_agree(it) else np.nan


def _masks_agree(it: Evidence) -> bool:
    return difference_correlation(it) > MIN_DIFFERENCE_CORRELATION


def min_iou_ratio(it: Evidence) -> float:
    """Compute the least IOU relative to the median one; single frames do not count."""
    return float(_iou_by_median(it).min(initial=1.0))


def describe_low_iou_frames(it: Evidence) -> str:
    """Name the consecutive frames, around the least IOU, that are met less than the others."""
    by_median = _iou_by_median(it)
    worst, usual = int(by_median.argmin()), np.flatnonzero(by_median >= UNEVEN_IOU_RATIO)
    first = int(usual[usual < worst].max(initial=-1)) + 1
    last = int(usual[usual > worst].min(initial=len(by_median))) - 1
    names = np.array(it.iou_frames or it.clip.frames)[~np.isnan(it.overlaps)]
    some = f"masks from frame {names[first]} to {names[last]}" if first < last else f"masks about frame {names[first]}"
    median = float(np.nanmedian(it.overlaps))
    less = median * float(by_median[first : last + 1].mean())
    least = f"at worst {100.0 * by_median[worst]:.3g} % of the median one, {median:.2f}"
    return f"{some} are met with a mean IOU of {less:.2f}, {least}"


def _iou_by_median(it: Evidence) -> Float[ndarray, "n"]:
    """IOU of each frame with a mask, median of three consecutive frames, relative to the median of all."""
    iou = it.overlaps[~np.isnan(it.overlaps)]
    if len(iou) < 3:
        return np.ones(len(iou))
    padded = np.pad(iou, 1, mode="reflect")  # the first or last frame alone does not count, either
    return np.asarray(np.median([padded[:-2], iou, padded[2:]], axis=0) / max(np.median(iou), 1e-9))


def difference_correlation(it: Evidence) -> float:
    """Correlate the differences between mask and silhouette of consecutive frames, median; 0 without such frames."""
    each = [_mask_difference(it, int(n)) for n in np.flatnonzero(it.mask_area > 0)]
    alike = [_correlate(a, b) for a, b in pairwise(each)]
    return float(np.median(alike)) if alike else 0.0


def _mask_difference(it: Evidence, n: int) -> Float[ndarray, "g g"]:
    """Count mask pixels minus silhouette pixels, outside the ignore mask, in each cell around the mask."""
    silhouette = render_packed(it.posed[n], it.clip.mesh.faces, it.clip.K[n], it.clip.size)
    box = silhouette.box_with(it.shown.frames[n])
    mask, ignored = it.shown.frames[n].part(box), it.ignored.frames[n].part(box)
    rows, columns = np.nonzero(mask ^ (silhouette.part(box) & (mask | ~ignored)))
    half = float(np.max(it.boxes[n, 2:] - it.boxes[n, :2]))
    offsets = zip((columns + box[0], rows + box[1]), it.centroids[n], strict=True)
    across, down = (((at - middle) / half + 1.0) * N_DIFFERENCE_CELLS / 2.0 for at, middle in offsets)
    edges = np.arange(N_DIFFERENCE_CELLS + 1.0)
    return np.histogram2d(down, across, (edges, edges), weights=np.where(mask[rows, columns], 1.0, -1.0))[0]


def _correlate(a: Float[ndarray, "g g"], b: Float[ndarray, "g g"]) -> float:
    """Correlate two differences; 0 where one is zero."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.sum(a * b)) / size if size else 0.0


def object_steps(it: Evidence) -> Float[ndarray, "n"]:
    """Compute the step of the object's surface in the hand between frames, root mean square [diameters]."""
    assert it.T_hand_obj is not None
    surface = se3.transform(it.T_hand_obj, it.scale * surface_points(it.clip.mesh, N_REGRASP_POINTS)[None])
    moved = np.sqrt(np.square(surface[1:] - surface[:-1]).sum(axis=-1).mean(axis=-1))
    return np.asarray(moved / (it.scale * it.clip.mesh.diameter))


def regrasp_jump(it: Evidence) -> float:
    """Compute the largest step minus two usual ones [diameters]; NaN for few frames."""
    if len(it.clip) < MIN_REGRASP_FRAMES:
        return np.nan
    largest = np.sort(object_steps(it))[::-1]
    return max(float(largest[0] - 2.0 * largest[USUAL_STEP_RANK]), 0.0)


def describe_largest_step(it: Evidence) -> str:
    """Name the two frames of the largest step."""
    n = int(np.argmax(object_steps(it)))
    return f"from frame {it.clip.frames[n]} to {it.clip.frames[n + 1]}"
