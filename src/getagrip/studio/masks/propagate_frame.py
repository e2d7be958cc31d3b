"""Propagate the mask of a key frame, frame by frame.

Optical flow gives each pixel's place in the frame before. After each step a minimal cut by colours redraws the border
in a narrow band, so that errors do not accumulate. Parts of the object that the hand or another occluder hides are
remembered, and move as the visible object does (an affine motion). Pixels that come into view are unknown rather than
background: their colour decides. Lengths are in pixels of the reduced images (``OBJECT_WORKING_SIZE_PX``).

Background model: pixels matching previously seen background are not object.

The model moves with the visible surroundings, and is updated wherever the background is visible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from getagrip.studio.masks.graph_cut import (
    ColourHistogram,
    LocalColourHistogram,
    colour_log_ratio,
    edge_cost,
    minimal_cut,
    overlapping_components,
    remove_object_colours,
)
from getagrip.studio.masks.optical_flow import (
    ZERO_STEP,
    Origins,
    Part,
    Step,
    fit_object_motion,
    hand_displacement,
    is_other_shot,
    motion_log_ratio,
    squared_flow_error,
    warp_values,
)
from getagrip.studio.masks.small_frames import SmallFrames
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL

GROUND_NOISE_SIGMA = 9.0
"""Standard deviation of each channel of a pixel that shows unchanged background [of 255]."""
GROUND_BIN_PROBABILITY = 0.15
"""Fraction of unchanged background pixels in the most frequent bin of their colours."""
MIN_COLOUR_PROBABILITY = 0.01
"""Probability of a colour that no pixel has shown."""
GROUND_CHANGE_RATE = 0.1, 3.0
"""Fraction of the background beside the object that has changed since it was seen: the first number, plus the second
times the fraction far from the object."""


@dataclass
class BackgroundModel:
    """An image of the background, and how far each of its pixels was seen: 0 to 1.

    Only pixels that a key frame shows count as seen: pixels that come into view later may be the object's.
    """

    image: UInt8[ndarray, "h w 3"]
    seen: Float32[ndarray, "h w"]

    @staticmethod
    def of_key(image: UInt8[ndarray, "h w 3"], visible: Bool[ndarray, "h w"]) -> BackgroundModel:
        """Begin with the ``visible`` background of a key frame."""
        return BackgroundModel(image.copy(), visible.astype(np.float32))

    def moved(self, part: Part, origins: Origins) -> BackgroundModel:
        """Return a part of the model in the next frame; ``origins`` are its pixels' places in the part now."""
        import cv2

        image = cv2.remap(self.image[part], *origins, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        seen = cv2.remap(self.seen[part], *origins, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, 0.0)
        return BackgroundModel(np.asarray(image, np.uint8), np.asarray(seen, np.float32))

    def renew(
        self, image: UInt8[ndarray, "h w 3"], part: Part, moved: BackgroundModel, visible: Bool[ndarray, "y x"]
    ) -> None:
        """Replace the model by the next frame's: ``image`` outside a part, inside ``moved``, new where ``visible``."""
        import cv2

        apart = np.max(cv2.split(cv2.absdiff(image[part], moved.image)), axis=0)  # numpy is slow on short axes
        same = visible & (apart < 2.0 * GROUND_NOISE_SIGMA)
        self.image, self.seen = image.copy(), self.seen.copy()
        self.image[part] = np.where(same[..., None], image[part], moved.image)
        self.seen[part] = moved.seen

    def unlike(
        self, image: UInt8[ndarray, "h w 3"], shares: Float32[ndarray, "2 h w"], clear: Bool[ndarray, "h w"]
    ) -> Float32[ndarray, "h w"]:
        """Return the log ratio of a pixel's probabilities on the object and on this background, 0 where unseen.

        ``shares`` are the fractions of the object's pixels, and of all others, with the pixel's colour. The less the
        background has changed where it is ``clear``, the more a changed colour is evidence of the object.
        """
        import cv2

        now, before = (cv2.GaussianBlur(each.astype(np.float32), (0, 0), 1.0) for each in (image, self.image))
        apart = np.subtract(now, before)
        same = np.exp(-np.einsum("hwc,hwc->hw", apart, apart) / (2.0 * GROUND_NOISE_SIGMA**2))
        known = clear & (self.seen > 0.5)
        least, times = GROUND_CHANGE_RATE
        changed = min(1.0, least + times * (1.0 - float(same[known].mean()))) if known.any() else 1.0
        own, other = shares + MIN_COLOUR_PROBABILITY
        return np.asarray(self.seen * np.log(own / (GROUND_BIN_PROBABILITY * same + changed * other)), np.float32)


Image = UInt8[ndarray, "H W 3"]
Images = Callable[[int], Image]
"""RGB by frame, from 0; all of one size, with the masks' aspect ratio."""
Hands = Callable[[int], Bool[ndarray, "H W"] | None]
"""The visible hand by frame, all of one size, with the same aspect ratio; None where it is not known."""

MAX_DISPLACEMENT_PX = 90
"""Largest displacement from one frame to the next; faster objects are lost [px]."""
FLOW_GRID_PX = 60
"""Grid to which the image parts for flow are rounded, so that both directions of time share the flow [px]."""
BACKGROUND_BAND_PX = 40.0
"""Width of the band around the object whose colours are the background's [px]."""
MAX_SIGNED_DISTANCE_PX = 24
"""Limit of signed distances [px]."""
BORDER_SIGMA_PX = 2.0
"""Standard deviation of a mask's border after a step of flow [px]."""
BORDER_PRIOR_WEIGHT, MASK_COLOUR_WEIGHT, MAX_COLOUR_LOG_RATIO = 4.0, 1.0, 3.0
"""Weights of a distance of ``BORDER_SIGMA_PX`` from the border, and of a log ratio of colours of 1; limit of the log
ratio."""
FLOW_CONSISTENCY_PX = 1.5
"""Error of the flow to a frame and back below which it is consistent [px]."""
SEEN_PIXEL_CONFIDENCE, UNCOVERED_PIXEL_CONFIDENCE = 0.2, 0.15
"""Confidence of a pixel that came into view after the key frame, classified by its colour; and of a pixel that an
occluder hid until then: unless it is classified as object, its colour is not counted as the background's."""
MIN_CLASSIFIED_CONFIDENCE = (SEEN_PIXEL_CONFIDENCE + UNCOVERED_PIXEL_CONFIDENCE) / 2.0
"""Confidence above which a pixel's label is known, or was classified by its colour."""
OCCLUDED_CONFIDENCE_DECAY = 0.95
"""Factor on the confidence of a hidden pixel from frame to frame."""
OBJECT_INTERIOR_PX = 2.5
"""Distance from the object's border beyond which the flow of its pixels is the object's own [px]."""
BORDER_STIFFNESS = 0.5
"""Fraction of a border's shift by colours suppressed where the border is certain, so that errors do not add up."""
MIN_TRUST_RATIO = 0.15
"""Fraction of a mask's trust left after a step below which it is searched for at the hand's displacement."""
HAND_KEEP_DISTANCE_PX = 10.0
"""Distance from the expected object beyond which pixels of the detected hand stay the hand's, whatever their colours
[px]."""
MIN_GROUND_DISTANCE_PX = 3.0
"""Distance from all tracked labels beyond which pixels show the background [px]."""
TRACKED_LABELS = (OBJECT_LABEL, OCCLUDER_LABEL, HAND_LABEL)
"""Labels that are propagated; where they overlap, the last one is visible."""


class TrackedMask(NamedTuple):
    """The propagated mask of a frame, cropped, since the masks of all frames between two key frames are kept."""

    frame: int
    corner: tuple[int, int]
    """Left and top of the crop [px]."""
    inside: Float32[ndarray, "3 h w"]
    """Signed distances from the borders of ``TRACKED_LABELS``, above 0 inside, up to ``MAX_SIGNED_DISTANCE_PX`` [px].

    Hidden parts of the object are included."""
    known: Float32[ndarray, "h w"]
    """Confidence of each pixel's label: 1 where the key frame shows it, 0 where it was never seen."""
    trust: float
    """Fraction of the border with consistent flow, multiplied over all steps since the key frame."""
    unlike: Float32[ndarray, "h w"]
    """Log ratio of a pixel's probabilities on the object and on the background (``BackgroundModel.unlike``)."""


def track_mask(
    frames: SmallFrames,
    key: int,
    labels: UInt8[ndarray, "H W"],
    to: int,
    colours: Sequence[ColourHistogram],
    hand: Hands = lambda _: None,
) -> Iterator[TrackedMask]:
    """Propagate the mask of the key frame ``key`` to the frames after it until ``to``, or to those before it.

    ``colours`` are those of ``keyframe_histograms``; ``hand`` returns the visible hand.
    """
    if key == to:
        return
    now = _mask_of_keyframe(key, labels, frames)
    ground = BackgroundModel.of_key(
        frames[key].image, place_in_window(now, (0, 0), frames.size)[0].max(axis=0) < -MIN_GROUND_DISTANCE_PX
    )
    towards = 1 if to > key else -1
    was = _hand_mask_at(hand, key, frames)
    for frame in range(key + towards, to + towards, towards):
        shown, before = _hand_mask_at(hand, frame, frames), frame - towards
        ground_before = copy(ground)  # each step renews its own
        after = _track_mask_step(now, ground, frames, before, frame, shown, colours)
        if after.trust < MIN_TRUST_RATIO * now.trust and (step := hand_displacement(was, shown)) != ZERO_STEP:
            again = _track_mask_step(now, ground_before, frames, before, frame, shown, colours, step)
            if again.trust > after.trust and (again.inside[0] > 0.0).any():
                after, ground = again, ground_before
        now, was = after, shown
        yield now


def keyframe_histograms(frames: SmallFrames, keys: Mapping[int, UInt8[ndarray, "H W"]]) -> list[ColourHistogram]:
    """Return the colours of each of ``TRACKED_LABELS`` and of its surroundings, in the key frames ``keys``."""
    found: list[list[ColourHistogram]] = [[] for _ in TRACKED_LABELS]
    for n, labels in keys.items():
        inside = [
            signed_distance(_downscale_mask(labels == kind, frames.size), BACKGROUND_BAND_PX) for kind in TRACKED_LABELS
        ]
        small = frames[n].image
        for kind, each in zip(found, inside, strict=True):
            kind.append(ColourHistogram.of(small, each > 0, (np.abs(each) > 1.0) & (each > -BACKGROUND_BAND_PX)))
    return [ColourHistogram.mean(kind) for kind in found]


def _mask_of_keyframe(frame: int, labels: UInt8[ndarray, "H W"], frames: SmallFrames) -> TrackedMask:
    inside = np.stack([signed_distance(_downscale_mask(labels == kind, frames.size)) for kind in TRACKED_LABELS])
    known = np.where(is_occluded(inside) & (inside[0] < 0.0), 0.0, 1.0).astype(np.float32)
    return _crop_to_mask(TrackedMask(frame, (0, 0), inside, known, 1.0, np.zeros_like(known)))


def is_occluded(inside: Float32[ndarray, "3 h w"]) -> Bool[ndarray, "h w"]:
    """Return the pixels that an occluder hides, or whose border it may hide."""
    return np.asarray(inside[1:].max(axis=0) > -1.5)


def _hand_mask_at(hand: Hands, frame: int, frames: SmallFrames) -> Bool[ndarray, "h w"] | None:
    seen = hand(frame)
    return None if seen is None else _downscale_mask(seen, frames.size)


def _downscale_mask(mask: Bool[ndarray, "H W"], size: tuple[int, int]) -> Bool[ndarray, "h w"]:
    import cv2

    return np.asarray(cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5)


def _track_mask_step(
    now: TrackedMask,
    ground: BackgroundModel,
    frames: SmallFrames,
    before: int,
    frame: int,
    hand: Bool[ndarray, "H W"] | None,
    colours: Sequence[ColourHistogram],
    step: Step = ZERO_STEP,
) -> TrackedMask:
    """Propagate a mask to the next frame; ``step`` is the object's approximate displacement [px]."""

    if not now.inside.size:  # the object is not visible
        return now._replace(frame=frame)
    (width, height), (left, top) = frames.size, now.corner
    part = rows, columns = _search_window(now, frames.size)
    b, at = frames[frame].image[part], frames[frame].bins[part]
    there, back = frames.flows(before, frame, part, step)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in b.shape[1::-1]))
    came = x + back[..., 0], y + back[..., 1]
    off = np.sqrt(squared_flow_error(there, back, came))

    def old(u: Float32[ndarray, "h w"], v: Float32[ndarray, "h w"]) -> tuple[ndarray, ndarray]:
        return (np.clip(u + columns.start, 0, width - 1) - left, np.clip(v + rows.start, 0, height - 1) - top)

    inside = np.stack([warp_values(kind, old(*came), -float(MAX_SIGNED_DISTANCE_PX)) for kind in now.inside])
    if hand is not None:
        coloured = remove_object_colours(hand[part], at, colours[0], colours[-1])
        inside[-1] = signed_distance(coloured | (hand[part] & (inside[0] < -HAND_KEEP_DISTANCE_PX)))
    hidden = is_occluded(inside)
    was_hidden = warp_values(is_occluded(now.inside).astype(np.float32), old(*came), 0.0) > 0.0
    usable = (off < FLOW_CONSISTENCY_PX) & ~was_hidden
    inner = (inside[0] > OBJECT_INTERIOR_PX) & (inside[1:].max(axis=0) < -OBJECT_INTERIOR_PX)
    own = fit_object_motion(x, y, came, inner & usable)
    with_ground = fit_object_motion(x, y, came, (inside.max(axis=0) < -OBJECT_INTERIOR_PX) & usable)
    behind = ground.moved(part, came if with_ground is None else with_ground)
    unlike = behind.unlike(b, colours[0].counts[:, at], inside.max(axis=0) < -MIN_GROUND_DISTANCE_PX)
    moves = np.zeros_like(off) if own is None else motion_log_ratio(came, own, with_ground, off)
    if own is not None:
        inside[0] = warp_values(now.inside[0], old(*own), -float(MAX_SIGNED_DISTANCE_PX))
        covered = hidden | was_hidden
        came = np.where(covered, own[0], came[0]), np.where(covered, own[1], came[1])
    u, v = came[0] + columns.start, came[1] + rows.start
    in_view = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    known = in_view * warp_values(now.known, old(*came), 1.0)
    border = (np.abs(inside[0]) < 2.0) & ~hidden
    trust = now.trust * (float(np.mean(off[border] < FLOW_CONSISTENCY_PX)) if border.any() else 1.0)
    if is_other_shot(frames[before].image[part], b, came):
        trust = 0.0
    # Where the known background is no longer visible, a new side of the object may be.
    as_ground = np.where((inside[0] < 0.0) & (unlike > 0.0), 2.0 / (1.0 + np.exp(unlike)), 1.0)
    flow_certainty = np.where(was_hidden, 0.1, np.where(off < FLOW_CONSISTENCY_PX, 1.0, 0.3))
    certain = (known * as_ground * flow_certainty).astype(np.float32)
    visible, known_before = place_in_window(now, (columns.start, rows.start), b.shape[1::-1])
    top_most = ~is_occluded(visible) & ((visible[0] > 0.0) | (known_before > MIN_CLASSIFIED_CONFIDENCE))
    for n, kind in enumerate(visible):
        if (n < 2 or hand is None) and (kind > 0).any():
            clear = (np.abs(kind) > 1.0) & (top_most if n == 0 else kind > -MAX_SIGNED_DISTANCE_PX)
            nearby = LocalColourHistogram.of(frames[before].bins[part], kind > 0, clear)
            likely = colour_log_ratio(at, colours[n], nearby, came)
            if n == 0:
                likely += moves + unlike
            inside[n] = refine_border(b, inside[n], certain, likely, hidden & (n == 0))
    followed = in_view & ((off < FLOW_CONSISTENCY_PX) | (known < SEEN_PIXEL_CONFIDENCE))
    known = _next_confidence(known, hidden, followed)
    ground.renew(frames[frame].image, part, behind, inside.max(axis=0) < -MIN_GROUND_DISTANCE_PX)
    return _crop_to_mask(TrackedMask(frame, (columns.start, rows.start), inside, known, trust, unlike))


