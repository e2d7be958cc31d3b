"""A mask carried from its key frame through the images.

Where a pixel of the new frame was in the old one is found by dense inverse search (DIS; Kroeger, Timofte, Dai, Van
Gool, "Fast Optical Flow using Dense Inverse Search", ECCV 2016). After each step GrabCut (Rother, Kolmogorov, Blake,
SIGGRAPH 2004) draws the border anew in a narrow band, so that errors do not grow. Lengths are in
pixels of the size at which masks are carried (``propagated_masks.SIDE``).

What the hand, or something else in front, hides of the object is remembered: it moves on as the visible object does (an
affine motion). Pixels that come into view and were never seen are unknown, not background: their colour decides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from getagrip.annotate.colour_cut import Colours, Places, coloured_hand, cut, edges, likelier, touching
from getagrip.annotate.labels import FRONT, HAND, OBJECT
from getagrip.annotate.object_motion import hand_step, moved, moves_with, own_motion, shows_other
from getagrip.annotate.seen_ground import Ground
from getagrip.annotate.shared_flow import STILL, Part, SmallFrames, Step

Image = UInt8[ndarray, "H W 3"]
Images = Callable[[int], Image]
"""RGB by frame, from 0; of any one size that has the shape of the masks'."""
Hands = Callable[[int], Bool[ndarray, "H W"] | None]
"""The visible hand by frame, of any one size of that shape; None where it is not known."""

MARGIN = 90
"""Things that move farther than this from one frame to the next are lost [px]."""
GRID = 60
"""Parts of images in which flow is computed end at multiples of this, so that both directions share it [px]."""
ABOUT = 40.0
"""Colours of what is not the object are those of pixels nearer to it than this [px]."""
FAR = 24
"""Signed distances end here [px]."""
BAND = 2.0
"""The border of a mask that flow has moved is about so sure [px]."""
PRIOR, COLOUR, MOST = 4.0, 1.0, 3.0
"""Weights of being one ``BAND`` from the border, and of a colour that is e times likelier on one side, up to e^MOST."""
BACK = 1.5
"""Flow there and back agrees if it ends so near to where it began [px]."""

SEEN, UNCOVERED = 0.2, 0.15
"""``SEEN``: knowledge of a pixel that came into view after the key: its colour has decided. ``UNCOVERED``: of one that
something in front hid until then; unless it is taken for the object, its colour is not counted as the ground's."""
REMEMBERED = 0.95
"""Share of its knowledge that something hidden keeps from frame to frame."""
INNER = 2.5
"""The flow of pixels of the object that are farther from its border than this is its own [px]."""
STIFF = 0.5
"""Share by which a border that is certain moves less than colours would have it, so that errors do not add up."""

LOST = 0.15
"""Share of a mask's trust below which, after a frame, it is looked for as far away as the hand has moved."""

REACH = 10.0
"""Pixels of a found hand stay the hand's, whatever their colours, farther than this from the expected object [px]."""
CLEAR = 3.0
"""Pixels farther than this from all that is carried show the ground [px]."""

KINDS = (OBJECT, FRONT, HAND)
"""Kinds that are carried; where several are, the last one is visible."""


class Carried(NamedTuple):
    """The mask of a frame on its way; small, since those of all frames between two keys are kept."""

    frame: int
    corner: tuple[int, int]
    """Left and top of the part of the image that holds all of it [px]."""
    inside: Float32[ndarray, "3 h w"]
    """Signed distances from the borders of ``KINDS``, above 0 inside, -FAR to FAR [px].

    The object's where it is hidden, too."""
    known: Float32[ndarray, "h w"]
    """1 where the key shows whether the object is there, 0 where nothing has shown that, ``SEEN`` in between."""
    trust: float
    unlike: Float32[ndarray, "h w"]
    """Log ratio of a pixel's probabilities on the object and on the ground behind (``Ground.unlike``)."""


def carry(
    frames: SmallFrames,
    key: int,
    labels: UInt8[ndarray, "H W"],
    to: int,
    colours: Sequence[Colours],
    hand: Hands = lambda _: None,
) -> Iterator[Carried]:
    """Carry the mask of a key to the frames after it until ``to``, or before it; ``colours`` as of ``key_colours``."""
    if key == to:
        return
    now = _of_key(key, labels, frames)
    ground = Ground.of_key(frames[key].image, placed(now, (0, 0), frames.size)[0].max(axis=0) < -CLEAR)
    towards = 1 if to > key else -1
    was = _seen(hand, key, frames)
    for frame in range(key + towards, to + towards, towards):
        shown, before = _seen(hand, frame, frames), frame - towards
        ground_before = copy(ground)  # each step renews its own
        after = _step(now, ground, frames, before, frame, shown, colours)
        if after.trust < LOST * now.trust and (step := hand_step(was, shown)) != STILL:
            again = _step(now, ground_before, frames, before, frame, shown, colours, step)
            if again.trust > after.trust and (again.inside[0] > 0.0).any():
                after, ground = again, ground_before
        now, was = after, shown
        yield now


