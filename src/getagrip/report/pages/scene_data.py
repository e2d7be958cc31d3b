"""Data of a page's views: images with contours as SVG paths, and the arrays of the 3D view."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.geometry.camera import Crops, backproject
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import Surface
from getagrip.report.pictures.contact_colours import CONTACT_BORDER_M, surface_distances
from getagrip.report.pictures.panels import (
    axis_points,
    crop_image,
    mask_contours,
    silhouette_lines,
    window_intrinsics,
)
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import smooth_track

FRAME_PICTURE_PX, VIEW_PICTURE_PX, FRAME_JPEG_QUALITY = 480, 320, 78
"""Side of the clip's images and of those of further views [px], and JPEG quality."""
DEFAULT_CONTACT_DISTANCE_M, MAX_CONTACT_SLIDER_M = 0.010, 0.020
"""Contact distance that a page opens with, and the largest that can be chosen [m]."""
MAX_EXACT_DISTANCE_M = MAX_CONTACT_SLIDER_M + CONTACT_BORDER_M
"""Distance up to which distances are exact: contact fades over ``CONTACT_BORDER_M`` around the chosen one [m]."""
FOCUS_SMOOTHING_S = 0.35
"""Standard deviation in time of the smoothing of the point that the 3D view looks at [s]."""


def draw_page_frame(
    view: View, n: int, crops: Crops, k: int, others: Sequence[View] = (), iou: float | None = None
) -> dict[str, object]:
    """Draw frame ``n`` in window ``k``: the image, and the contours of object, hands, ground truth and mask.

    Also the object's contour by each of the ``others``, and in words the ``iou``, if known. ``place`` is where the
    image lies in the window, left, top, width, height [px]; the rest is the page's own ground.
    """
    outlines = {"hand": _surfaces_outline(view.hands(n), view, n, crops, k)}
    if view.posed:
        outlines["object"] = _object_outline(view, n, crops, k)
    if not view.of_truth and (true := view.true()) is not None:
        outlines["true"] = _object_outline(true, n, crops, k)
    if view.masks is not None:
        lines = mask_contours(view.masks.object[n])
        outlines["observed"] = svg_paths((line - crops.corner[k]) * crops.zoom for line in lines)
    ends = np.array([-crops.corner[k], np.array(view.clip.size) - crops.corner[k]]) * crops.zoom
    (left, top), (right, bottom) = np.clip(ends.round(), 0, crops.size).astype(int).tolist()
    picture = crop_image(view, n, crops, k)[top:bottom, left:right]
    shown = jpeg_base64(picture, FRAME_JPEG_QUALITY) if picture.size else ""
    out: dict[str, object] = {"picture": shown, "place": [left, top, right - left, bottom - top]}
    if others:
        out["others"] = [_object_outline(other, n, crops, k) for other in others]
    if iou is not None:
        out["met"] = "no mask" if np.isnan(iou) else f"IOU {100 * iou:.0f} %"
    return {**out, "outlines": outlines}


def _object_outline(view: View, n: int, crops: Crops, k: int) -> str:
    return _surfaces_outline([(view.object(n), view.clip.mesh.faces)], view, n, crops, k)


def _surfaces_outline(surfaces: Iterable[Surface], view: View, n: int, crops: Crops, k: int) -> str:
    K = window_intrinsics(view, n, crops, k)
    return "".join(svg_paths(silhouette_lines(*surface, K, crops.size)) for surface in surfaces)


def jpeg_base64(picture: UInt8[ndarray, "H W 3"], quality: int) -> str:
    """Encode an RGB picture as JPEG, in base64."""
    done, content = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise GetagripError(f"a picture of {picture.shape[1]}x{picture.shape[0]} px could not be written as JPEG")
    return base64.b64encode(content.tobytes()).decode("ascii")


