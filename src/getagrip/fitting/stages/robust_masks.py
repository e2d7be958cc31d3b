"""Outlier masks, which contradict other frames' masks: another object's, incomplete masks, or masks that run over.

A mask is an outlier if it differs far more from the predicted silhouette than most masks do. The clip is fitted again
without the outliers and all masks are compared again, until the outliers stay the same; poses in their frames are
interpolated.

A frame's silhouette is predicted from its neighbours, without its own mask: in a grasp the object moves little in the
hand from frame to frame, and smoothly before the camera. So the silhouette is predicted twice: from the typical pose in
the hand, the medoid of a few neighbours, and from the pose interpolated between the nearest other frames, in the camera
frame. The first is wrong where the hand is wrong, the second where the motion is fast or a neighbour's mask is wrong. A
frame's own pose does not count: deviations from a motion, and the angle about a far axis, may well follow a wrong mask.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.fitting.hand.hand_error_model import interpolate_solved_hand
from getagrip.fitting.motion import (
    Free,
    PosesInHand,
    hand_object_transforms,
    interpolate_object_poses,
    transform_poses,
)
from getagrip.fitting.problem import MethodResult, ObservedView, Problem
from getagrip.geometry import se3
from getagrip.geometry.kernels.silhouette import MIN_SILHOUETTE_DEPTH_M, silhouettes, unpack
from getagrip.io.images import pack_masks

RENDER_BATCH_FRAMES = 64
"""Number of frames that are rendered at once, to limit memory."""
N_NEIGHBOUR_FRAMES = 6
"""Number of frames on either side, beside the frame itself, that determine the typical pose."""
MAX_OUTLIER_FITS = 4
"""Maximum number of fits, the first one with all masks."""
MAX_REFIT_CHANGE = 0.1
"""Share of the masks up to which the next fit without outliers begins at the fit before."""
MIN_OUTLIER_FIT_FRAMES = 4
"""Minimum number of frames that outliers can be determined from."""
OUTLIER_AREA_FRACTION, OUTLIER_MEDIAN_FACTOR = 0.3, 4.0
"""An outlier differs from the predicted silhouette by more than this fraction of the object's silhouette, and by more
than this multiple of the median mask's difference. Chosen on DexYCB's training subjects."""


def fit_without_outliers(
    problem: Problem,
    fit: Callable[[Problem], MethodResult],
    refit: Callable[[Problem, MethodResult, Float[ndarray, "n"]], MethodResult],
) -> tuple[Problem, MethodResult]:
    """Fit the problem without outlier masks; return the problem in the remaining frames, and its fit.

    Where few masks leave or come back, ``refit`` begins at the fit before, given with the indices of the problem's
    frames in that fit's. More of them may have led it astray, so the search is made anew. Raises what ``fit`` raises.
    """
    everywhere = np.arange(len(problem.clip))
    found, some, used, limit, limits = fit(problem), problem, everywhere, np.inf, dict[str, float]()
    for _ in range(MAX_OUTLIER_FITS - 1):
        if len(used) < MIN_OUTLIER_FIT_FRAMES:
            break
        solved = some.as_found(found)
        predicted = NeighbourPrediction.by(solved, found.poses, used)
        T = interpolate_solved_hand(problem.clip.hand.T_cam_hand, solved.clip.hand.T_cam_hand, used)
        whole = replace(problem, clip=problem.clip.with_hand_at(T)) if found.hand else problem
        whole = whole.warped(found.warp)
        met = predicted.overlap(whole, everywhere)
        limit = outlier_threshold(met)
        inliers = np.flatnonzero(met.differing <= limit)
        in_views, limits = view_outliers(whole, predicted, everywhere)
        if np.array_equal(inliers, used) and in_views == some.trust.view_outliers:
            break
        apart = {*in_views} ^ {*some.trust.view_outliers}
        changed, before, used = len(np.setxor1d(inliers, used)) + len(apart), used, inliers
        trust = replace(problem.trust, view_outliers=in_views, view_thresholds=limits)
        some = replace(problem, trust=trust).at(problem.clip.take(used))
        if changed <= MAX_REFIT_CHANGE * len(everywhere) and can_refit(found):
            found = refit(some, found, np.interp(used, before, np.arange(len(before))))
        else:
            found = fit(some)
    names = tuple(name for n, name in enumerate(problem.clip.frames) if n not in used)
    some = some.as_found(found)
    trust = replace(some.trust, outliers=names, outlier_threshold=limit, view_thresholds=limits)
    return replace(some, trust=trust), found


def view_outliers(
    problem: Problem, predicted: NeighbourPrediction, at: Int[ndarray, "n"]
) -> tuple[frozenset[tuple[str, str]], dict[str, float]]:
    """Find the outlier masks of further views in a problem's frames, the clip's frames ``at``.

    Return each as the names of view and frame, and the threshold of each view: the known one, else that of these masks.
    """
    found, limits = set[tuple[str, str]](), dict(problem.trust.view_thresholds)
    for view in problem.views:
        if view.name not in limits and len(view.rows) < MIN_OUTLIER_FIT_FRAMES:
            continue
        met = predicted.overlap(problem, at, view)
        limit = limits.setdefault(view.name, outlier_threshold(met))
        found |= {(view.name, problem.clip.frames[n]) for n in view.rows[met.differing > limit]}
    return frozenset(found), limits


def can_refit(found: MethodResult) -> bool:
    """Return whether a fit can begin at this one: a motion of the input mesh in the input hand."""
    return found.motion is not None and found.energy_of is not None and found.warp is None and found.hand is None


def outlier_threshold(met: MaskOverlap) -> float:
    """Return the outlier threshold: the largest difference of a mask from its predicted silhouette [px]."""
    size = float(np.median(met.silhouette))
    return max(OUTLIER_AREA_FRACTION * size, OUTLIER_MEDIAN_FACTOR * float(np.median(met.differing)))


class MaskOverlap(NamedTuple):
    """Overlap of rendered and observed object mask in each frame, on the full image.

    Attributes:
        both: (T,) number of pixels of both, without ignored ones.
        either: (T,) number of pixels of either, without ignored ones.
        silhouette: (T,) number of pixels of the rendered one, hidden or not.
    """

    both: Float[ndarray, "T"]
    either: Float[ndarray, "T"]
    silhouette: Float[ndarray, "T"]

    @property
    def iou(self) -> Float[ndarray, "T"]:
        """IOU of the two; 0 without a pixel of either."""
        return self.both / np.maximum(self.either, 1.0)

    @property
    def differing(self) -> Float[ndarray, "T"]:
        """Number of pixels of one of the two only."""
        return self.either - self.both


def mask_overlap(clip: Clip, masks: Masks, T_hand_obj: Float[ndarray, "T 4 4"], scale: float) -> MaskOverlap:
    """Compute the overlap of the posed object with the masks."""
    T_cam_obj = clip.hand.T_cam_hand @ T_hand_obj
    K = np.stack([clip.K[:, 0, 0], clip.K[:, 1, 1], clip.K[:, 0, 2], clip.K[:, 1, 2]], axis=1)
    R, t = np.ascontiguousarray(T_cam_obj[:, :3, :3]), np.ascontiguousarray(T_cam_obj[:, :3, 3])
    tables = SilhouetteMesh.of(clip.mesh, np.zeros(3)).tables
    observed, ignored = pack_masks(masks.object), pack_masks(masks.ignore)
    both, either, silhouette = np.empty(len(clip)), np.empty(len(clip)), np.empty(len(clip))
    for first in range(0, len(clip), RENDER_BATCH_FRAMES):
        some = slice(first, first + RENDER_BATCH_FRAMES)
        corner, shape = _covered_words(se3.transform(T_cam_obj[some], scale * clip.mesh.vertices), K[some], clip.size)
        drawn = np.empty((len(corner), *shape), np.uint64)
        silhouettes(R[some], t[some], np.full(len(drawn), scale), *tables, K[some], drawn, corner)
        for n, ((row, word), bits) in enumerate(zip(corner.tolist(), drawn, strict=True), start=first):
            box = 64 * word, row, min(64 * (word + shape[1]), clip.size[0]), min(row + shape[0], clip.size[1])
            rendered = unpack(bits[: box[3] - row], box[2] - box[0])
            silhouette[n] = np.count_nonzero(rendered)
            shown = observed.frames[n].part(box)
            rendered &= shown | ~ignored.frames[n].part(box)
            both[n] = np.count_nonzero(rendered & shown)
            either[n] = np.count_nonzero(rendered) + observed.frames[n].area - both[n]
    return MaskOverlap(both, either, silhouette)


def _covered_words(
    X_cam: Float[ndarray, "T V 3"], K: Float[ndarray, "T 4"], size: tuple[int, int]
) -> tuple[Int[ndarray, "T 2"], tuple[int, int]]:
    """Return the first row and word of 64 pixels that an object may cover in each frame, and the largest extent."""
    uv = X_cam[..., :2] / np.maximum(X_cam[..., 2:], MIN_SILHOUETTE_DEPTH_M) * K[:, None, :2] + K[:, None, 2:]
    low, high = np.clip([uv.min(axis=1) - 1.0, uv.max(axis=1) + 1.0], 0.0, size)[..., ::-1]  # 1: more than rounding
    most = np.array([size[1], -(-size[0] // 64)])
    first = np.minimum(np.floor(low / [1, 64]).astype(np.int64), most - 1)
    extent = np.ceil(high / [1, 64]).astype(np.int64) - first
    return first, tuple(np.clip(extent.max(axis=0), 1, most).tolist())


def image_iou(clip: Clip, masks: Masks, T_hand_obj: Float[ndarray, "T 4 4"], scale: float) -> Float[ndarray, "T"]:
    """Compute the IOU of rendered and observed object mask on the full image, outside ignored pixels."""
    return mask_overlap(clip, masks, T_hand_obj, scale).iou


@dataclass(frozen=True)
class NeighbourPrediction:
    """A prediction of each frame's pose from its neighbours' poses.

    Attributes:
        typical: (1, n) the typical pose in the hand of each frame and its neighbours.
        in_camera: (1, n) the poses of the frames, in the camera frame.
        at: (n,) indices of the frames in their clip, at least 3.
    """

    typical: PosesInHand
    in_camera: PosesInHand
    at: Int[ndarray, "n"]

    @staticmethod
    def by(problem: Problem, poses: PosesInHand, at: Int[ndarray, "n"]) -> NeighbourPrediction:
        """Predict from the best of the poses in a problem's frames, which are the clip's frames ``at``."""
        best = poses.take(np.zeros(1, dtype=int))
        return NeighbourPrediction(
            medoid_poses(best, problem.surface.points), transform_poses(best, problem.clip.hand.T_cam_hand), at
        )

    def overlap(self, problem: Problem, at: Int[ndarray, "m"], view: ObservedView | None = None) -> MaskOverlap:
        """Compare the masks of a problem's frames, the clip's frames ``at``, with the better predicted silhouettes.

        With a further view, its masks are compared, in the frames that it shows.
        """
        clip, centre, scale = problem.clip, problem.clip.mesh.centre, float(self.typical.scale[0])
        in_hand = interpolate_object_poses(self.typical, self.at, at)
        between = transform_poses(self.between(at), se3.inverse(clip.hand.T_cam_hand))
        rows = np.arange(len(clip)) if view is None else view.rows
        seen, masks = (clip, problem.masks) if view is None else (view.clip(clip), view.masks)
        one, two = (
            mask_overlap(seen, masks, hand_object_transforms(poses, centre)[0][rows], scale)
            for poses in (in_hand, between)
        )
        first = one.differing <= two.differing
        return MaskOverlap(*(np.where(first, x, y) for x, y in zip(one, two, strict=True)))

    def between(self, at: Int[ndarray, "m"]) -> PosesInHand:
        """Interpolate each frame's pose in the camera between the nearest other frames; extrapolate at the ends."""
        place = np.searchsorted(self.at, at)
        known = np.append(self.at, -1)[place] == at  # such a frame itself does not count
        before = np.clip(place - 1, 0, len(self.at) - 2 - known)
        after = before + 1
        before, after = (n + (known & (n >= place)) for n in (before, after))
        share = (at - self.at[before]) / (self.at[after] - self.at[before])
        free = Free(self.in_camera.R, self.in_camera.centre, np.log(self.in_camera.scale)).mixed(before, after, share)
        return PosesInHand(free.R, free.centre, self.in_camera.scale)


