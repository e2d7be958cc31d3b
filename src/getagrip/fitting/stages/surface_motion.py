"""Surface motion: how a body of revolution turns about its own axis from frame to frame, which no mask shows.

Otherwise that angle follows the hand. Corners inside the object's visible mask are tracked to the next image and back,
and placed on the posed surface. The distances between the ends of the tracks and the same places of the next pose are
explained by a turn about the axis, under a prior on the poses' own errors: tilts, shifts and distance. Nothing is
measured between frames with few tracks, or tracks that contradict each other: of plain, glossy or blurred surfaces. The
angles that explain the measured turns best replace those of the poses, drawn to the hand's own, which bounds their
drift. Silhouettes stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Num, UInt8
from numpy import ndarray
from scipy.linalg import solveh_banded

from getagrip.clip import Clip, masks_in_memory
from getagrip.clip.masks import read_available_masks
from getagrip.errors import InputError
from getagrip.fitting.evidence.texture import TEXTURE_KEY, FrameImages, Texture
from getagrip.fitting.problem import ObjectSurface, Problem
from getagrip.fitting.stages.remaining_frames import SolutionTrack
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.rasterize import depth_and_face
from getagrip.io.images import read_image
from getagrip.provenance import kind_of_hands

SURFACE_MOTION = "surface-motion"
"""Name among the evidence beside the masks, by which options leave it out."""
MAX_SIDE_PX, MARGIN_PX = 240, 6
"""Longest side of the images in which corners are tracked, and margin about the object's mask [px]."""
MAX_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX, CORNER_BLOCK_PX = 80, 0.02, 4.0, 5
"""Number of corners, their least quality relative to the best, distance from each other and size [px]."""
MIN_CORNER_STRENGTH = 1e-4
"""Least eigenvalue of a corner by OpenCV. Prints on cans are above; noise, highlights, and rings that these cross,
which do not move with the surface, are mostly below, and so are painted shapes of few colours."""
INSIDE_PX, FINE_PX = 5, 1.0
"""Distance of a corner from the mask's edge, and standard deviation of the smoothing of noise [px]."""
WINDOW_PX, PYRAMID_LEVELS, MAX_RETURN_PX = 13, 2, 0.5
"""Window and coarser levels of the tracking, and how far from its start a corner may return [px]."""
TRACK_SIGMA_PX, INLIER_PX = 0.7, 1.5
"""Standard deviation of a track, and the most that may remain unexplained of one that agrees with the others [px]."""
TURN_SIGMA, TILT_SIGMA, SHIFT_SIGMA_PX, DISTANCE_SIGMA = np.radians(6.0), np.radians(2.0), 3.0, 0.02
"""Prior standard deviations, of the turn between frames, and of the poses' errors: tilts [rad], shifts across the ray,
and relative distance."""
MIN_TRACKS, MIN_INLIER_SHARE, MAX_TURN_SIGMA = 12, 0.6, np.radians(2.0)
"""Least number of tracks that agree and their share, and greatest standard deviation [rad], of a turn that counts."""
SHAPE_SIGMA = np.radians(0.5)
"""Standard deviation of a turn by the errors that all tracks share, as of the surface [rad]."""
MIN_TURNS, MIN_TURN_SHARE = 4, 0.5
"""Least number of measured turns, and their share among neighbouring frames, by which poses are turned."""
HAND_TURN_SIGMA, HAND_ANGLE_SIGMA = np.radians(4.0), np.radians(20.0)
"""Standard deviations of an estimated hand's rotation about the axis, between frames and in each frame [rad]."""
N_ROBUST_STEPS = 6
SURFACE_MOTION_NOTE = "turned about its own axis as its surface moves in the images, by up to {:.0f} degrees"
"""The note of a result whose poses were turned."""

Turn = tuple[float, float]
"""A turn about the axis between two frames and its standard deviation [rad]."""


