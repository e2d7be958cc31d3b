"""Hands in images: MediaPipe's palm detector and hand landmarks, without its package; hands followed over a clip."""

from getagrip.landmarks.following import Sighting, track_hands
from getagrip.landmarks.handedness import Side, unbiased_log_odds
from getagrip.landmarks.masks import hand_mask
from getagrip.landmarks.models import download_models, load_models
from getagrip.landmarks.second_look import redetect_hand
from getagrip.landmarks.selecting import HandLandmarks, select_hand

__all__ = [
    "HandLandmarks",
    "Side",
    "Sighting",
    "download_models",
    "hand_mask",
    "load_models",
    "redetect_hand",
    "select_hand",
    "track_hands",
    "unbiased_log_odds",
]
