"""A synthetic video of a hand and a thing that move together, and what a person would click on it."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic

WIDTH, HEIGHT = 320, 240
FRAMES = 14
RADIUS = 40.0
K = np.array([[320.0, 0.0, 160.0], [0.0, 320.0, 120.0], [0.0, 0.0, 1.0]])
"""The camera that is guessed where nothing is known."""


def shift(n: int) -> np.ndarray:
    """How far all has moved in a frame [px]."""
    return np.array([3.0 * n, 1.0 * n])


def write_scene(path: Path, frames: int = FRAMES) -> Path:
    """A disc with spots that moves before a table with spots."""
    rng = np.random.default_rng(0)
    table = cv2.GaussianBlur(rng.integers(90, 220, (HEIGHT, WIDTH, 3)).astype(np.uint8), (0, 0), 2)
    cloth = cv2.GaussianBlur(rng.integers(0, 120, (120, 120, 3)).astype(np.uint8), (0, 0), 1.5)
    cloth[..., 0] //= 4
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 30)
        stream.codec_context.options = {"crf": "12", "preset": "veryfast"}
        v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        for n in range(frames):
            centre = middle(n)
            inside = np.hypot(u - centre[0], v - centre[1]) < RADIUS
            x, y = (np.stack([u, v]) - centre[:, None, None] + 60.0).astype(int).clip(0, 119)
            image = np.where(inside[..., None], cloth[y, x], table).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return path


def middle(n: int) -> np.ndarray:
    """Where the disc is [px]."""
    return np.array([130.0, 110.0]) + shift(n)


def circle(n: int, corners: int = 16) -> list[list[float]]:
    """A polygon around the disc."""
    angle = 2 * np.pi * np.arange(corners) / corners
    return [[round(float(x), 2) for x in middle(n) + RADIUS * np.array([np.cos(a), np.sin(a)])] for a in angle]


def joints(n: int) -> list[list[float]]:
    """A left hand's 21 joints [px]."""
    hand = generic.load("left").with_shape().with_pose().joints
    R = se3.exp_so3(np.array([0.3, 0.2, -0.4]))
    X = hand @ R.T + np.array([0.0, 0.0, 0.6]) - R @ hand.mean(axis=0)
    return [[round(float(x), 2) for x in point + shift(n) - 20.0] for point in project(K, X)]
