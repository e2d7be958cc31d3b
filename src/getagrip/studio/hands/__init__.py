"""Hands in a video: MediaPipe's palm detector and hand landmarks without its package, tracking, lifting and masks."""

from getagrip.studio.hands.hand_pixels import hand_mask
from getagrip.studio.hands.hand_selection import HandLandmarks, Side, unbiased_log_odds
from getagrip.studio.hands.hand_tracking import Sighting
from getagrip.studio.hands.networks import download_models, load_models

__all__ = ["HandLandmarks", "Side", "Sighting", "download_models", "hand_mask", "load_models", "unbiased_log_odds"]
