"""Hands that were found in a video before anybody clicked: joints in every frame, and the hand's masks.

A folder ``found`` beside the marks holds ``hand.npz``, whose ``frames`` are places from 1 and whose
``joints_2d`` (T, 21, 2) [px] are drawn, and ``masks/<number>.png``, non-zero where the hand is visible. Both are
optional.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.annotate.footage import MAX_FOOTAGE_SIDE_PX
from getagrip.errors import InputError
from getagrip.io import arrays, files
from getagrip.io.images import decode_image

DETECTED_HANDS_FOLDER = "found"
"""Beside the marks."""
DRAFTS_FOLDER = "drafts"
"""Beside the marks of several videos: a folder for each, of its draft."""


@dataclass(frozen=True)
class HandDetectionFiles:
    """The contents of the folder."""

    folder: Path

    @property
    def path(self) -> Path:
        """The hand file; it need not exist."""
        return self.folder / "hand.npz"

    @cached_property
    def joints(self) -> dict[int, Float[ndarray, "21 2"]]:
        """By frame from 0, NaN where a joint was not found [px]. Raises ``InputError`` for a malformed file."""
        if not self.path.is_file():
            return {}
        content = arrays.read(self.path, lambda name: name in ("joints_2d", "frames"))
        frames = arrays.frame_numbers(self.path, content)
        if "joints_2d" not in content or frames is None:
            return {}
        points = content["joints_2d"]
        if points.shape != (len(frames), 21, 2):
            raise InputError(self.path, "joints_2d", f"an array of shape {points.shape}", f"({len(frames)}, 21, 2)")
        seen = np.isfinite(points).all(axis=-1).any(axis=-1)
        return {n - 1: each for n, each, there in zip(frames, points.astype(float), seen, strict=True) if there}

    def mask(self, frame: int) -> Bool[ndarray, "H W"] | None:
        """Return the visible pixels of the hand in a frame, from 0; None without a mask file. Raises ``InputError``."""
        path = self.folder / "masks" / f"{frame + 1:06d}.png"
        if not path.is_file():
            return None
        image = decode_image(path, "", files.read_bytes(path), MAX_FOOTAGE_SIDE_PX)
        return np.asarray(image.reshape(*image.shape[:2], -1).any(axis=-1))

    @cached_property
    def word(self) -> str:
        """A checksum that changes when the files do."""
        there = sorted(self.folder.rglob("*")) if self.folder.is_dir() else []
        about = [(each.name, each.stat().st_size, each.stat().st_mtime_ns) for each in there]
        return sha256(repr(about).encode()).hexdigest()[:16] if about else ""
