"""A result as a film: over its images and turned, side by side, as fast as the clip.

A timeline is not turned but shown in the world, with a bar of its segments.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.fitting.methods import method_of
from getagrip.io.videos import write_video
from getagrip.view.curves import seconds
from getagrip.view.shown import View
from getagrip.view.stills import overlay, steady_windows, turned
from getagrip.view.style import INK
from getagrip.view.world import Stage, captioned, font, segment_bar

SIDE, STRIP, MARGIN = 540, 36, 12
"""Side of the two pictures, height of the line of words under them, and what is left free around it [px]."""
SLOWEST, FASTEST = 1.0, 120.0
"""Frames per second."""


def write_film(view: View, path: Path) -> Path:
    """Write all frames of a result as MP4 (H.264) and return its path.

    Raises ``InputError`` for an image that cannot be read, ``GetagripError`` where PyAV has no encoder for H.264.
    """
    in_world = bool(view.clip.segments) and view.clip.world is not None
    pictures = _timeline(view) if in_world else _pictures(view)
    write_video(path, pictures, _rate(view), (2 * SIDE, SIDE + STRIP * (1 + in_world)))
    return path


def _rate(view: View) -> Fraction:
    """Frames per second; fewer than the clip's where the result has only some of its frames."""
    times = seconds(view)
    lasts = float(times[-1] - times[0])
    rate = (len(times) - 1) / lasts if lasts > 0.0 else view.clip.fps
    return Fraction(float(np.clip(rate, SLOWEST, FASTEST))).limit_denominator(1001)


def _pictures(view: View) -> Iterator[UInt8[ndarray, "H W 3"]]:
    crops = steady_windows(view, SIDE)
    for n, under in enumerate(_under(view)):
        pair = np.concatenate([overlay(view, n, crops, n), turned(view, n, crops, n)], axis=1)
        yield np.concatenate([pair, _words(under)])


def _timeline(view: View) -> Iterator[UInt8[ndarray, "H W 3"]]:
    crops, stage = steady_windows(view, SIDE), Stage.of(view, SIDE)
    for n, under in enumerate(_under(view)):
        seen, placed = (
            captioned(overlay(view, n, crops, n), "from the camera"),
            captioned(stage.picture(n), "in the world"),
        )
        pair = np.concatenate([seen, placed], axis=1)
        bar = segment_bar(view, n, (2 * SIDE, STRIP))
        yield np.concatenate([pair, bar, _words(under)])


def _under(view: View) -> Iterator[str]:
    """The line of words under each frame."""
    result, clip = view.result, view.clip
    shared = [method_of(result.method).label, *["scale is a guess"] * (clip.scale == "free")]
    shared += ["shape is a guess"] * (result.warp is not None)
    shared += ["ambiguous"] * result.ambiguous
    for name, kind in zip(result.frames, result.frame_kind, strict=True):
        yield "  ·  ".join([f"frame {name}", *[kind] * (kind == "interpolated"), *shared, clip.name])


def _words(words: str) -> UInt8[ndarray, "STRIP W 3"]:
    """A line of words, cut where it is too long."""
    from PIL import Image, ImageDraw

    strip = Image.new("RGB", (2 * SIDE, STRIP), "white")
    draw = ImageDraw.Draw(strip)
    draw.text((MARGIN, STRIP / 2), words, fill=INK, font=font(STRIP // 2), anchor="lm")
    return np.asarray(strip)