def key_colours(frames: SmallFrames, keys: Mapping[int, UInt8[ndarray, "H W"]]) -> list[Colours]:
    """Return colours of each of ``KINDS`` and what is about it in the keys."""
    found: list[list[Colours]] = [[] for _ in KINDS]
    for n, labels in keys.items():
        inside = [signed_distance(_shrunk(labels == kind, frames.size), ABOUT) for kind in KINDS]
        small = frames[n].image
        for kind, each in zip(found, inside, strict=True):
            kind.append(Colours.of(small, each > 0, (np.abs(each) > 1.0) & (each > -ABOUT)))
    return [Colours.mean(kind) for kind in found]


def _of_key(frame: int, labels: UInt8[ndarray, "H W"], frames: SmallFrames) -> Carried:
    inside = np.stack([signed_distance(_shrunk(labels == kind, frames.size)) for kind in KINDS])
    known = np.where(is_hidden(inside) & (inside[0] < 0.0), 0.0, 1.0).astype(np.float32)
    return _cut(Carried(frame, (0, 0), inside, known, 1.0, np.zeros_like(known)))


def is_hidden(inside: Float32[ndarray, "3 h w"]) -> Bool[ndarray, "h w"]:
    """Return where something is in front, or so near that the border may show it."""
    return np.asarray(inside[1:].max(axis=0) > -1.5)


def _seen(hand: Hands, frame: int, frames: SmallFrames) -> Bool[ndarray, "h w"] | None:
    seen = hand(frame)
    return None if seen is None else _shrunk(seen, frames.size)


def _shrunk(mask: Bool[ndarray, "H W"], size: tuple[int, int]) -> Bool[ndarray, "h w"]:
    import cv2

    return np.asarray(cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5)


