"""Pixels whose label in a frame is uncertain: neither object nor background is claimed of them.

A hand's mask lacks fingers in shadow, and a propagated mask takes them for the object, or leaves out slits between
fingers through which the object shows. Landmarks tell where fingers may be, colours of the key frames what a pixel may
show; a pixel whose label contradicts them is unknown. So is background along a finger that may hide the object: fingers
often have the background's colours.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from getagrip.studio.hands.hand_pixels import LANDMARK_BONES
from getagrip.studio.hands.hand_tracking import PALM_LANDMARKS
from getagrip.studio.masks.graph_cut import UNSEEN_COLOUR_PROBABILITY, ColourHistogram, colour_bins
from getagrip.studio.masks.propagate_frame import Hands, Image, Images
from getagrip.studio.masks.stroke_prompt import bounding_slices, resize_mask
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL

FINGER_RADIUS = 0.12
"""Distance from a bone within which a finger may be, in sizes of the hand: twice a finger's."""
HIDING_FINGER_RADIUS = 0.08
"""Distance from a bone within which a finger hides the background, in sizes of the hand: a finger's, and the landmarks'
errors."""
SLIT_DISTANCE = 0.1
"""Distance from the hand within which the object may show between fingers, in sizes of the hand."""
MAX_REACH = max(FINGER_RADIUS, SLIT_DISTANCE)
"""Distance from the hand beyond which no pixel is uncertain, in sizes of the hand."""
MIN_COLOUR_RATIO = 4.0
"""Ratio of a colour's probabilities on the object and beside it from which on a pixel beside the hand may be the
object's."""
NO_COLOURS = ColourHistogram(np.zeros((2, 1), np.float32))
Joints = Mapping[int, Float[ndarray, "21 2"]]
"""Landmarks of the hand by frame [px]; frames without a hand are absent."""
LabelMap = UInt8[ndarray, "H W"]
"""A label map."""


def finger_pixels(
    joints: Float[ndarray, "21 2"], shape: tuple[int, ...], radius: float = FINGER_RADIUS
) -> Bool[ndarray, "H W"]:
    """Return the pixels of an image of a shape (height, width) at which landmarks [px] say that a finger may be.

    ``radius`` is the distance from a bone, in sizes of the hand.
    """
    import cv2

    out = np.zeros(shape[:2], np.uint8)
    width = max(1, round(2.0 * radius * hand_size_px(joints)))
    ends = np.clip(np.round(joints - 0.5), -4096, 4096).astype(np.int32)
    for a, b in LANDMARK_BONES:
        if np.isfinite(joints[[a, b]]).all():
            cv2.line(out, ends[a].tolist(), ends[b].tolist(), 1, width)
    return out > 0


def hand_size_px(joints: Float[ndarray, "21 2"]) -> float:
    """Return the longest distance on the palm [px]."""
    palm = joints[PALM_LANDMARKS]
    return max(float(np.nanmax(np.linalg.norm(palm[:, None] - palm, axis=-1))), 4.0)


@dataclass(frozen=True)
class UncertainPixels:
    """Colours of key frames, and landmarks, by which labels are uncertain."""

    colours: ColourHistogram
    """Colours in the key frames: the object's, and those of the background, away from fingers."""
    joints: Joints
    drawn: Collection[int]
    """Key frames: their pixels of the object stay."""

    @staticmethod
    def of_keys(keys: Mapping[int, LabelMap], image: Images, hand: Hands, joints: Joints) -> UncertainPixels:
        """Count the colours in the label maps of key frames; ``hand`` returns the visible hand, if it is known."""
        some = []
        for n, labels in keys.items():
            if (own := labels == OBJECT_LABEL).any():
                near = np.zeros(own.shape, bool)
                near[bounding_slices(own, own.shape)] = True
                ground = near & (labels == 0)
                if (seen := hand(n)) is not None:
                    ground &= ~resize_mask(seen, own.shape)
                if n in joints:
                    ground &= ~finger_pixels(joints[n], own.shape)
                some.append(ColourHistogram.of(image(n), own, ground | own))
        return UncertainPixels(ColourHistogram.mean(some or [NO_COLOURS]), joints if some else {}, keys.keys())

    def find(self, n: int, labels: LabelMap, image: Image) -> Bool[ndarray, "H W"]:
        """Return the uncertain pixels of a frame's label map; none in frames without landmarks.

        At fingers, colours of neither object nor background are uncertain; beside the hand, what is labelled as
        background in the object's colours.
        """
        whole = np.zeros(labels.shape, bool)
        if n not in self.joints:
            return whole
        part = _reach_of_hand(self.joints[n], labels)
        if not labels[part].size:
            return whole
        whole[part] = self._find_in(n, labels[part], image[part], self.joints[n] - [part[1].start, part[0].start])
        return whole

    def _find_in(self, n: int, labels: LabelMap, image: Image, joints: Float[ndarray, "21 2"]) -> Bool[ndarray, "h w"]:
        """Return the uncertain pixels in the part of a frame that the hand reaches, with its landmarks there [px]."""
        import cv2

        own, ground = self.colours.counts[:, colour_bins(image)]
        claimed = labels <= (0 if n in self.drawn else OBJECT_LABEL)
        unlike = claimed & (np.maximum(own, ground) < UNSEEN_COLOUR_PROBABILITY)
        fingers = unlike & finger_pixels(joints, labels.shape)
        away = cv2.distanceTransform((labels != HAND_LABEL).astype(np.uint8), cv2.DIST_L2, 3)
        beside = (labels == 0) & (away < SLIT_DISTANCE * hand_size_px(joints))
        slits = beside & (own > MIN_COLOUR_RATIO * np.maximum(ground, 0.1 * UNSEEN_COLOUR_PROBABILITY))
        square = np.ones((3, 3), np.uint8)
        opened = [cv2.morphologyEx(each.astype(np.uint8), cv2.MORPH_OPEN, square) > 0 for each in (fingers, slits)]
        return np.asarray(np.logical_or(*opened))

    def behind_fingers(self, n: int, labels: LabelMap) -> Bool[ndarray, "H W"]:
        """Return the background of a frame's label map, of any colour, that a finger hides if its landmarks are right.

        None in frames without landmarks.
        """
        if n not in self.joints:
            return np.zeros(labels.shape, bool)
        return (labels == 0) & finger_pixels(self.joints[n], labels.shape, HIDING_FINGER_RADIUS)


def _reach_of_hand(joints: Float[ndarray, "21 2"], labels: LabelMap) -> tuple[slice, slice]:
    """Return rows and columns that hold the hand's mask, its landmarks [px], and all pixels that either may concern."""
    margin = MAX_REACH * hand_size_px(joints) + 4.0
    seen, known = np.argwhere(labels == HAND_LABEL)[:, ::-1], joints[np.isfinite(joints).all(axis=1)]
    points = np.concatenate([some for some in (seen, known) if len(some)] or [np.zeros((1, 2))])
    size = np.array(labels.shape[::-1])
    low, high = np.clip(points.min(axis=0) - margin, 0, size), np.clip(points.max(axis=0) + margin, 0, size)
    (left, top), (right, bottom) = np.floor(low).astype(int).tolist(), np.ceil(high).astype(int).tolist()
    return slice(top, bottom), slice(left, right)