def medoid_poses(poses: PosesInHand, points: Float[ndarray, "P 3"]) -> PosesInHand:
    """Choose for each frame of one hypothesis the medoid of its pose and its neighbours' poses."""
    x = float(poses.scale[0]) * points @ np.swapaxes(poses.R[0], -1, -2) + poses.centre[0, :, None]
    N, steps = len(x), np.arange(-N_NEIGHBOUR_FRAMES, N_NEIGHBOUR_FRAMES + 1)
    apart = np.zeros((2 * N_NEIGHBOUR_FRAMES + 1, N))  # of each frame, to the frame this number of steps later
    for step in range(1, min(len(apart), N)):
        apart[step, :-step] = np.sqrt(np.mean(np.sum((x[step:] - x[:-step]) ** 2, axis=-1), axis=-1))
    near = np.arange(N)[:, None] + steps
    outside = (near < 0) | (near >= N)
    one, other = np.broadcast_arrays(np.clip(near, 0, N - 1)[:, :, None], np.clip(near, 0, N - 1)[:, None])
    between = np.where(outside[:, None], 0.0, apart[np.abs(one - other), np.minimum(one, other)])
    chosen = near[np.arange(N), np.where(outside, np.inf, between.sum(axis=-1)).argmin(axis=1)]
    return PosesInHand(poses.R[:, chosen], poses.centre[:, chosen], poses.scale)
