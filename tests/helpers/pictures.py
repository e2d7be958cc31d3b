"""What a picture shows: its pixels of a known colour."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import to_rgb


def read_picture(path: Path) -> np.ndarray:
    """The picture as (H, W, 3) RGB."""
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture[..., ::-1]


def pixels_of(picture: np.ndarray, colour: str) -> int:
    """The number of pixels that have nearly this colour."""
    return int((np.abs(picture / 255.0 - to_rgb(colour)).max(axis=-1) < 0.06).sum())
