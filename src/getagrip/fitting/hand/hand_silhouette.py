"""The hand's silhouette against the hand's mask: the mask's pixels, and the pixels in which the two differ."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt64
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks
from getagrip.fitting.energy.mask import signed_distance
from getagrip.fitting.hand.hand_error_model import HandErrors
from getagrip.geometry import se3
from getagrip.geometry.camera import Crops, crops_of_boxes, project
from getagrip.geometry.kernels.silhouette import NX, NY, ROW_DISTANCE, ROW_WEIGHT, U, V, Z, contours, pack, unpack
from getagrip.geometry.mesh import edge_table
from getagrip.io.images import PackedMasks, pack_masks

HAND_CROP_SIZE_PX = 128
"""Side of the crops [px]; a hand is half as large. Resampled directly: a reduced mask is a little too large."""
HAND_CROP_EXPANSION = 1.8
"""Side of the crops, in the largest side of the input hand's box."""
HAND_CONTOUR_STEP_PX = 4.0
"""Distance of contour points [px]."""
HAND_CONTOUR_DELTA_PX = 1.0
"""Distances below this count as this in the curvature [px]."""
MAX_HAND_CONTOUR_POINTS = 200
MASK_GROWTH_RANGE_PX = 0.7, 4.0
"""Margin by which masks are too small all round above which they are grown, and maximum growth [px]."""
HAND_CROP_DILATION_PX = 16
"""Distance from the input hand beyond which ignored pixels need not be the hand's [px]: a quarter of a hand."""
WRIST_JOINT, MIDDLE_KNUCKLE_JOINT = 0, 9


@dataclass(frozen=True)
class HandMask:
    """The hand's own pixels in N frames, in crops about the input hand.

    Attributes:
        K: (N, 4) fx, fy, cx, cy of the crops [px].
        observed: (N, n, words) the hand's pixels, as bits.
        valid: (N, n, words) pixels that are known to be the hand's or not: without the object's, which may hide the
            hand, without other ignored pixels, and without the arm's beyond the wrist. No pixels in frames without any
            pixel of the hand, whose hand may not be labelled.
        field: (N, n, n) signed distance to the visible contour [px]; empty before ``with_field``.
        grown: growth of the input masks all round [px].
    """

    K: Float[ndarray, "N 4"]
    observed: UInt64[ndarray, "N _ _"]
    valid: UInt64[ndarray, "N _ _"]
    field: Float32[ndarray, "N _ _"]
    grown: float = 0.0

    @staticmethod
    def of(clip: Clip, masks: Masks) -> HandMask:
        """Make the mask of a clip's hand, without field: from hand masks, else from the ignored pixels near it."""
        crops = hand_crops(clip)
        K = crops.intrinsics(clip.K)
        # Pixels at the border of the object's mask are the object's or the hand's.
        grown = PackedMasks([mask.grown for mask in pack_masks(masks.object).frames], clip.size[::-1])
        objects = crops.resample(grown.as_array(), outside=True)
        hand = crops.resample(masks.ignore if masks.hand is None else masks.hand, outside=False) & ~objects
        valid = ~objects
        fxfycxcy = np.stack([K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]], axis=1)
        if masks.hand is None:
            valid &= ~hand | _dilated_silhouettes(_mask_bits(clip.hand, fxfycxcy))
        else:
            valid &= hand | ~crops.resample(masks.ignore, outside=True)
            valid &= masks.hand.any(axis=(1, 2), keepdims=True)
        valid &= ~_beyond_wrist(clip.hand, K)
        hand &= valid
        return HandMask(fxfycxcy, pack(hand), pack(valid), _empty_fields(len(K)))

    @property
    def with_field(self) -> HandMask:
        """The mask with its field."""
        frames = zip(unpack(self.observed, HAND_CROP_SIZE_PX), unpack(self.valid, HAND_CROP_SIZE_PX), strict=True)
        return replace(self, field=np.stack([signed_distance(hand, valid) for hand, valid in frames]))

    def grown_to(self, silhouettes: UInt64[ndarray, "N _ _"]) -> HandMask:
        """Grow the masks by one distance in all frames until they are as large as these silhouettes.

        Masks that keep away from the object often keep away from all borders. A hand of known size that is fitted to
        such a mask turns. Masks too small by less than the first of ``MASK_GROWTH_RANGE_PX`` stay unchanged, and so do
        masks that are too large, whose hand may be at another place.
        """
        valid, field = unpack(self.valid, HAND_CROP_SIZE_PX), self.with_field.field
        least, most = MASK_GROWTH_RANGE_PX
        distances, area = field[valid], int(np.count_nonzero(unpack(silhouettes, HAND_CROP_SIZE_PX) & valid))
        if not np.count_nonzero(distances < least) < area < len(distances):
            return self
        grown = min(float(np.partition(distances, area)[area]), most)
        return replace(self, observed=pack((field < grown) & valid), grown=grown)

    def take(self, index: Int[ndarray, "n"]) -> HandMask:
        """Return the masks of some of the frames."""
        return HandMask(self.K[index], self.observed[index], self.valid[index], self.field[index], self.grown)

    @cached_property
    def pixels(self) -> int:
        """Number of the hand's visible pixels, in all frames."""
        return int(unpack(self.observed, HAND_CROP_SIZE_PX).sum())


