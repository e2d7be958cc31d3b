"""E_mask (Eq. 6): pixels in which the rendered and the observed object mask differ, where nothing hides them.

The observation crops a clip's masks at several resolutions, for the term to compare silhouettes with. Pixels in gaps
between the object's mask and its occluder's do not count: masks of annotators and networks often leave a few pixels
between the two that belong to neither. Counted as background, these pixels would end the object at its mask, though the
object continues behind the hand; at the true pose they are silhouette and not mask, no other pixel compensates, and the
object is drawn away from the hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt64
from numpy import ndarray

from getagrip.clip import Masks
from getagrip.compiling import kernel
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry.camera import Crops, crops_around
from getagrip.geometry.kernels.silhouette import (
    N_COUNTER_BITS,
    accumulate,
    match_boundary,
    mismatch,
    pack,
    project,
    rasterise,
    sample_contour,
    sample_field,
    silhouette_edges,
)
from getagrip.geometry.mesh import Mesh

MASK_CROP_SIZE_PX = 256
"""Side of the crops [px]: the paper's render_size."""
MASK_LEVELS_PX = (64, 128, 256)
DISTANCE_FIELD_SIZE_PX = 128
"""Side of the distance fields [px]."""
R2_SEQUENCE_STEP = np.array([0.7548776662466927, 0.5698402909980532])
"""Multiples of these fill the unit square evenly, modulo 1."""
N_COVERAGE_TARGETS = 28
"""Observed boundary points per frame in the coverage term."""
MAX_CONTOUR_POINTS = 1500
"""Contour points kept per image; far more than any 256-pixel contour gives at the steps in use."""
MAX_GAP_PX = 12
"""Maximum width of a gap [px of the crop]."""
OPPOSITE_SIDES_COSINE = np.cos(np.radians(120.0))
"""Maximum cosine between the directions from a gap's pixel to the object and to its occluder."""
GAP_SHARE = 0.4
"""Fraction of the border above which pixels between the masks are gaps. Exact masks have pixels between the two as
well, in the corners where the object's outline goes behind the hand: fewer, in nine clips of ten. (Medians over
DexYCB's training subjects: exact 0.23, gaps of 1 px 0.66, of 2 px 0.95; contours off by 1, 2 and 4 px 0.37, 0.57 and
0.65.)"""
_Y, _X = np.mgrid[-MAX_GAP_PX : MAX_GAP_PX + 1, -MAX_GAP_PX : MAX_GAP_PX + 1].reshape(2, -1)
_OFFSET_ORDER = np.argsort(_X * _X + _Y * _Y, kind="stable")
_OFFSETS = np.stack([_X, _Y], axis=1)[_OFFSET_ORDER][1:]
"""Steps (x, y) to other pixels, nearest first."""
_OFFSET_LENGTHS = np.hypot(*_OFFSETS.T)


def find_gap_pixels(
    observed: Bool[ndarray, "N s s"], hidden: Bool[ndarray, "N s s"], share: float = GAP_SHARE
) -> Bool[ndarray, "N s s"]:
    """Find the pixels of a clip's crops in gaps between the object's masks and its occluders'.

    The nearest pixels of both are on opposite sides of a gap's pixel, and a gap is at most ``MAX_GAP_PX`` pixels wide.
    No pixels where gaps are at most ``share`` of the border of both: 1 finds gaps in no masks, 0 in all separate ones.
    """
    if share >= 1.0:
        return np.zeros_like(observed)
    found, touching = np.empty_like(observed), 0
    around = np.ones((2 * MAX_GAP_PX + 1, 2 * MAX_GAP_PX + 1), np.uint8)
    half = MAX_GAP_PX // 2 + 1  # one of the two is at most this far from a gap's pixel
    within = around[: 2 * half + 1, : 2 * half + 1]
    for n, (s, h) in enumerate(zip(observed, hidden, strict=True)):
        if not h.any():
            found[n] = False
            continue
        near, near_hidden = (cv2.dilate(m.view(np.uint8), around).view(bool) for m in (s, h))
        found[n] = near & near_hidden & ~(s | h)
        if found[n].any():
            found[n] &= cv2.dilate((s | h).view(np.uint8), within).view(bool)
        _keep_gaps(s, h, _OFFSETS, _OFFSET_LENGTHS, found[n])
        touching += int(np.count_nonzero(cv2.dilate(h.view(np.uint8), around[:3, :3]).view(bool) & s))
    area = int(np.count_nonzero(found))
    return found if area > share * (area + touching) else np.zeros_like(found)


