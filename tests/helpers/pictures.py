"""What a picture shows: its words, its parts, its pixels of a known colour."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text


def read_picture(path: Path) -> np.ndarray:
    """The picture as (H, W, 3) RGB."""
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture[..., ::-1]


def pixels_of(picture: np.ndarray, colour: str) -> int:
    """The number of pixels that have nearly this colour."""
    near = np.ones(picture.shape[:2], dtype=bool)
    for channel, value in zip(np.moveaxis(picture, -1, 0), to_rgb(colour), strict=True):
        near &= (np.abs(np.arange(256) / 255.0 - value) < 0.06)[channel]
    return int(near.sum())


def texts(figure: Figure) -> set[str]:
    """All that is written in a figure."""
    return {text.get_text() for text in figure.findobj(Text)} - {""}


def pixels(figure: Figure) -> np.ndarray:
    """The figure as (H, W, 3) RGB."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]


def panel(picture: np.ndarray, axes: Axes) -> np.ndarray:
    """The part of the picture that some axes take."""
    height, width, _ = picture.shape
    box = axes.get_position()
    rows = slice(int((1.0 - box.y1) * height), int((1.0 - box.y0) * height))
    return picture[rows, int(box.x0 * width) : int(box.x1 * width)]
