"""Views of results and clips in folders, also of several results of one clip at their common frames.

Single frames as pictures, for films and pages: over the image, and from the side.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.clip import Clip, read_clip
from getagrip.clip.views import find_cameras
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import Crops
from getagrip.metrics.evaluate import read_result_clip_masks
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    HAND_LINE_COLOUR,
    HIDDEN_AXIS_COLOUR,
    RESULT_COLOUR,
    crop_image,
    input_windows,
    render_posed,
    silhouette_lines,
    window_intrinsics,
)
from getagrip.report.pictures.result_view import View
from getagrip.result import Axis, Reconstruction
from getagrip.stable_grasps.axis import pose_hinge
from getagrip.stable_grasps.study import object_in_hand


@dataclass(frozen=True)
class StoredResult:
    """The folder of a result or a clip; ``clips`` holds the result's clip (None: the clip that the result names)."""

    folder: Path
    clips: Path | None = None

    def read(self) -> View:
        """Read the result with its clip and masks, or the ground truth of a clip. Raises ``InputError``."""
        if is_clip(self.folder):
            return ground_truth_view(self.folder)
        result, clip, masks = read_result_clip_masks(self.folder, self.clips)
        return View.of(result, clip, masks)


def is_clip(folder: Path) -> bool:
    """Return whether a folder is a clip's."""
    return (folder / "clip.json").exists()


def ground_truth_view(folder: Path) -> View:
    """Return all frames of a clip with the true poses of hand and object, as in the paper's Figs. 2 and 3.

    The axis is the hinge of least error (``pose_hinge``), as in the study. Raises ``InputError`` without ground truth.
    """
    clip = read_clip(folder).light()
    truth = clip.truth
    if truth is None:
        raise InputError(folder / "truth.npz", "", "no such file", "the true poses, or a result instead of a clip")
    R, centre, size = object_in_hand(clip)
    hinge = pose_hinge(R, centre, size)
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    axis = Axis(hinge.point, hinge.direction, np.unwrap(hinge.angles(R, centre)))
    motion = replace(Reconstruction.external(clip.name, "one-dof", clip.frames, T_hand_obj, truth.scale), axis=axis)
    hand = replace(clip.hand, vertices=truth.hand_vertices, T_cam_hand=truth.T_cam_hand)
    true = replace(clip, hand=hand, scale="known")
    return View(true, None, motion, of_truth=True, cameras=find_cameras(true))


def hand_only_view(clip: Clip) -> View:
    """Return the view of a clip without poses of the object."""
    still = np.tile(np.eye(4), (len(clip), 1, 1))
    nothing = Reconstruction.external(clip.name, "", clip.frames, still)
    return View(clip.light(), None, nothing, posed=False, cameras=find_cameras(clip))


def at_common_frames(results: Sequence[tuple[StoredResult, View]]) -> list[View]:
    """Return the views at their common frames. Raises ``InputError`` for results of several clips or without any."""
    first, one = results[0]
    for value, view in results[1:]:
        if view.clip.name != one.clip.name:
            expected = f"{one.clip.name!r}, as of {first.folder}: results of one clip"
            raise InputError(value.folder / "result.json", "clip", repr(view.clip.name), expected)
        if view.clip.size != one.clip.size:
            width, height = one.clip.size
            raise InputError(view.clip.origin / "clip.json", "size", f"{view.clip.size}", f"{width} x {height}")
    common = reduce(set.intersection, (set(view.result.frames) for _, view in results))
    if not common:
        of = " and ".join(str(value.folder) for value, _ in results[1:])
        raise InputError(of, "frames", f"none of those of {first.folder}", "results that share frames")
    names = [name for name in one.result.frames if name in common]
    return [view.at(names) for _, view in results]


def distinct_path_parts(results: Sequence[StoredResult]) -> list[str]:
    """Return the parts in which the results' paths differ, without the common beginning and end."""
    paths = [value.folder.resolve().parts for value in results]
    if len(paths) == 1:
        return [paths[0][-1]]
    begin = _common_prefix_length(paths)
    end = min(_common_prefix_length([path[::-1] for path in paths]), *(len(path) - begin - 1 for path in paths))
    return ["/".join(path[begin : len(path) - end]) for path in paths]