@kernel("b2 b2 i2 f1 b2")
def _keep_gaps(observed, hidden, offsets, lengths, found):
    """Keep those of the pixels in ``found`` that are in gaps."""
    size = len(found)
    for i in range(size):
        for j in range(size):
            if not found[i, j]:
                continue
            x0 = y0 = x1 = y1 = 0
            to_object = to_hidden = 0.0
            for k in range(len(offsets)):
                x, y = offsets[k, 0], offsets[k, 1]
                distance = lengths[k]
                # One that is yet to be found is no nearer than this: then the gap is too wide.
                if distance + (max(to_object, to_hidden) or distance) > MAX_GAP_PX + 1.0:
                    break
                if not (0 <= i + y < size and 0 <= j + x < size):
                    continue
                if to_object == 0.0 and observed[i + y, j + x]:
                    x0, y0, to_object = x, y, distance
                if to_hidden == 0.0 and hidden[i + y, j + x]:
                    x1, y1, to_hidden = x, y, distance
                if to_object > 0.0 and to_hidden > 0.0:
                    break
            both = to_object > 0.0 and to_hidden > 0.0
            found[i, j] = both and x0 * x1 + y0 * y1 <= OPPOSITE_SIDES_COSINE * to_object * to_hidden


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
        has_gaps: whether the masks leave gaps between the object and its occluders, whose pixels do not count.
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
        crops = Crops(self.crops.corner[index], self.crops.side, self.crops.size)
        observed, valid = ({k: bits[index] for k, bits in masks.items()} for masks in (self.observed, self.valid))
        rest = self.field[index], self.targets[index], self.area[index], self.has_gaps
        return Observation(crops, self.K[index], observed, valid, *rest)


def observe_masks(
    masks: Masks, K: Float[ndarray, "T 3 3"], use_ignore: bool = True, gap_share: float = GAP_SHARE
) -> Observation:
    """Crop the masks of a clip and prepare them for fitting. Every object mask must have a pixel.

    ``use_ignore=False`` counts hidden pixels as background (the paper's ablation of C_o). Pixels in gaps between the
    masks do not count either, where gaps are more than ``gap_share`` of the masks' border (``find_gap_pixels``).
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


def masks_leave_gaps(masks: Masks, gap_share: float = GAP_SHARE) -> bool:
    """Return ``has_gaps`` of an ``Observation`` of the masks, without the rest of it."""
    crops = _dither_crops(crops_around(masks.object, size=MASK_CROP_SIZE_PX))
    observed, valid = _sample_masks(masks, crops, use_ignore=True)
    return bool(find_gap_pixels(observed, ~valid, gap_share).any())


def _dither_crops(crops: Crops) -> Crops:
    """Shift each crop by a fraction of an image pixel that depends on the crop's place.

    A mask's contour runs along its pixels' borders, up to half a pixel from the object's. Crops centred on whole pixels
    would sample the left and right of it alike in every frame, and err in the object's size alike in every frame.
    """
    return replace(crops, corner=crops.corner + crops.corner.sum(axis=1, keepdims=True) * R2_SEQUENCE_STEP % 1.0 - 0.5)


def _sample_masks(
    masks: Masks, crops: Crops, use_ignore: bool
) -> tuple[Bool[ndarray, "N s s"], Bool[ndarray, "N s s"]]:
    """Sample the object's pixels, and the pixels that count.

    Each level is sampled from the masks themselves at the centres of its pixels, as silhouettes are. Majorities of a
    finer level's pixels would have ties, and an object half a pixel too large or small is as much too near or far.
    """
    observed = crops.resample(masks.object, outside=False)
    hidden = masks.ignore if use_ignore else np.broadcast_to(False, masks.object.shape)
    return observed, ~crops.resample(hidden, outside=True) | observed


def _downsample_any(pixels: Bool[ndarray, "N s s"], size: int) -> Bool[ndarray, "N n n"]:
    """Mark a coarser level's pixels that contain any of the pixels."""
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


