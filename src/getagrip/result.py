"""A reconstruction: the object in the hand, in every frame. The folder format is fixed (see docs/formats.md)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxtyping import Float
from numpy import ndarray


@dataclass(frozen=True)
class Axis:
    """The latent axis of a 1-DoF motion, in the hand frame, and the angle about it in each frame (Eq. 3)."""

    point: Float[ndarray, "3"]
    direction: Float[ndarray, "3"]
    angle: Float[ndarray, "T"]


@dataclass(frozen=True)
class Candidates:
    """The best distinct solutions, best first; the first is the result."""

    T_hand_obj: Float[ndarray, "K T 4 4"]
    scale: Float[ndarray, "K"]
    energy: Float[ndarray, "K"]


@dataclass(frozen=True)
class Reconstruction:
    """What a method found for one clip."""

    clip: str
    """Name of the clip."""
    method: str
    frames: tuple[str, ...]
    T_hand_obj: Float[ndarray, "T 4 4"]
    scale: float
    iou: Float[ndarray, "T"]
    """Mask IOU of each frame on the full image, outside ignored pixels."""
    axis: Axis | None
    candidates: Candidates
    energy: dict[str, float]
    """``total`` and one entry per term."""
    status: str
    """What happened, in words."""
    ambiguous: bool
    """Whether another, distinct candidate explains the masks almost as well."""
    seconds: dict[str, float]
    """``total`` and one entry per stage."""
    options: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    notes: tuple[str, ...] = ()
    """Dropped frames and guesses (scale, focal length), in words."""


def read_result(folder: str | Path) -> tuple[Reconstruction, dict[str, Any]]:
    """Read and check a result folder: the reconstruction, and ``result.json`` as it stands."""
    raise NotImplementedError


def write_result(result: Reconstruction, folder: str | Path, input_sha256: str, metrics: dict[str, Any] | None = None) -> Path:
    """Write a result folder, complete or not at all."""
    raise NotImplementedError
