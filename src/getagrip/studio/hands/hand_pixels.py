"""Segment the visible pixels of a hand from its landmarks and nearby colours.

Pixels of capsules along the bones are certainly the hand if they have the skin's colour (a finger behind the object has
another colour). The skin's colour is the most frequent one of the hand's parts over a clip: in a single frame the palm
may be behind the object. Pixels near the capsules, and the forearm, are possibly the hand, unless they are much less
colourful than the palm and not overexposed; all others are background. GrabCut (Rother et al., SIGGRAPH 2004) decides
the possible pixels by colours and edges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Int32, UInt8
from numpy import ndarray

from getagrip.studio.hands.hand_tracking import PALM_LANDMARKS

MAX_GRABCUT_PX = 320
"""Largest side of the image that GrabCut runs on [px]."""
CERTAIN_BONE_RADIUS, POSSIBLE_BONE_RADIUS = 0.055, 0.17
"""Radii around bones, in sizes of the hand."""
PALM_BONE_RADIUS = 0.25
"""Larger radius around the bones of the palm, which is thick in a side view."""
FOREARM_SIZE = (1.6, 0.34)
"""Length and half width of the forearm, in sizes of the hand."""
SKIN_SIGMAS, NON_SKIN_SIGMAS = 3.5, 8.0
"""Robust standard deviations from the palm's colour beyond which a pixel is no longer certainly the hand, and beyond
which it is certainly not."""
MIN_COLOUR_PIXELS = 20
"""Minimum number of pixels for an estimate of the colour of the palm, the thumb, the wrist or the fingers."""
SKIN_LAB_DISTANCE, NON_SKIN_LAB_DISTANCE = 8.0, 10.0
"""Distances in Lab's two colours: below the first, thumb and wrist, or fingers, are alike; above the second, the palm
differs from them, since an object hides it."""
WRIST_LENGTH_RATIO = 0.25
"""Length of the wrist, in lengths of the palm."""
MIN_SKIN_COLOUR_SPREAD = 6.0
"""Minimum spread of the palm's colours [of 255]."""
MIN_SHADOW_LIGHTNESS_SPREAD, MIN_SHADOW_CHROMA_RATIO = 20.0, 0.5
"""Minimum spread of lightness along bones, where fingers may be in shadow [of 255], for pixels with at least this
fraction of the palm's chroma."""
LAB_GREY = 128.0
"""Lab's two colours of grey in OpenCV."""
MIN_SKIN_CHROMA_RATIO, MIN_PALM_CHROMA, OVEREXPOSURE_THRESHOLD = 0.3, 9.0, 245.0
"""Fraction of the palm's chroma below which pixels are not the hand, if the palm's chroma exceeds the second number.
Pixels with a channel of at least the third number [of 255] may be overexposed skin, and are probably the hand."""
N_SKIN_GRABCUT_ITERATIONS = 3
MAX_SKIN_FRAMES = 16
"""Maximum number of frames, evenly spaced, by which a clip's skin colour is found."""
SKIN_HUE_RANGE_DEG, MIN_SKIN_CHROMA = (-10.0, 110.0), 4.0
"""Range of skin's hue in Lab, from magenta over red to a greenish yellow, and minimum chroma: in 50 public videos of
all lights it is found with hues of 4 to 98 degrees, and chromas of 7 to 38."""
THUMB_LANDMARKS, KNUCKLE_LANDMARKS = [1, 2, 3, 4], [5, 9, 13, 17]
THUMB_WEB_LANDMARKS = [0, 1, 2, 3, 5, 6]
"""Landmarks around the skin between thumb and index finger."""
LANDMARK_BONES = [
    *((0, a) for a in (1, *KNUCKLE_LANDMARKS)),
    *((a, a + 1) for k in range(5) for a in range(1 + 4 * k, 4 + 4 * k)),
]
"""Pairs of landmarks."""


