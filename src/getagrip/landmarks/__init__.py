"""Hands in images: MediaPipe's palm detector and hand landmarks, without its package; hands followed over a clip."""

from getagrip.landmarks.following import Sighting, follow
from getagrip.landmarks.handedness import Side, compared
from getagrip.landmarks.masks import hand_mask
from getagrip.landmarks.models import fetch, load
from getagrip.landmarks.second_look import look_again
from getagrip.landmarks.selecting import HandLandmarks, select

__all__ = [
    "HandLandmarks",
    "Side",
    "Sighting",
    "compared",
    "fetch",
    "follow",
    "hand_mask",
    "load",
    "look_again",
    "select",
]
