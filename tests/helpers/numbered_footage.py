"""Footage whose frames show their own number."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

BITS = 8
FRAMES = 70


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


def write_video(path: Path, times: Sequence[int] | None = None, fps: int = 30, frames: int = FRAMES) -> Path:
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
