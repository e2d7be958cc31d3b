"""The masks of a clip, cropped, at several resolutions, in the form the mask term reads."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt64
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.compiling import kernel
from getagrip.fitting.mask_gaps import GAP_SHARE, find_gap_pixels
from getagrip.geometry.camera import Crops, crops_around
from getagrip.kernels.silhouette import pack

MASK_CROP_SIZE_PX = 256
"""Side of the crops [px]: the paper's render_size."""
MASK_LEVELS_PX = (64, 128, 256)
DISTANCE_FIELD_SIZE_PX = 128
"""Side of the distance fields [px]."""
R2_SEQUENCE_STEP = np.array([0.7548776662466927, 0.5698402909980532])
"""Multiples of these fill the unit square evenly, modulo 1."""
N_COVERAGE_TARGETS = 28
"""Observed boundary points per frame in the coverage term."""


@dataclass(frozen=True)
class Observation:
    """The observed masks of N frames in square crops of 256 pixels.

    Attributes:
        crops: the windows of the image.
        K: (N, 4) fx, fy, cx, cy of the crops [px of the crop].
        observed: per level, (N, n, n): the object's mask as bits.
        valid: per level, (N, n, n): pixels that count (the paper's C_o).
        field: (N, 128, 128) signed distance to the visible contour [px of the crop], negative inside. Inside it is the
            distance to visible background, so that borders with an occluder do not attract.
        targets: (N, 28, 5) points on the visible contour: position, outward normal, and the length of contour each
            stands for [px].
        area: (N,) pixels of the object's mask in the crop.
        has_gaps: whether the masks leave gaps between the object and what hides it, whose pixels do not count.
    """

    crops: Crops
    K: Float[ndarray, "N 4"]
    observed: dict[int, UInt64[ndarray, "N _ _"]]
    valid: dict[int, UInt64[ndarray, "N _ _"]]
    field: Float32[ndarray, "N 128 128"]
    targets: Float[ndarray, "N 28 5"]
    area: Float[ndarray, "N"]
    has_gaps: bool

    def take(self, index: Int[ndarray, "n"]) -> Observation:
        """Return the observation at some of its frames."""
        return Observation(
            crops=Crops(self.crops.corner[index], self.crops.side, self.crops.size),
            K=self.K[index],
            observed={level: bits[index] for level, bits in self.observed.items()},
            valid={level: bits[index] for level, bits in self.valid.items()},
            field=self.field[index],
            targets=self.targets[index],
            area=self.area[index],
            has_gaps=self.has_gaps,
        )


def observe_masks(
    masks: Masks, K: Float[ndarray, "T 3 3"], use_ignore: bool = True, gap_share: float = GAP_SHARE
) -> Observation:
    """Crop the masks of a clip and prepare them for fitting. Every object mask must have a pixel.

    ``use_ignore=False`` counts hidden pixels as background (the paper's ablation of C_o). Those in gaps between
    the masks do not count either, where these are more than ``gap_share`` of the masks' border (``mask_gaps.in_gaps``).
    """
    crops = _dither_crops(crops_around(masks.object, size=MASK_CROP_SIZE_PX))
    levels = {
        level: _sample_masks(masks, replace(crops, size=level), use_ignore)
        for level in {*MASK_LEVELS_PX, DISTANCE_FIELD_SIZE_PX}
    }
    Kc, observed = crops.intrinsics(K), levels[MASK_CROP_SIZE_PX][0]
    gaps = find_gap_pixels(observed, ~levels[MASK_CROP_SIZE_PX][1], gap_share)
    if has_gaps := bool(gaps.any()):
        levels = {level: (s, s | (c & ~_downsample_any(gaps, level))) for level, (s, c) in levels.items()}
    field = np.empty((len(observed), DISTANCE_FIELD_SIZE_PX, DISTANCE_FIELD_SIZE_PX), np.float32)
    targets = np.empty((len(observed), N_COVERAGE_TARGETS, 5))
    for n, (s, c) in enumerate(zip(*levels[DISTANCE_FIELD_SIZE_PX], strict=True)):
        field[n] = signed_distance(s, c) * (MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX)
        _spread_boundary_targets(s, c, field[n], MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX, targets[n])
    return Observation(
        crops=crops,
        K=np.stack([Kc[:, 0, 0], Kc[:, 1, 1], Kc[:, 0, 2], Kc[:, 1, 2]], axis=1),
        observed={level: pack(levels[level][0]) for level in MASK_LEVELS_PX},
        valid={level: pack(levels[level][1]) for level in MASK_LEVELS_PX},
        field=field,
        targets=targets,
        area=observed.sum(axis=(1, 2)).astype(float),
        has_gaps=has_gaps,
    )