def svg_paths(lines: Iterable[Float[ndarray, "_n 2"]]) -> str:
    """Write closed lines as SVG paths, without points that hardly change them."""
    out = []
    for line in lines:
        kept = cv2.approxPolyDP(line.astype(np.float32)[:, None], 0.3, closed=True)[:, 0]
        out.append("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in kept) + "Z")
    return "".join(out)


def constant_arrays(candidates: Sequence[View], surface: Mesh) -> dict[str, ndarray]:
    """Return the arrays that do not depend on the frames a page loads, as ``parts/viewer.js`` reads them.

    ``candidates`` are a result's ``candidate_views``: ``scale``, ``T_hand_obj`` and ``axis`` have an entry for each.
    Metres; poses are 4x4 matrices of all frames. ``object_vertices`` are unscaled. ``other_hand_known`` is 1
    in the frames of the other hand. ``focus`` is the point to look at, in each camera frame; ``extent`` the approximate
    diameter of hands and object together. ``T_cam_views`` has the poses of the further cameras in each frame,
    ``camera_corners`` the corners of the images at a distance of 1, first of the clip's own camera. ``ground_height``
    is that of the ground along ``world_up``, where known.
    """
    view = candidates[0]
    clip, result = view.clip, view.result
    hands = [np.mean([vertices.mean(axis=0) for vertices, _ in view.hands(n)], axis=0) for n in range(len(clip))]
    middles = [
        (hand + _bounding_box_centre(view.object(n))) / 2.0 if view.posed else hand for n, hand in enumerate(hands)
    ]
    out: dict[str, ndarray] = {
        "hand_faces": clip.hand.faces,
        "T_cam_hand": clip.hand.T_cam_hand,
        "T_hand_obj": result.candidates.T_hand_obj,
        "scale": result.candidates.scale,
        "focus": smooth_track(np.array(middles), FOCUS_SMOOTHING_S * clip.fps),
        "extent": np.array([_scene_extent(view)]),
    }
    if view.posed:
        out |= {"object_vertices": surface.vertices, "object_faces": surface.faces}
        if surface.colours is not None:
            out["object_colours"] = surface.colours
    if (other := clip.other_hand) is not None:
        out |= {"other_hand_faces": other.track.faces, "other_hand_known": other.known}
        out["T_cam_other_hand"] = other.track.T_cam_hand
    if result.axis is not None:
        out["axis"] = np.stack([_axis_endpoints(one) for one in candidates])
    if view.cameras:
        out["T_cam_views"] = np.stack([camera.T_cam_view for camera in view.cameras], axis=1)
        shown = [(clip.K[0], clip.size), *((camera.K[0], camera.size) for camera in view.cameras)]
        out["camera_corners"] = np.stack([backproject(K, _corners(size)) for K, size in shown])
    if clip.world is not None:
        out["T_world_cam"] = clip.world.T_world_cam
        if clip.world.up is not None:
            out["world_up"] = clip.world.up
        if view.posed and (height := view.ground_height()) is not None:
            out["ground_height"] = np.array([height])
    if clip.truth is not None and not view.of_truth:
        out |= {"true_T_cam_obj": clip.truth.T_cam_obj, "true_scale": np.array([clip.truth.scale])}
        out["true_T_cam_hand"] = clip.truth.T_cam_hand
    return {name: _compact_dtype(name, values) for name, values in out.items()}


def per_frame_arrays(view: View, surface: Mesh) -> dict[str, ndarray]:
    """Return arrays with an entry for each frame: hands in their own frames, and the closeness of the surfaces.

    ``object_near``, ``hand_near`` and ``other_hand_near`` range from 0, at ``MAX_EXACT_DISTANCE_M`` or farther, to 1,
    touching or inside.
    """
    hand, other, truth = view.clip.hand, view.clip.other_hand, view.clip.truth
    out: dict[str, ndarray] = {"hand_vertices": hand.vertices}
    if view.posed:
        on_object, out["hand_near"] = _closeness(view, surface)
        if other is not None:
            out["other_hand_near"] = np.zeros(other.track.vertices.shape[:2])
            if (seen := view.by_other_hand()) is not None:
                by_other, out["other_hand_near"][other.known] = _closeness(seen, surface)
                on_object[other.known] = np.maximum(on_object[other.known], by_other)
        out["object_near"] = on_object
    if other is not None:
        out["other_hand_vertices"] = other.track.vertices
    if truth is not None and not np.array_equal(truth.hand_vertices, hand.vertices):
        out["true_hand_vertices"] = truth.hand_vertices
    return {name: _compact_dtype(name, values) for name, values in out.items()}


def _corners(size: tuple[int, int]) -> Float[ndarray, "4 2"]:
    width, height = size
    return np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])


def _scene_extent(view: View) -> float:
    """Compute the 0.9 quantile of the extent of hands and object, over the frames with the most hands [m]."""
    shown = [(len(view.hands(n)), n) for n in range(len(view.clip))]
    most = max(shown)[0]
    sizes = []
    for n in [n for count, n in shown if count == most]:
        around = [*(vertices for vertices, _ in view.hands(n)), *([view.object(n)] if view.posed else [])]
        sizes.append(np.linalg.norm(np.ptp(np.concatenate(around), axis=0)))
    return float(np.quantile(sizes, 0.9))


def _closeness(view: View, surface: Mesh) -> list[Float[ndarray, "T _V"]]:
    distances = surface_distances(view, surface, MAX_EXACT_DISTANCE_M)
    return [np.clip(1.0 - distance / MAX_EXACT_DISTANCE_M, 0.0, 1.0) for distance in distances]


def _axis_endpoints(view: View) -> Float[ndarray, "2 3"]:
    return np.full((2, 3), np.nan) if view.result.axis is None else axis_points(view)[[0, -1]]


def _bounding_box_centre(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "3"]:
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2.0)


def _compact_dtype(name: str, values: ndarray) -> ndarray:
    if name.endswith("_near"):
        return np.round(255.0 * values).astype(np.uint8)
    if name.endswith(("_known", "_colours")):
        return values.astype(np.uint8)
    if name.endswith("_faces"):
        return values.astype(np.uint16 if values.max(initial=0) < 2**16 else np.uint32)
    return values.astype(np.float32)