@dataclass(frozen=True)
class HandContour:
    """Points of a hand's contour in N frames, against its mask's contour.

    Attributes:
        value: (N,) pixels in which silhouette and mask differ; infinite for a hand behind the camera.
        weight: (N, M) length of contour that each point stands for [px]; 0: none.
        distance: (N, M) signed distance to the mask's contour [px].
        nearest: (N, M) the vertex that each point moves with.
        along: (N, M, 3) derivative of a point's outward motion [px] by that vertex in the camera frame [m].
    """

    value: Float[ndarray, "N"]
    weight: Float[ndarray, "N M"]
    distance: Float[ndarray, "N M"]
    nearest: Int[ndarray, "N M"]
    along: Float[ndarray, "N M 3"]

    def quadratic(
        self, J: Float[ndarray, "N M P"]
    ) -> tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]:
        """Return value, gradient and Gauss-Newton Hessian, by P numbers that move the points outward by J."""
        hJ = np.swapaxes(self.weight[..., None] * J, 1, 2)
        return self.value, (hJ @ self.distance[..., None])[..., 0], hJ @ J


@dataclass(frozen=True)
class HandSilhouette:
    """A hand's errors, and the mask that they are measured by."""

    errors: HandErrors
    mask: HandMask
    edges: Int[ndarray, "4 E"]

    @staticmethod
    def of(clip: Clip, masks: Masks) -> HandSilhouette:
        """Make the silhouette of a clip and its masks, with rigid errors only and without the masks' field."""
        return HandSilhouette(HandErrors.of(clip.hand), HandMask.of(clip, masks), _hand_edges(clip.hand))

    @property
    def with_field(self) -> HandSilhouette:
        """The silhouette with the masks' field, which the derivatives need."""
        return replace(self, mask=self.mask.with_field)

    def with_masks_grown(self, x: Float[ndarray, "N P"]) -> HandSilhouette:
        """Grow the masks to the size of the silhouettes at x, if they are much too small."""
        return replace(self, mask=self.mask.grown_to(self._drawn(x)[3]))

    def with_fingers(self, sideways: bool = False) -> HandSilhouette:
        """Return a silhouette whose fingers may bend, and turn sideways."""
        return replace(self, errors=self.errors.with_fingers(sideways))

    def take(self, index: Int[ndarray, "n"]) -> HandSilhouette:
        """Return some of the frames."""
        return replace(self, errors=self.errors.take(index), mask=self.mask.take(index))

    def differing(self, x: Float[ndarray, "N P"]) -> float:
        """Count the pixels in which silhouette and mask differ, in all frames."""
        return float(self._drawn(x)[0].sum())

    def share(self, x: Float[ndarray, "N P"]) -> float:
        """Compute the fraction of the hand's visible pixels that differ from its silhouette; NaN without any."""
        return self.differing(x) / self.mask.pixels if self.mask.pixels else float("nan")

    def _drawn(self, x: Float[ndarray, "N P"]) -> _Contours:
        in_camera = se3.transform(self.errors.T_cam_hand(x), self.errors.surface(x)[0])
        return _compute_contours(in_camera, self.errors.tracked, self.edges, self.mask, 0)

    def __call__(
        self, x: Float[ndarray, "N P"]
    ) -> tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]:
        """Count the differing pixels of each frame, with gradient and Gauss-Newton Hessian by the errors."""
        vertices, joints = self.errors.surface(x)
        contour = self.contour(se3.transform(self.errors.T_cam_hand(x), vertices))
        return contour.quadratic(self.errors.jacobian(x, vertices, joints, contour.nearest, contour.along))

    def contour(self, in_camera: Float[ndarray, "N V 3"]) -> HandContour:
        """Return the contour of the hand's vertices in the camera frame, against the mask's contour."""
        value, points, nearest, _ = _compute_contours(in_camera, self.errors.tracked, self.edges, self.mask)
        z, (fx, fy, cx, cy) = np.maximum(points[:, Z], 1e-6), self.mask.K.T[..., None]
        nx, ny = points[:, NX] / z, points[:, NY] / z
        depth = -(nx * (points[:, U] - cx) + ny * (points[:, V] - cy))
        along = np.stack([nx * fx, ny * fy, depth], axis=-1)
        return HandContour(value, points[:, ROW_WEIGHT], points[:, ROW_DISTANCE], nearest, along)


