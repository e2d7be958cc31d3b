"""Drafts of a grasp's frames from its labels, as polygons: silhouettes of hands, and masks."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.rasterize import render_coverage
from getagrip.hands.from_2d.clicks import hands_from_clicks
from getagrip.studio.hands.detect_hands import HandDetectionFiles
from getagrip.studio.hands.stabilize_hands import stabilize_hands
from getagrip.studio.masks.propagate_clip import PropagatedLabels, propagate_labels
from getagrip.studio.masks.propagate_frame import Hands, Images
from getagrip.studio.masks.stroke_prompt import keyframe_label_maps
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, Labels

DRAFT_SILHOUETTE_PX = 640
"""Longer side of the image in which the hand's silhouette is rendered [px]."""
POLYGON_TOLERANCE = 1 / 1280
"""Largest distance of a polygon from the mask's border, as a fraction of the image's longer side."""
MIN_PART_AREA_FRACTION = 0.002
"""Area, as a fraction of the largest part's, below which parts and holes are left out."""

Polygon = Float[ndarray, "_n 2"]


def draft_fitted_hand(labels: Labels, K: Float[ndarray, "3 3"], image: Images) -> dict[int, dict[str, object]]:
    """Return, by frame, joints and silhouette of the fitted hand [px], and the joints clicked inconsistently.

    Raises ``UsageError`` as ``hands_from_clicks`` does.
    """
    found = hands_from_clicks(labels.clicks, K, labels.side, labels.first, labels.last)
    track = stabilize_hands(found, labels.first, K, labels.size, image).hand
    assert track.joints is not None
    zoom = min(1.0, DRAFT_SILHOUETTE_PX / max(labels.size))
    small = (round(zoom * labels.size[0]), round(zoom * labels.size[1]))
    out: dict[int, dict[str, object]] = {}
    for n, (T, vertices, joints) in enumerate(zip(track.T_cam_hand, track.vertices, track.joints, strict=True)):
        mask = render_coverage(se3.transform(T, vertices), track.faces, np.diag([zoom, zoom, 1.0]) @ K, small)
        points = _round_points(project(K, se3.transform(T, joints)))
        out[labels.first + n] = {"joints": points, "outlines": _mask_to_polygons(mask, 1.0 / zoom), "uncertain": []}
    for frame, outliers in zip(found.keys, found.outliers, strict=True):
        out[frame]["uncertain"] = np.flatnonzero(outliers).tolist()
    return out


def draft_detected_hand(labels: Labels, found: HandDetectionFiles) -> dict[int, dict[str, object]]:
    """Return, by frame, joints and silhouette of the detected hand [px]; no joints in frames without a hand."""
    out: dict[int, dict[str, object]] = {}
    for n in range(labels.first, labels.last + 1):
        mask, joints = found.mask(n), found.joints.get(n)
        shapes = [] if mask is None else _mask_to_polygons(mask, labels.size[0] / mask.shape[1])
        out[n] = {"joints": [] if joints is None else _round_points(joints), "outlines": shapes, "uncertain": []}
    return out


def draft_masks(
    labels: Labels,
    image: Images,
    known: Container[int] = (),
    seen: Hands = lambda _: None,
    keep: Callable[[PropagatedLabels], None] = lambda _: None,
) -> Iterator[tuple[int, dict[str, object]]]:
    """Yield each frame with polygons of object, hand and occluders [px], and their confidence (0 to 1).

    ``seen`` returns the visible hand, where it is known, and ``keep`` is called with each label map. Spans
    between key frames are skipped if all their frames are ``known``. Raises ``UsageError`` as ``propagate_labels``
    does.
    """
    kinds = {"object": OBJECT_LABEL, "front": OCCLUDER_LABEL, "hand": HAND_LABEL}
    drawn = keyframe_label_maps(labels, image, seen)
    for made in propagate_labels(image, drawn, labels.first, labels.last, known, seen):
        keep(made)
        frame, found, confidence = made
        shapes = {kind: _mask_to_polygons(found == label) for kind, label in kinds.items()}
        yield frame, shapes | {"confidence": round(float(confidence), 3)}


def _mask_to_polygons(mask: Bool[ndarray, "H W"], zoom: float = 1.0) -> list[list[list[float]]]:
    return [_round_points(zoom * shape) for shape in trace_polygons(mask)]


def _round_points(points: Float[ndarray, "n 2"]) -> list[list[float]]:
    return [[round(float(x), 2) for x in point] for point in np.nan_to_num(points, posinf=-1.0, neginf=-1.0)]


def trace_polygons(mask: Bool[ndarray, "H W"]) -> list[Polygon]:
    """Trace polygons around the parts of a mask [px]; ``readers.masks.mask_regions.fill_polygons`` nearly restores it.

    A part with a hole has a polygon with a slit: along its border, in to the hole, around it and back out.
    """
    import cv2

    contours, tree = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return []
    least = MIN_PART_AREA_FRACTION * max(float(cv2.contourArea(one)) for one in contours)
    coarse = POLYGON_TOLERANCE * max(mask.shape)
    large = [(n, one) for n, one in enumerate(contours) if cv2.contourArea(one) >= max(least, 1.0)]
    kept = {n: np.asarray(cv2.approxPolyDP(one, coarse, True)[:, 0], np.int64) for n, one in large}
    shapes = {n: corners for n, corners in kept.items() if tree[0][n][3] < 0 and len(corners) >= 3}
    for n, hole in kept.items():
        if (outside := int(tree[0][n][3])) in shapes and len(hole) >= 3:
            shapes[outside] = _join_hole(shapes[outside], hole)
    return [corners + 0.5 for corners in shapes.values()]


def _join_hole(outside: Int[ndarray, "n 2"], hole: Int[ndarray, "m 2"]) -> Int[ndarray, "k 2"]:
    """Join both into one polygon, slit where they are nearest to each other."""
    distance = np.linalg.norm(outside[:, None] - hole[None], axis=-1)
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    around = np.concatenate([hole[j:], hole[: j + 1]])
    return np.concatenate([outside[: i + 1], around, outside[i:]])