@dataclass(frozen=True)
class _Seen:
    """The object in an image: grey levels, visible pixels, their box (left, top, right, bottom), the frame's camera."""

    grey: UInt8[ndarray, "H W"]
    mask: Bool[ndarray, "H W"]
    box: Num[ndarray, "4"]
    K: Float[ndarray, "3 3"]


@dataclass(frozen=True)
class _Cut:
    """A square part of an image about the object, shrunk; pixels beyond the image are 0."""

    grey: UInt8[ndarray, "s s"]
    mask: UInt8[ndarray, "s s"]
    K: Float[ndarray, "3 3"]


def turn_with_surface(
    clip: Clip, problem: Problem, track: SolutionTrack, scale: float
) -> tuple[SolutionTrack, tuple[str, ...]]:
    """Turn the best poses about the object's own axis as its surface moves in the images, and say so in a note.

    ``clip`` has the frames of ``track``, and the mesh as it was fitted. Unchanged are poses of an object that is no
    body of revolution, in a measured hand, without images of most frames, or whose surface shows too little.
    """
    axis = problem.surface.axis_of_revolution
    unused = SURFACE_MOTION in problem.options.without or kind_of_hands(clip.provenance) == "measured"
    images = None if unused or axis is None else _images_of(clip)
    if axis is None or images is None:
        return track, ()
    T_cam_obj = track.T_cam_hand @ track.T_hand_obj[0]
    turns = list[Turn | None]()
    for n, (a, b) in enumerate(pairwise(_seen_frames(clip, images))):
        seen = None if a is None or b is None else _cut_out(a, b)
        turns.append(seen and _turn_between(problem.surface, scale, axis, *seen, T_cam_obj[n], T_cam_obj[n + 1]))
    measured = np.array([turn is not None for turn in turns])
    if np.count_nonzero(measured) < MIN_TURNS or measured.mean() < MIN_TURN_SHARE:
        return track, ()
    added = _added_angles(_turns_about(axis, T_cam_obj[:, :3, :3]), turns)
    about = se3.rotation_about_line(scale * clip.mesh.centre, axis, added)
    turned = np.concatenate([track.T_hand_obj[:1] @ about, track.T_hand_obj[1:]])
    return replace(track, T_hand_obj=turned), (SURFACE_MOTION_NOTE.format(np.degrees(np.abs(added).max())),)


def _images_of(clip: Clip) -> FrameImages | None:
    """Return the files of a clip's images; None where they are no evidence."""
    images = clip.evidence[TEXTURE_KEY] if TEXTURE_KEY in clip.evidence else Texture().read(clip)
    return images if isinstance(images, FrameImages) else None


def _seen_frames(clip: Clip, images: FrameImages) -> Iterator[_Seen | None]:
    """Read image and mask of each frame, one after the other; None of a frame that does not show the object."""
    for n, path in enumerate(images.paths):
        frame = clip.take(np.array([n]))
        masks = masks_in_memory(frame)
        masks = read_available_masks(frame) if masks is None else masks
        if path is None or masks is None:
            yield None
            continue
        mask = masks.object[0] & ~masks.ignore[0]
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        try:
            grey = cv2.cvtColor(read_image(path, clip.size), cv2.COLOR_RGB2GRAY) if len(rows) else None
        except InputError:  # a pose needs no images
            grey = None
        box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1] if len(rows) else [0, 0, 0, 0])
        yield None if grey is None else _Seen(grey, mask, box, clip.K[n])