@dataclass(frozen=True)
class SilhouetteMesh:
    """A mesh as the silhouette kernels read it: coordinates about its centre, one array per component."""

    vertices: Float[ndarray, "3 V"]
    planes: Float[ndarray, "4 F"]
    edges: ndarray
    closed: bool

    @property
    def tables(self) -> tuple[ndarray, ndarray, ndarray, bool]:
        """The fields, as the kernels take them."""
        return self.vertices, self.planes, self.edges, self.closed

    @staticmethod
    def of(mesh: Mesh, centre: Float[ndarray, "3"]) -> SilhouetteMesh:
        """Build the tables of a mesh about a given centre."""
        planes = mesh.planes.copy()
        planes[:, 3] += planes[:, :3] @ centre
        return SilhouetteMesh(
            vertices=np.ascontiguousarray((mesh.vertices - centre).T),
            planes=np.ascontiguousarray(planes.T),
            edges=np.ascontiguousarray(mesh.edges.T),
            closed=mesh.is_closed,
        )


@dataclass(frozen=True)
class MaskTerm:
    """E_mask of N frames at one resolution."""

    mesh: SilhouetteMesh
    observation: Observation
    level: int = MASK_CROP_SIZE_PX
    """Side of the rendered masks [px]: 64, 128 or 256."""
    step: float = 2.0
    """Distance between contour points [px of the level]."""
    delta: float = 1.0
    """Distances below this count as this in the curvature [px of the crop]."""
    coverage: float = 0.0
    """Weight of the pull from observed boundary points to the rendered contour; it finds thin objects."""
    name: str = "mask"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found, o = Quadratic.zero(poses), self.observation
        _evaluate_mask(
            poses.R, poses.centre, poses.scale, *self.mesh.tables, o.K, o.observed[self.level], o.valid[self.level],
            o.field, o.targets, self.step, self.delta, self.coverage, bound, found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f2 f2 i2 b f2 u3 u3 s3 f3 f f f f1 f2 f3 f4")
def _evaluate_mask(
    R, centre, scale, vertices, planes, edges, closed, K, observed, valid, field, targets, step, delta, coverage, bound,
    value, g, H,
):  # fmt: skip
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    size, words = observed.shape[1], observed.shape[2]
    zoom = size / MASK_CROP_SIZE_PX
    E = edges.shape[1] + 1
    uvz = np.empty((N, 3, vertices.shape[1]))
    sign = np.empty(planes.shape[1] + 1, np.int64)
    edge = np.empty((N, 3, E), np.int64)
    n_edges = np.empty(N, np.int64)
    lines = np.empty((12, E))
    counters = np.empty((size, words, N_COUNTER_BITS), np.uint64)
    bits = np.empty((N, size, words), np.uint64)
    points = np.empty((7, MAX_CONTOUR_POINTS))
    matched = np.empty((7, targets.shape[1]))
    pixel = 1.0 / (zoom * zoom)
    gate = 4.0 * (20.0 / zoom) ** 2
    for b in range(B):
        total = 0.0
        for n in range(N):
            if not project(vertices, R[b, n], centre[b, n], scale[b], K[n], uvz[n]):
                value[b, n] = np.inf
                total = np.inf
                break
            n_edges[n] = silhouette_edges(planes, edges, R[b, n], centre[b, n], scale[b], sign, edge[n])
            rasterise(uvz[n], edge[n], n_edges[n], closed, zoom, lines, counters, bits[n])
            value[b, n] = pixel * mismatch(bits[n], observed[n], valid[n])
            total += value[b, n]
            if total > bound[b]:  # the step is rejected, whatever the other frames say
                break
        if total > bound[b] or total == np.inf:
            continue
        for n in range(N):
            count = sample_contour(uvz[n], edge[n], n_edges[n], zoom, step, bits[n], valid[n], lines, points)
            sample_field(points, count, field[n], DISTANCE_FIELD_SIZE_PX / MASK_CROP_SIZE_PX, step / zoom, delta)
            if coverage > 0.0:
                match_boundary(points, count, targets[n], gate, coverage, delta, matched)
            for some, many in ((points, count), (matched, targets.shape[1] if coverage > 0.0 else 0)):
                accumulate(some, many, centre[b, n], K[n], g[b, n], H[b, n])
            for i in range(1, 7):
                for j in range(i):
                    H[b, n, i, j] = H[b, n, j, i]