def _step(
    now: Carried,
    ground: Ground,
    frames: SmallFrames,
    before: int,
    frame: int,
    hand: Bool[ndarray, "H W"] | None,
    colours: Sequence[Colours],
    step: Step = STILL,
) -> Carried:
    """Return a mask in the next frame; ``step``: about how far the object has moved [px]."""
    import cv2

    if not now.inside.size:  # it is not visible
        return now._replace(frame=frame)
    width, height = frames.size
    left, top = now.corner
    part = rows, columns = _around(now, frames.size)
    b, at = frames[frame].image[part], frames[frame].bins[part]
    there, back = frames.flows(before, frame, part, step)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in b.shape[1::-1]))
    came = x + back[..., 0], y + back[..., 1]
    round_trip = back + cv2.remap(there, *came, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    off = np.sqrt(np.einsum("hwc,hwc->hw", round_trip, round_trip))

    def old(u: Float32[ndarray, "h w"], v: Float32[ndarray, "h w"]) -> tuple[ndarray, ndarray]:
        return (
            np.clip(u + columns.start, 0, width - 1) - left,
            np.clip(v + rows.start, 0, height - 1) - top,
        )

    inside = np.stack([moved(kind, old(*came), -float(FAR)) for kind in now.inside])
    if hand is not None:
        coloured = coloured_hand(hand[part], at, colours[0], colours[-1])
        inside[-1] = signed_distance(coloured | (hand[part] & (inside[0] < -REACH)))
    hidden = is_hidden(inside)
    was_hidden = moved(is_hidden(now.inside).astype(np.float32), old(*came), 0.0) > 0.0
    inner = (inside[0] > INNER) & (off < BACK) & (inside[1:].max(axis=0) < -INNER) & ~was_hidden
    own = own_motion(x, y, came, inner)
    moves = np.zeros_like(off)
    with_ground = own_motion(x, y, came, (inside.max(axis=0) < -INNER) & (off < BACK) & ~was_hidden)
    behind = ground.moved(part, came if with_ground is None else with_ground)
    unlike = behind.unlike(b, colours[0].counts[:, at], inside.max(axis=0) < -CLEAR)
    if own is not None:
        moves = moves_with(came, own, with_ground, off)
        inside[0] = moved(now.inside[0], old(*own), -float(FAR))
        covered = hidden | was_hidden
        came = np.where(covered, own[0], came[0]), np.where(covered, own[1], came[1])
    u, v = came[0] + columns.start, came[1] + rows.start
    in_view = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    known = in_view * moved(now.known, old(*came), 1.0)
    border = (np.abs(inside[0]) < 2.0) & ~hidden
    trust = now.trust * (float(np.mean(off[border] < BACK)) if border.any() else 1.0)
    if shows_other(frames[before].image[part], b, came):
        trust = 0.0
    # Where the known ground is no longer seen, a new side of the object may be.
    as_ground = np.where((inside[0] < 0.0) & (unlike > 0.0), 2.0 / (1.0 + np.exp(unlike)), 1.0)
    certain = (known * as_ground * np.where(was_hidden, 0.1, np.where(off < BACK, 1.0, 0.3))).astype(np.float32)
    visible, known_before = placed(now, (columns.start, rows.start), b.shape[1::-1])
    top_most = ~is_hidden(visible) & ((visible[0] > 0.0) | (known_before > (SEEN + UNCOVERED) / 2.0))
    for n, kind in enumerate(visible):
        if (n < 2 or hand is None) and (kind > 0).any():
            clear = (np.abs(kind) > 1.0) & (top_most if n == 0 else kind > -FAR)
            likely = likelier(at, colours[n], Places.of(frames[before].bins[part], kind > 0, clear), came)
            if n == 0:
                likely += moves + unlike
            inside[n] = refined(b, inside[n], certain, likely, hidden & (n == 0))
    known = np.where(
        hidden,
        np.maximum(REMEMBERED * known, np.minimum(known, SEEN)),
        np.where(in_view & ((off < BACK) | (known < SEEN)), np.maximum(known, UNCOVERED), SEEN),
    ).astype(np.float32)
    ground.renew(frames[frame].image, part, behind, inside.max(axis=0) < -CLEAR)
    return _cut(Carried(frame, (columns.start, rows.start), inside, known, trust, unlike))


def _around(now: Carried, size: tuple[int, int]) -> Part:
    """Return the part of the next image that is looked at."""
    ends = []
    for begin, length, limit in zip(now.corner, now.inside.shape[:0:-1], size, strict=True):
        first, last = (begin - MARGIN) // GRID * GRID, -(-(begin + length + MARGIN) // GRID) * GRID
        ends.append(slice(max(0, first), min(limit, last)))
    return ends[1], ends[0]


def refined(
    image: Image,
    inside: Float32[ndarray, "h w"],
    certain: Float32[ndarray, "h w"],
    colours: Float32[ndarray, "h w"],
    hidden: Bool[ndarray, "h w"],
) -> Float32[ndarray, "h w"]:
    """Draw a border by colours: near to the expected one, freely where nothing is certain; its signed distances.

    What is ``hidden`` stays as it is.
    """
    import cv2

    near = inside > -FAR
    if not near.any() or not (inside > 0).any():
        return inside
    rows, columns = (slice(max(0, int(i.min()) - 1), int(i.max()) + 2) for i in np.nonzero(near))
    part = rows, columns
    prior = PRIOR * certain[part] * np.clip(inside[part] / BAND, -2.0, 2.0)
    cost = -(prior + COLOUR * np.clip(colours[part], -MOST, MOST))
    cost[~near[part]] = 10.0
    cost[hidden[part]] = np.where(inside[part] > 0, -10.0, 10.0)[hidden[part]]
    start = np.clip(0.5 + inside[part] / (2.0 * BAND), 0.0, 1.0)
    found = np.zeros(inside.shape, bool)
    found[part] = cut(cost.astype(np.float32), edges(image[part]), start.astype(np.float32))
    found = touching(found, inside > 0)
    new = cv2.GaussianBlur(signed_distance(found), (0, 0), 0.7)
    return np.asarray(inside + (new - inside) * np.where(hidden, 0.0, 1.0 - STIFF * certain), np.float32)


def signed_distance(mask: Bool[ndarray, "h w"], far: float = FAR) -> Float32[ndarray, "h w"]:
    """Measure the distance from the border between pixels, above 0 inside, up to ``far`` [px]."""
    import cv2

    distances = []
    for each in (mask, ~mask):
        seen = each.astype(np.uint8)
        if seen.all():
            distances.append(np.full(mask.shape, float(far), np.float32))
        else:
            distances.append(np.maximum(cv2.distanceTransform(seen, cv2.DIST_L2, 5) - 0.5, 0.0))
    return np.clip(distances[0] - distances[1], -far, far).astype(np.float32)


def _cut(whole: Carried) -> Carried:
    """Only the part that holds what is inside, and what is near to it."""
    near = (whole.inside > -FAR).any(axis=0)
    rows, columns = (
        (slice(int(i.min()), int(i.max()) + 1) for i in np.nonzero(near)) if near.any() else (slice(0, 0), slice(0, 0))
    )
    corner = whole.corner[0] + columns.start, whole.corner[1] + rows.start
    known, unlike = (each[rows, columns].copy() for each in (whole.known, whole.unlike))
    return whole._replace(corner=corner, inside=whole.inside[:, rows, columns].copy(), known=known, unlike=unlike)


def placed(
    each: Carried, corner: tuple[int, int], size: tuple[int, int]
) -> tuple[Float32[ndarray, "3 h w"], Float32[ndarray, "h w"]]:
    """Place signed distances, and what is known, in another part of the image, which holds theirs."""
    inside, known = np.full((len(KINDS), *size[::-1]), -float(FAR), np.float32), np.ones(size[::-1], np.float32)
    (left, top), (h, w) = np.subtract(each.corner, corner).tolist(), each.inside.shape[1:]
    inside[:, top : top + h, left : left + w] = each.inside
    known[top : top + h, left : left + w] = each.known
    return inside, known
