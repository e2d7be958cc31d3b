"""Hands in a video: MediaPipe's palm detector and hand landmarks without its package, tracking, lifting and masks."""

from getagrip.studio.hands.hand_pixels import hand_mask
from getagrip.studio.hands.hand_selection import HandLandmarks, Side, select_hand, unbiased_log_odds
from getagrip.studio.hands.hand_tracking import Sighting, track_hands
from getagrip.studio.hands.networks import download_models, load_models
from getagrip.studio.hands.redetect import redetect_hand

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