def hand_crops(clip: Clip) -> Crops:
    """Return the crops about a clip's hand."""
    uv = project(clip.K, se3.transform(clip.hand.T_cam_hand, clip.hand.vertices))
    boxes = np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)
    return crops_of_boxes(boxes, HAND_CROP_EXPANSION, HAND_CROP_SIZE_PX)


_Contours = tuple[Float[ndarray, "N"], Float[ndarray, "N 7 M"], Int[ndarray, "N M"], UInt64[ndarray, "N _ _"]]
"""Output of ``geometry.kernels.silhouette.contours``: value, points, nearest vertices, bits."""


def _compute_contours(
    vertices: Float[ndarray, "N V 3"],
    hand: HandTrack,
    edges: Int[ndarray, "4 E"],
    mask: HandMask,
    most: int = MAX_HAND_CONTOUR_POINTS,
) -> _Contours:
    """Compute the silhouettes' contours, of at most ``most`` points each, against the masks'."""
    N = len(vertices)
    value, points, nearest = np.empty(N), np.empty((N, 7, most)), np.empty((N, most), np.int64)
    bits = np.empty_like(mask.observed)
    contours(
        np.ascontiguousarray(np.swapaxes(vertices, 1, 2)), np.ascontiguousarray(hand.faces), edges,
        bool(np.all(edges[3] < len(hand.faces))), mask.K, mask.observed, mask.valid, mask.field, HAND_CONTOUR_STEP_PX,
        HAND_CONTOUR_DELTA_PX, bits, value, points, nearest,
    )  # fmt: skip
    return value, points, nearest, bits


def _hand_edges(hand: HandTrack) -> Int[ndarray, "4 E"]:
    return np.ascontiguousarray(edge_table(hand.faces).T)


def _mask_bits(hand: HandTrack, K: Float[ndarray, "N 4"]) -> UInt64[ndarray, "N _ _"]:
    N = len(K)
    nothing = np.zeros((N, HAND_CROP_SIZE_PX, HAND_CROP_SIZE_PX // 64), np.uint64)
    unseen = HandMask(K, nothing, nothing, _empty_fields(N))
    return _compute_contours(se3.transform(hand.T_cam_hand, hand.vertices), hand, _hand_edges(hand), unseen, 0)[3]


def _empty_fields(frames: int) -> Float32[ndarray, "N 0 0"]:
    return np.empty((frames, 0, 0), np.float32)


def _dilated_silhouettes(bits: UInt64[ndarray, "N _ _"]) -> Bool[ndarray, "N n n"]:
    """Mark the pixels at most ``HAND_CROP_DILATION_PX`` from a silhouette."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * HAND_CROP_DILATION_PX + 1, 2 * HAND_CROP_DILATION_PX + 1))
    return np.stack([cv2.dilate(m.view(np.uint8), disc) for m in unpack(bits, HAND_CROP_SIZE_PX)]).view(bool)


def _beyond_wrist(hand: HandTrack, K: Float[ndarray, "N 3 3"]) -> Bool[ndarray, "N n n"]:
    """Mark the pixels on the arm's side of the wrist; none for a hand without joints."""
    if hand.joints is None:
        return np.zeros((len(K), HAND_CROP_SIZE_PX, HAND_CROP_SIZE_PX), dtype=bool)
    ends = se3.transform(hand.T_cam_hand, hand.joints[:, [WRIST_JOINT, MIDDLE_KNUCKLE_JOINT]])
    wrist, knuckle = np.moveaxis(project(K, ends), 1, 0)
    v, u = np.mgrid[:HAND_CROP_SIZE_PX, :HAND_CROP_SIZE_PX] + 0.5
    pairs = zip(wrist, wrist - knuckle, strict=True)
    return np.stack([(u - x) * du + (v - y) * dv > 0.0 for (x, y), (du, dv) in pairs])
