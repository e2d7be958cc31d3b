"""A synthetic video of a hand and a thing that move together, and what a person would click on it.

Networks that see the hand of ``labelled_scene`` where it is in the first frame, or in its mirror image.

Footage whose frames show their own number.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.studio.hands.networks import HandCrop, HandNetOutput, Nets, Palm

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


POINTS = np.array(joints(0))


class SceneNets(Nets):
    """A left hand, detected in every frame, or nothing at all."""

    def __init__(self, hands: bool = True) -> None:
        super().__init__(lambda image: [], lambda image: [], "made up")
        object.__setattr__(self, "hands", hands)

    def palms(self, image: np.ndarray, fill: float = 1.0) -> list[Palm]:
        points = np.tile(POINTS[0], (7, 1))
        points[2] = POINTS[9]
        box = np.concatenate([POINTS[[0, 5, 17]].min(axis=0), POINTS[[0, 5, 17]].max(axis=0)])
        return [Palm(box, points, 0.9)] if self.hands else []  # type: ignore[attr-defined]

    def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        return HandNetOutput(POINTS, np.full((21, 3), np.nan), 0.95, 0.01)

    def mirrored(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        return self.landmarks(image, crop)._replace(right=0.99)


BITS = 8
NUMBERED_FRAMES = 70


def picture(number: int) -> np.ndarray:
    """An image that shows a number as a row of black and white fields."""
    image = np.full((64, 32 * BITS, 3), 90, np.uint8)
    for bit in range(BITS):
        image[:, 32 * bit : 32 * (bit + 1)] = 235 if number >> bit & 1 else 20
    return image


def number_in(jpeg: bytes) -> int:
    """The number that an image shows."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    fields = np.array_split(image, BITS, axis=1)
    return sum(1 << bit for bit, field in enumerate(fields) if field.mean() > 127)


def write_video(path: Path, times: Sequence[int] | None = None, fps: int = 30, frames: int = NUMBERED_FRAMES) -> Path:
    """A video with B-frames and a key frame every 23 frames, shown at some times [1/fps s], from 37 on by default."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.width, stream.height, stream.pix_fmt = 32 * BITS, 64, "yuv420p"
        stream.codec_context.time_base = Fraction(1, fps)
        stream.codec_context.options = {"bf": "3", "g": "23", "preset": "veryfast", "x264-params": "b-adapt=0"}
        for n, pts in zip(range(frames), times or range(37, 37 + frames), strict=False):
            frame = av.VideoFrame.from_ndarray(picture(n), format="rgb24")
            frame.pts, frame.time_base = pts, Fraction(1, fps)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_images(folder: Path, numbers: Sequence[int]) -> Path:
    """A folder of images in EPIC-KITCHENS' manner, each showing its number's last bits."""
    folder.mkdir(parents=True)
    for n in numbers:
        cv2.imwrite(str(folder / f"frame_{n:010d}.jpg"), picture(n % (1 << BITS)))
    return folder
