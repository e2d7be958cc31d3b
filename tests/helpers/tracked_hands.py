"""Hands from estimators' files: what tests of them ask for and look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.readers.trackers import Request, TrackedHands
from helpers.estimator_files import (
    FRAMES,
    SIZE,
    K,
)

SIDES: list[Side] = ["right", "left"]


def request(side: Side, folder: Path | None = None) -> Request:
    return Request(side, FRAMES, np.tile(K, (3, 1, 1)), SIZE, folder)


def joints_of(hands: TrackedHands) -> ndarray:
    assert hands.track.joints is not None
    return se3.transform(hands.track.T_cam_hand, hands.track.joints)