def _cut_out(here: _Seen, there: _Seen) -> tuple[_Cut, _Cut]:
    """Cut the object out of two images, in squares of one size."""
    side = int(max((seen.box[2:] - seen.box[:2]).max() for seen in (here, there))) + 2 * MARGIN_PX
    size = min(side, MAX_SIDE_PX)

    def cut(seen: _Seen) -> _Cut:
        left, top = ((seen.box[:2] + seen.box[2:] - side) // 2).tolist()
        height, width = seen.mask.shape
        columns, rows = slice(max(left, 0), min(left + side, width)), slice(max(top, 0), min(top + side, height))
        at = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
        grey, mask = np.zeros((2, side, side), np.uint8)
        grey[at], mask[at] = seen.grey[rows, columns], seen.mask[rows, columns]
        K = seen.K.copy()
        K[:2, 2] -= left, top
        K[:2] *= size / side
        small, shown = (cv2.resize(each, (size, size), interpolation=cv2.INTER_AREA) for each in (grey, mask))
        return _Cut(np.asarray(cv2.GaussianBlur(small, (0, 0), FINE_PX), np.uint8), np.asarray(shown, np.uint8), K)

    return cut(here), cut(there)


def _turns_about(axis: Float[ndarray, "3"], R: Float[ndarray, "T 3 3"]) -> Float[ndarray, "n"]:
    """Return the turns about an axis of the object from each rotation to the next [rad]."""
    q = se3.quaternion(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    return np.asarray(2.0 * np.arctan2(q[:, 1:] @ axis, q[:, 0]))


def _turn_between(
    surface: ObjectSurface,
    scale: float,
    axis: Float[ndarray, "3"],
    here: _Cut,
    there: _Cut,
    T_here: Float[ndarray, "4 4"],
    T_there: Float[ndarray, "4 4"],
) -> Turn | None:
    """Measure the turn about the axis between two frames; None where too little is seen of it."""
    inside = cv2.erode(here.mask, np.ones((2 * INSIDE_PX + 1,) * 2, np.uint8), borderValue=0)
    inside = np.where(cv2.cornerMinEigenVal(here.grey, CORNER_BLOCK_PX) > MIN_CORNER_STRENGTH, inside, 0)
    corners = cv2.goodFeaturesToTrack(
        here.grey, MAX_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX, mask=inside, blockSize=CORNER_BLOCK_PX
    )
    if corners is None or len(corners) < MIN_TRACKS:
        return None
    posed = se3.transform(T_here, scale * surface.coarse.vertices)
    depth = depth_and_face(posed, surface.coarse.faces, here.K, here.grey.shape[::-1])[0]
    column, row = corners[:, 0].astype(int).T
    on_surface = np.isfinite(depth[row, column])
    first, z = corners[on_surface], depth[row, column][on_surface]
    ray = np.column_stack([first[:, 0] + 0.5, np.ones(len(first))]) @ np.linalg.inv(here.K).T
    centre = scale * surface.mesh.centre
    place = se3.transform(se3.inverse(T_here), z[:, None] * ray) - centre
    # The next pose, as if the object had not turned about its axis: the tracking starts at its places.
    turn = _turns_about(axis, np.stack([T_here[:3, :3], T_there[:3, :3]]))[0]
    R, middle = T_there[:3, :3] @ se3.exp_so3(-turn * axis), se3.transform(T_there, centre[None])[0]
    arm = place @ R.T
    start = project(there.K, middle + arm) - 0.5  # OpenCV's pixels have their centres at whole coordinates
    last = _track(here.grey, there.grey, first, start, there.mask)
    kept = np.isfinite(last[:, 0])
    if np.count_nonzero(kept) < MIN_TRACKS:
        return None
    return _explain((last - start)[kept], arm[kept], middle, R @ axis, there.K)


def _track(
    here: UInt8[ndarray, "s s"],
    there: UInt8[ndarray, "s s"],
    first: Float32[ndarray, "n 1 2"],
    start: Float[ndarray, "n 2"],
    mask: UInt8[ndarray, "s s"],
) -> Float[ndarray, "n 2"]:
    """Track corners into the next image; NaN for one that leaves the mask, or does not return."""
    if not len(first):
        return np.empty((0, 2))
    guess = start.astype(np.float32)[:, None]
    window, criteria = (WINDOW_PX, WINDOW_PX), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
    settings = window, PYRAMID_LEVELS, criteria, cv2.OPTFLOW_USE_INITIAL_FLOW
    last, found, _ = cv2.calcOpticalFlowPyrLK(here, there, first, guess.copy(), None, None, *settings)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(there, here, last, last + first - guess, None, None, *settings)
    column, row = np.clip(np.nan_to_num(last[:, 0]) + 0.5, 0, len(mask) - 1).astype(int).T
    lost = np.linalg.norm(back - first, axis=2)[:, 0] >= MAX_RETURN_PX
    lost |= (found[:, 0] == 0) | (returned[:, 0] == 0) | (mask[row, column] == 0)
    return np.where(lost[:, None], np.nan, last[:, 0].astype(float))


def _explain(
    off: Float[ndarray, "n 2"],
    arm: Float[ndarray, "n 3"],
    middle: Float[ndarray, "3"],
    axis: Float[ndarray, "3"],
    K: Float[ndarray, "3 3"],
) -> Turn | None:
    """Explain how far tracks end off the places of a pose; None where they contradict each other or tell little.

    ``arm`` are these places from the object's middle, all in the camera frame [m].
    """
    at = middle + arm
    by_point = np.zeros((len(at), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0 / at[:, 2]
    by_point[:, :, 2] = -at[:, :2] / at[:, 2:] ** 2
    across, shift = (np.linalg.svd(one[None])[2][1:] for one in (axis, middle))  # what is orthogonal to each
    pixel = SHIFT_SIGMA_PX * middle[2] / K[0, 0]
    moves = [TURN_SIGMA * np.cross(axis, arm), *(TILT_SIGMA * np.cross(w, arm) for w in across)]
    moves += [np.broadcast_to(w, arm.shape) for w in (*(pixel * shift), DISTANCE_SIGMA * middle)]
    A = np.einsum("ab,nbc,knc->nak", K[:2, :2], by_point, np.array(moves)).reshape(-1, 6)
    x, H = np.zeros(6), np.eye(6)
    for _ in range(N_ROBUST_STEPS):
        left = np.linalg.norm(off - (A @ x).reshape(-1, 2), axis=1)
        weight = np.repeat(1.0 / np.maximum(1.0, left / (2.0 * TRACK_SIGMA_PX)), 2) / TRACK_SIGMA_PX**2
        H = (A.T * weight) @ A + np.eye(6)
        x = np.linalg.solve(H, A.T @ (weight * off.ravel()))
    left = np.linalg.norm(off - (A @ x).reshape(-1, 2), axis=1)
    agree = left < INLIER_PX
    sigma = TURN_SIGMA * np.sqrt(np.linalg.inv(H)[0, 0]) * max(1.0, np.median(left) / TRACK_SIGMA_PX)
    if np.count_nonzero(agree) < MIN_TRACKS or agree.mean() < MIN_INLIER_SHARE or sigma > MAX_TURN_SIGMA:
        return None
    return float(TURN_SIGMA * x[0]), float(np.hypot(sigma, SHAPE_SIGMA))


def _added_angles(own: Float[ndarray, "n"], turns: list[Turn | None]) -> Float[ndarray, "T"]:
    """Compute what to add to each frame's angle, from the poses' own turns and the measured ones [rad]."""
    more = [
        (0.0, HAND_TURN_SIGMA) if turn is None else (turn[0] - n, turn[1]) for n, turn in zip(own, turns, strict=True)
    ]
    change, sigma = np.array(more).T
    change, weight = np.angle(np.exp(1j * change)), sigma**-2
    bands, right = np.zeros((2, len(own) + 1)), np.zeros(len(own) + 1)
    bands[0, 1:], bands[1] = -weight, HAND_ANGLE_SIGMA**-2
    bands[1, :-1] += weight
    bands[1, 1:] += weight
    right[:-1] -= weight * change
    right[1:] += weight * change
    return np.asarray(solveh_banded(bands, right))