def _dither_crops(crops: Crops) -> Crops:
    """Shift each crop by another part of a pixel of the image, which depends on its place.

    A mask's contour runs along its pixels' borders, up to half a pixel from the object's. Crops centred on whole pixels
    would sample the left and right of it alike in every frame, and err in the object's size alike in every frame.
    """
    return replace(crops, corner=crops.corner + crops.corner.sum(axis=1, keepdims=True) * R2_SEQUENCE_STEP % 1.0 - 0.5)


def _sample_masks(
    masks: Masks, crops: Crops, use_ignore: bool
) -> tuple[Bool[ndarray, "N s s"], Bool[ndarray, "N s s"]]:
    """Sample the object's pixels, and those that count.

    Each level is sampled from the masks themselves, where silhouettes are: at the centres of its pixels. Majorities of
    a finer level's pixels would have ties, and objects half a pixel too large or too small are as much too near or far.
    """
    observed = crops.resample(masks.object, outside=False)
    hidden = masks.ignore if use_ignore else np.broadcast_to(False, masks.object.shape)
    return observed, ~crops.resample(hidden, outside=True) | observed


def _downsample_any(pixels: Bool[ndarray, "N s s"], size: int) -> Bool[ndarray, "N n n"]:
    """Pixels of a coarser level that any of the given ones is in."""
    while pixels.shape[1] > size:
        pixels = pixels[:, ::2] | pixels[:, 1::2]
        pixels = pixels[:, :, ::2] | pixels[:, :, 1::2]
    return pixels


def signed_distance(observed: Bool[ndarray, "s s"], valid: Bool[ndarray, "s s"]) -> Float32[ndarray, "s s"]:
    """Compute the signed distance to the visible contour [px], negative on the object.

    On hidden pixels it is the distance to the object, minus that to the background.
    """
    background = valid & ~observed
    to_object, to_background = distance_transform(observed), distance_transform(background)
    return np.where(observed, 0.5 - to_background, np.where(background, to_object - 0.5, to_object - to_background))


def distance_transform(target: Bool[ndarray, "s s"]) -> Float32[ndarray, "s s"]:
    """Compute the distance of each pixel's centre to the nearest of the target [px], correctly rounded.

    2 s if the target is empty.
    """
    if not target.any():
        return np.full(target.shape, np.float32(2 * len(target)))
    rounded = cv2.distanceTransform((~target).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.sqrt(np.rint(rounded * rounded))  # OpenCV's last bits differ from process to process


def _spread_boundary_targets(
    observed: Bool[ndarray, "s s"],
    valid: Bool[ndarray, "s s"],
    field: Float32[ndarray, "s s"],
    zoom: float,
    targets: Float[ndarray, "Q 5"],
) -> None:
    """Spread the targets over the pixels of the object that touch visible background; unused ones get length 0."""
    background, touching = valid & ~observed, np.zeros_like(observed)
    touching[1:-1, 1:-1] = background[:-2, 1:-1] | background[2:, 1:-1] | background[1:-1, :-2] | background[1:-1, 2:]
    pixels = np.argwhere(touching & observed)
    n, used = len(pixels), min(len(pixels), len(targets))
    chosen = (2 * np.arange(used) + 1) * n // (2 * max(used, 1))
    targets[:, :4], targets[:, 4] = 0.0, np.where(np.arange(len(targets)) < used, zoom * n / max(used, 1), 0.0)
    _fill_boundary_targets(np.ascontiguousarray(pixels[chosen]), field, zoom, targets)


@kernel("i2 s2 f f2")
def _fill_boundary_targets(pixels, field, zoom, targets):
    """Fill in position and outward normal of the targets on pixels (n, 2)."""
    for q in range(len(pixels)):
        i, j = pixels[q, 0], pixels[q, 1]
        gx, gy = field[i, j + 1] - field[i, j - 1], field[i + 1, j] - field[i - 1, j]
        norm = np.sqrt(gx * gx + gy * gy) + 1e-12
        gx, gy = gx / norm, gy / norm
        d = field[i, j]  # from the pixel's centre to the contour itself
        targets[q, 0], targets[q, 1] = (j + 0.5) * zoom - d * gx, (i + 0.5) * zoom - d * gy
        targets[q, 2], targets[q, 3] = gx, gy
