"""Pixels whose colours contradict their labels are unknown: fingers in shadow, and slits between fingers."""

from __future__ import annotations

import cv2
import numpy as np
from numpy import ndarray

from getagrip.studio.masks.uncertain_pixels import UncertainPixels, finger_pixels, hand_size_px
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL
from helpers.labelled_scene import HEIGHT, WIDTH
from helpers.labelled_scene import joints as clicked_joints

JOINTS = np.array(clicked_joints(0))
GROUND, THING, SKIN, SHADE = (200, 190, 170), (20, 60, 180), (250, 210, 190), (120, 70, 60)


def scene() -> tuple[ndarray, ndarray]:
    """A hand before a thing, one finger in shadow; and labels that take the finger for the thing."""
    image, labels = np.full((HEIGHT, WIDTH, 3), GROUND, np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)
    x, y = JOINTS[8].astype(int)
    image[y - 30 : y + 30, x - 30 : x + 30], labels[y - 30 : y + 30, x - 30 : x + 30] = THING, OBJECT_LABEL
    finger = shaded()
    image[finger] = SHADE
    palm = finger_pixels(JOINTS, labels.shape) & ~finger & (labels == 0)
    image[palm], labels[palm] = SKIN, HAND_LABEL
    return image, labels


def shaded() -> ndarray:
    out = np.zeros((HEIGHT, WIDTH), bool)
    x, y = JOINTS[8].astype(int)
    out[y - 4 : y + 4, x - 4 : x + 4] = True
    return out


def key() -> tuple[ndarray, ndarray]:
    """The thing alone."""
    image, labels = np.full((HEIGHT, WIDTH, 3), GROUND, np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)
    image[90:150, 130:190], labels[90:150, 130:190] = THING, OBJECT_LABEL
    return image, labels


def uncertain(image: ndarray, labels: ndarray) -> ndarray:
    first, drawn = key()
    found = UncertainPixels.of_keys({0: drawn}, lambda _: first, lambda _: None, {1: JOINTS})
    return found.find(1, labels, image)


def test_a_finger_in_shadow_is_unknown_and_what_is_seen_of_the_object_is_not() -> None:
    image, labels = scene()
    found = uncertain(image, labels)
    assert found[shaded()].all()
    assert not found[(labels == OBJECT_LABEL) & ~shaded()].any()
    assert not found[labels == HAND_LABEL].any()


def test_a_slit_in_the_objects_colours_beside_the_hand_is_unknown_and_far_ones_are_background() -> None:
    image, labels = scene()
    labels[labels == OBJECT_LABEL] = 0
    away = cv2.distanceTransform((labels != HAND_LABEL).astype(np.uint8), cv2.DIST_L2, 5)
    image[:20, :20] = THING
    found = uncertain(image, labels)
    slit = (image == THING).all(axis=-1) & (away < 0.09 * hand_size_px(JOINTS))
    assert found[slit].mean() > 0.6
    assert not found[:20, :20].any()
    assert not found[(image == GROUND).all(axis=-1)].any()


def test_background_along_a_finger_is_unknown_in_any_colour_since_the_finger_may_hide_the_object() -> None:
    image, labels = scene()
    finger = finger_pixels(JOINTS, labels.shape, 0.05) & (labels == HAND_LABEL)
    image[finger], labels[finger] = GROUND, 0
    first, drawn = key()
    found = UncertainPixels.of_keys({0: drawn}, lambda _: first, lambda _: None, {1: JOINTS})
    hidden = found.behind_fingers(1, labels)
    assert hidden[finger].all()
    assert not hidden[~finger_pixels(JOINTS, labels.shape) | (labels != 0)].any()
    assert not found.behind_fingers(2, labels).any()


def test_what_is_drawn_as_the_object_stays() -> None:
    image, labels = scene()
    found = UncertainPixels.of_keys({1: labels}, lambda _: image, lambda _: None, {1: JOINTS}).find(1, labels, image)
    assert not found[labels == OBJECT_LABEL].any()


def test_without_landmarks_or_colours_nothing_is_uncertain() -> None:
    image, labels = scene()
    first, drawn = key()
    assert not UncertainPixels.of_keys({0: drawn}, lambda _: first, lambda _: None, {}).find(1, labels, image).any()
    none = UncertainPixels.of_keys({0: 0 * drawn}, lambda _: first, lambda _: None, {1: JOINTS})
    assert not none.find(1, labels, image).any()