def hand_mask(
    image: UInt8[ndarray, "H W 3"],
    points: Float[ndarray, "21 2"],
    other: Bool[ndarray, "H W"] | None = None,
    skin: Float[ndarray, "2"] | None = None,
) -> Bool[ndarray, "H W"]:
    """Segment the visible pixels of a hand with landmarks ``points`` [px].

    ``other`` pixels are known not to be it, and ``skin`` is the clip's ``skin_colour``.
    """
    import cv2

    height, width = image.shape[:2]
    near = _Nearby.of(image, points)
    out = np.zeros((height, width), dtype=bool)
    window = (slice(near.low[1], near.high[1]), slice(near.low[0], near.high[0]))
    colours, not_hand = near.colours, np.zeros(near.colours.shape[:2], dtype=bool)
    if other is not None:
        small = other[window].astype(np.uint8)
        not_hand = cv2.resize(small, colours.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    labels = _grabcut_labels(near, not_hand, skin)
    if (labels == cv2.GC_FGD).sum() < 10 or (labels == cv2.GC_BGD).sum() < 10:
        return out
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(colours, labels, (0, 0, 0, 0), *models, N_SKIN_GRABCUT_ITERATIONS, cv2.GC_INIT_WITH_MASK)
    found = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    whole = _remove_small_components(found)
    size = tuple((near.high - near.low).tolist())
    large = cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    out[window] = large > 0.5
    return out if other is None else out & ~other


def skin_colour(
    image: Callable[[int], UInt8[ndarray, "H W 3"]], points: Mapping[int, Float[ndarray, "21 2"]]
) -> Float[ndarray, "2"] | None:
    """Find a clip's skin colour, Lab's two from grey, by a hand's landmarks in its frames [px].

    None where no part is visible, or where all are grey, green or blue: in gloves, or without colours.
    """
    frames = sorted(points)
    some = {frames[k * (len(frames) - 1) // (MAX_SKIN_FRAMES - 1)] for k in range(MAX_SKIN_FRAMES) if frames}
    parts = [_part_colours(_Nearby.of(image(n), points[n])) for n in sorted(some)]
    colours = np.concatenate([np.zeros((0, 2)), *parts])
    hue, chroma = np.degrees(np.arctan2(colours[:, 1], colours[:, 0])), np.linalg.norm(colours, axis=1)
    colours = colours[(hue > SKIN_HUE_RANGE_DEG[0]) & (hue < SKIN_HUE_RANGE_DEG[1]) & (chroma > MIN_SKIN_CHROMA)]
    if not len(colours):
        return None
    alike = np.linalg.norm(colours[:, None] - colours, axis=-1) < SKIN_LAB_DISTANCE
    return np.asarray(np.median(colours[alike[alike.sum(axis=1).argmax()]], axis=0))


@dataclass(frozen=True)
class _Nearby:
    """The part of an image about a hand, reduced to ``MAX_GRABCUT_PX``.

    Attributes:
        colours: red, green, blue.
        low, high: its corners in the image [px].
        points: the landmarks in it [px].
        arm: corners of the region of the forearm in it [px].
        size: the hand's size in it [px].
    """

    colours: UInt8[ndarray, "h w 3"]
    low: Int[ndarray, "2"]
    high: Int[ndarray, "2"]
    points: Float[ndarray, "21 2"]
    arm: Float[ndarray, "4 2"]
    size: float

    @staticmethod
    def of(image: UInt8[ndarray, "H W 3"], points: Float[ndarray, "21 2"]) -> _Nearby:
        import cv2

        height, width = image.shape[:2]
        size = _hand_size_px(points)
        arm = _forearm_polygon(points, size)
        around = np.concatenate([points, arm])
        low = np.clip(np.floor(around.min(axis=0) - 0.5 * size), 0, [width - 1, height - 1]).astype(int)
        high = np.clip(np.ceil(around.max(axis=0) + 0.5 * size), low + 1, [width, height]).astype(int)
        scale = min(1.0, MAX_GRABCUT_PX / float((high - low).max()))
        small = tuple(int(n) for n in np.maximum(1, np.round((high - low) * scale)))
        part = image[low[1] : high[1], low[0] : high[0]]
        colours = np.asarray(cv2.resize(part, small, interpolation=cv2.INTER_AREA), np.uint8)
        return _Nearby(colours, low, high, (points - low) * scale, (arm - low) * scale, size * scale)

    @property
    def palm(self) -> UInt8[ndarray, "h w"]:
        """The pixels well within the palm's outline."""
        import cv2

        palm = np.zeros(self.colours.shape[:2], np.uint8)
        cv2.fillConvexPoly(palm, _round_to_pixels(_hull(self.points[PALM_LANDMARKS])), 1)
        return np.asarray(cv2.erode(palm, np.ones((3, 3), np.uint8), iterations=max(1, round(0.05 * self.size))))

    @property
    def lab(self) -> Float[ndarray, "h w 3"]:
        import cv2

        return cv2.cvtColor(self.colours, cv2.COLOR_RGB2LAB).astype(float)

    def along(self, line: Float[ndarray, "n 2"]) -> Bool[ndarray, "h w"]:
        """Return the pixels near a line, by ``CERTAIN_BONE_RADIUS``."""
        return _draw_thick_lines(self.colours.shape[:2], line, CERTAIN_BONE_RADIUS * self.size) > 0

    @property
    def wrist_line(self) -> Float[ndarray, "2 2"]:
        behind = self.points[0] + WRIST_LENGTH_RATIO * (self.points[0] - self.points[9])
        return np.stack([self.points[0], behind])

    @property
    def finger_lines(self) -> list[Float[ndarray, "3 2"]]:
        """The fingers without their tips."""
        return [self.points[knuckle : knuckle + 3] for knuckle in KNUCKLE_LANDMARKS]


def _part_colours(near: _Nearby) -> Float[ndarray, "n 2"]:
    """Return Lab's two colours from grey of a hand's palm, thumb, wrist and fingers, of the parts within the image."""
    lab, lines = near.lab, (near.points[THUMB_LANDMARKS], near.wrist_line, *near.finger_lines)
    parts = [near.palm > 0, *map(near.along, lines)]
    seen = [np.median(lab[part][:, 1:], axis=0) - LAB_GREY for part in parts if part.sum() >= MIN_COLOUR_PIXELS]
    return np.array(seen).reshape(-1, 2)


def _hand_size_px(points: Float[ndarray, "21 2"]) -> float:
    """Measure the size of the hand [px]: the longest distance on the palm, which no view shortens."""
    palm = points[PALM_LANDMARKS]
    return max(float(np.linalg.norm(palm[:, None] - palm, axis=-1).max()), 4.0)


def _forearm_polygon(points: Float[ndarray, "21 2"], size: float) -> Float[ndarray, "4 2"]:
    """Return the corners of the region of the forearm [px]."""
    back = points[0] - points[KNUCKLE_LANDMARKS].mean(axis=0)
    back = back / max(float(np.linalg.norm(back)), 1e-6)
    across = np.array([-back[1], back[0]]) * FOREARM_SIZE[1] * size
    far = points[0] + FOREARM_SIZE[0] * size * back
    return np.array([points[0] - across, points[0] + across, far + 1.4 * across, far - 1.4 * across])


def _grabcut_labels(
    near: _Nearby, not_hand: Bool[ndarray, "h w"], clip_skin: Float[ndarray, "2"] | None
) -> UInt8[ndarray, "h w"]:
    """Return GrabCut's initial label of each pixel."""
    import cv2

    colours, points, size = near.colours, near.points, near.size
    maybe = _draw_bones(colours.shape[:2], points, POSSIBLE_BONE_RADIUS * size)
    for knuckle in (1, *KNUCKLE_LANDMARKS):
        maybe |= _draw_thick_lines(colours.shape[:2], points[[0, knuckle]], PALM_BONE_RADIUS * size)
    for region in (points[PALM_LANDMARKS], points[THUMB_WEB_LANDMARKS], near.arm):
        cv2.fillConvexPoly(maybe, _round_to_pixels(_hull(region)), 1)
    palm, lab = near.palm, near.lab
    sure = (_draw_bones(colours.shape[:2], points, CERTAIN_BONE_RADIUS * size) | palm).astype(bool) & ~not_hand
    shown = np.zeros_like(sure)
    if clip_skin is not None:
        shown = sure & (np.linalg.norm(lab[..., 1:] - LAB_GREY - clip_skin, axis=-1) < NON_SKIN_LAB_DISTANCE)
    if shown.sum() < MIN_COLOUR_PIXELS:
        shown = _skin_pixels(near, lab, palm.astype(bool) & ~not_hand, ~not_hand)
    skin = lab[shown] if shown.sum() >= MIN_COLOUR_PIXELS else lab[sure]
    off, in_shadow = _skin_colour_distance(lab, skin), _skin_colour_distance(lab, skin, MIN_SHADOW_LIGHTNESS_SPREAD)
    colour, own = lab[..., 1:] - LAB_GREY, np.median(skin, axis=0)[1:] - LAB_GREY if len(skin) else np.zeros(2)
    along, whole = colour @ own, own @ own
    coloured = along > MIN_SHADOW_CHROMA_RATIO * whole
    glare = (np.max(cv2.split(colours), axis=0) >= OVEREXPOSURE_THRESHOLD) & ~coloured
    pale = (along < MIN_SKIN_CHROMA_RATIO * whole) & (whole > MIN_PALM_CHROMA**2) & ~glare
    labels = np.full(colours.shape[:2], cv2.GC_BGD, np.uint8)
    possible = (maybe > 0) & ~not_hand & ~pale & ((off < NON_SKIN_SIGMAS) | coloured)
    labels[possible] = cv2.GC_PR_BGD
    labels[possible & ((off < SKIN_SIGMAS) | glare)] = cv2.GC_PR_FGD
    labels[possible & sure & ((off < SKIN_SIGMAS) | coloured & (in_shadow < SKIN_SIGMAS))] = cv2.GC_FGD
    return labels


def _skin_pixels(
    near: _Nearby, lab: Float[ndarray, "h w 3"], palm: Bool[ndarray, "h w"], seen: Bool[ndarray, "h w"]
) -> Bool[ndarray, "h w"]:
    """Return pixels of skin: the palm or, if an object hides the palm, thumb and wrist.

    Fingers without their tips replace a wrist that is not visible.
    """
    lines = near.points[THUMB_LANDMARKS], near.wrist_line, *near.finger_lines
    thumb, wrist, *fingers = (seen & near.along(line) for line in lines)
    other = wrist if wrist.sum() >= MIN_COLOUR_PIXELS else np.any(fingers, axis=0)
    if min(part.sum() for part in (thumb, other, palm)) < MIN_COLOUR_PIXELS:
        return palm
    colours = [np.median(lab[part][:, 1:], axis=0) for part in (thumb, other, palm)]
    alike = np.linalg.norm(colours[0] - colours[1]) < SKIN_LAB_DISTANCE
    covered = alike and min(np.linalg.norm(colours[2] - each) for each in colours[:2]) > NON_SKIN_LAB_DISTANCE
    return thumb | other if covered else palm


def _skin_colour_distance(
    lab: Float[ndarray, "h w 3"], skin: Float[ndarray, "n 3"], shadow: float = 0.0
) -> Float[ndarray, "h w"]:
    """Measure the distance of colours from the skin's, in robust standard deviations."""
    if not len(skin):
        return np.zeros(lab.shape[:2])
    middle = np.median(skin, axis=0)
    spread = np.maximum(1.48 * np.median(np.abs(skin - middle), axis=0), MIN_SKIN_COLOUR_SPREAD)
    spread[0] = max(2.0 * spread[0], shadow)  # light and shadow
    apart = (lab - middle) / spread
    return np.sqrt(np.einsum("hwc,hwc->hw", apart, apart))


def _draw_bones(shape: Sequence[int], points: Float[ndarray, "21 2"], radius: float) -> UInt8[ndarray, "h w"]:
    out = np.zeros(tuple(shape), np.uint8)
    for bone in LANDMARK_BONES:
        out |= _draw_thick_lines(shape, points[list(bone)], radius)
    return out


def _draw_thick_lines(shape: Sequence[int], points: Float[ndarray, "n 2"], radius: float) -> UInt8[ndarray, "h w"]:
    """Draw the pixels within a radius of the lines between consecutive points."""
    import cv2

    out = np.zeros(tuple(shape), np.uint8)
    cv2.polylines(out, [_round_to_pixels(points)], False, 1, max(1, round(2.0 * radius)))
    return out


def _hull(points: Float[ndarray, "n 2"]) -> Float[ndarray, "m 2"]:
    import cv2

    return np.asarray(cv2.convexHull(points.astype(np.float32))[:, 0], dtype=float)


def _round_to_pixels(points: Float[ndarray, "n 2"]) -> Int32[ndarray, "n 2"]:
    """Round to the nearest pixels, within the range that OpenCV draws."""
    return np.clip(np.round(points - 0.5), -4096, 4096).astype(np.int32)


def _remove_small_components(found: Bool[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
    """Remove components that are small compared with the largest; holes stay."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(found.astype(np.uint8), connectivity=4)
    if count <= 1:
        return found
    areas = stats[:, cv2.CC_STAT_AREA].astype(float)
    areas[0] = 0.0
    return np.asarray((areas > 0.05 * areas.max())[labels])