def _common_prefix_length(paths: Sequence[Sequence[str]]) -> int:
    alike = (len(set(parts)) == 1 for parts in zip(*paths, strict=False))
    return next((n for n, same in enumerate(alike) if not same), min(map(len, paths)))


WINDOW_SMOOTHING_S = 0.35
"""Standard deviation in time of the smoothing of windows [s]."""
WINDOW_MARGIN_FACTOR = 1.12
"""Size of smoothed windows, which lag behind, relative to windows of single frames."""
SUBPIXEL_BITS = 3
"""Fractional bits of the coordinates that OpenCV draws at."""


def smooth_windows(view: View, size: int) -> Crops:
    """Return square windows of one size around hand and masks, one a frame, that move smoothly."""
    crops = input_windows([view], np.arange(len(view.result.frames)), size)
    middle = crops.corner + crops.side / 2.0
    smooth = smooth_track(middle, WINDOW_SMOOTHING_S * view.clip.fps)
    side = max(WINDOW_MARGIN_FACTOR * crops.side, float(crops.side + 2.0 * np.abs(smooth - middle).max()))
    return replace(crops, corner=smooth - side / 2.0, side=side)


def smooth_track(track: Float[ndarray, "T k"], over: float) -> Float[ndarray, "T k"]:
    """Smooth a track by a Gaussian with a standard deviation of ``over`` frames; ends are repeated."""
    reach = int(4.0 * over + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / over) ** 2)
    padded = np.pad(track, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weight / weight.sum(), mode="valid") for column in padded.T], axis=1)


def draw_overlay(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Draw frame ``n`` in window ``k``, with the contours of hand and object."""
    picture, K = crop_image(view, n, crops, k), window_intrinsics(view, n, crops, k)
    for hand in view.hands(n):
        _draw_polylines(picture, silhouette_lines(*hand, K, crops.size), HAND_LINE_COLOUR, crops.size / 400.0)
    found = silhouette_lines(view.object(n), view.clip.mesh.faces, K, crops.size)
    _draw_polylines(picture, found, RESULT_COLOUR, max(1.5, crops.size / 320.0))
    return picture


def draw_side_view(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Draw hand, object and axis of frame ``n``, from the side."""
    picture, line = render_posed(view, n, crops, k, from_side=True)
    if line is not None:
        uv, visible = line
        hidden = _contiguous_parts(uv, ~visible)
        _draw_polylines(picture, hidden, HIDDEN_AXIS_COLOUR, crops.size / 480.0, closed=False, halo=False)
        _draw_polylines(picture, _contiguous_parts(uv, visible), AXIS_COLOUR, crops.size / 320.0, closed=False)
    return picture


def _contiguous_parts(uv: Float[ndarray, "n 2"], chosen: Bool[ndarray, "n"]) -> list[Float[ndarray, "_n 2"]]:
    """Split a line into its runs of chosen points."""
    ends = np.flatnonzero(np.diff(chosen.astype(int))) + 1
    parts = zip(np.split(uv, ends), np.split(chosen, ends), strict=True)
    return [part for part, is_chosen in parts if len(part) and is_chosen[0]]


def _draw_polylines(
    picture: UInt8[ndarray, "H W 3"],
    lines: Iterable[Float[ndarray, "_n 2"]],
    colour: str,
    width: float,
    closed: bool = True,
    halo: bool = True,
) -> None:
    rgb = tuple(bytes.fromhex(colour[1:]))
    # OpenCV's origin is the centre of the first pixel
    points = [np.round((line - 0.5) * 2**SUBPIXEL_BITS).astype(np.int32)[:, None] for line in lines]
    for drawn, thick in (((255, 255, 255), 2.8 * width), (rgb, 1.3 * width))[not halo :]:
        cv2.polylines(picture, points, closed, drawn, max(1, round(thick)), cv2.LINE_AA, SUBPIXEL_BITS)