def _next_confidence(
    known: Float32[ndarray, "h w"], hidden: Bool[ndarray, "h w"], followed: Bool[ndarray, "h w"]
) -> Float32[ndarray, "h w"]:
    """Return ``TrackedMask.known`` after a step; ``followed`` pixels have an origin in view with consistent flow."""
    remembered = np.maximum(OCCLUDED_CONFIDENCE_DECAY * known, np.minimum(known, SEEN_PIXEL_CONFIDENCE))
    shown = np.where(followed, np.maximum(known, UNCOVERED_PIXEL_CONFIDENCE), SEEN_PIXEL_CONFIDENCE)
    return np.where(hidden, remembered, shown).astype(np.float32)


def _search_window(now: TrackedMask, size: tuple[int, int]) -> Part:
    """Return the part of the next image in which the mask may be."""
    ends = []
    for begin, length, limit in zip(now.corner, now.inside.shape[:0:-1], size, strict=True):
        first = (begin - MAX_DISPLACEMENT_PX) // FLOW_GRID_PX * FLOW_GRID_PX
        last = -(-(begin + length + MAX_DISPLACEMENT_PX) // FLOW_GRID_PX) * FLOW_GRID_PX
        ends.append(slice(max(0, first), min(limit, last)))
    return ends[1], ends[0]


def refine_border(
    image: Image,
    inside: Float32[ndarray, "h w"],
    certain: Float32[ndarray, "h w"],
    colours: Float32[ndarray, "h w"],
    hidden: Bool[ndarray, "h w"],
) -> Float32[ndarray, "h w"]:
    """Redraw a border by ``colours`` (log ratios), near the expected one where it is ``certain`` (0 to 1).

    Returns signed distances [px]; ``hidden`` pixels stay as they are.
    """
    import cv2

    near = inside > -MAX_SIGNED_DISTANCE_PX
    if not near.any() or not (inside > 0).any():
        return inside
    rows, columns = (slice(max(0, int(i.min()) - 1), int(i.max()) + 2) for i in np.nonzero(near))
    part = rows, columns
    prior = BORDER_PRIOR_WEIGHT * certain[part] * np.clip(inside[part] / BORDER_SIGMA_PX, -2.0, 2.0)
    cost = -(prior + MASK_COLOUR_WEIGHT * np.clip(colours[part], -MAX_COLOUR_LOG_RATIO, MAX_COLOUR_LOG_RATIO))
    cost[~near[part]] = 10.0
    cost[hidden[part]] = np.where(inside[part] > 0, -10.0, 10.0)[hidden[part]]
    start = np.clip(0.5 + inside[part] / (2.0 * BORDER_SIGMA_PX), 0.0, 1.0)
    found = np.zeros(inside.shape, bool)
    found[part] = minimal_cut(cost.astype(np.float32), edge_cost(image[part]), start.astype(np.float32))
    found = overlapping_components(found, inside > 0)
    new = cv2.GaussianBlur(signed_distance(found), (0, 0), 0.7)
    return np.asarray(inside + (new - inside) * np.where(hidden, 0.0, 1.0 - BORDER_STIFFNESS * certain), np.float32)


def signed_distance(mask: Bool[ndarray, "h w"], far: float = MAX_SIGNED_DISTANCE_PX) -> Float32[ndarray, "h w"]:
    """Measure signed distances from a mask's border, above 0 inside, limited to ``far`` [px]."""
    import cv2

    distances = []
    for each in (mask, ~mask):
        seen = each.astype(np.uint8)
        if seen.all():
            distances.append(np.full(mask.shape, float(far), np.float32))
        else:
            distances.append(np.maximum(cv2.distanceTransform(seen, cv2.DIST_L2, 5) - 0.5, 0.0))
    return np.clip(distances[0] - distances[1], -far, far).astype(np.float32)


def _crop_to_mask(whole: TrackedMask) -> TrackedMask:
    """Crop a mask to its pixels and those within ``MAX_SIGNED_DISTANCE_PX`` of them."""
    near = (whole.inside > -MAX_SIGNED_DISTANCE_PX).any(axis=0)
    rows, columns = (
        (slice(int(i.min()), int(i.max()) + 1) for i in np.nonzero(near)) if near.any() else (slice(0, 0), slice(0, 0))
    )
    corner = whole.corner[0] + columns.start, whole.corner[1] + rows.start
    known, unlike = (each[rows, columns].copy() for each in (whole.known, whole.unlike))
    return whole._replace(corner=corner, inside=whole.inside[:, rows, columns].copy(), known=known, unlike=unlike)


def place_in_window(
    each: TrackedMask, corner: tuple[int, int], size: tuple[int, int]
) -> tuple[Float32[ndarray, "3 h w"], Float32[ndarray, "h w"]]:
    """Return a mask's signed distances and confidence in a larger part of the image, at a ``corner`` of a ``size``."""
    inside = np.full((len(TRACKED_LABELS), *size[::-1]), -float(MAX_SIGNED_DISTANCE_PX), np.float32)
    known = np.ones(size[::-1], np.float32)
    (left, top), (h, w) = np.subtract(each.corner, corner).tolist(), each.inside.shape[1:]
    inside[:, top : top + h, left : left + w] = each.inside
    known[top : top + h, left : left + w] = each.known
    return inside, known
