"""Errors of a tracker's hand in each frame of a clip: curves, drawn from ``Noise``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

if TYPE_CHECKING:
    from getagrip.datasets.synthetic.noise import Noise


@dataclass(frozen=True)
class Drawn:
    """Errors as ``noisy_hand`` applies them.

    Attributes:
        turn: (T, 3) rotation vector about the hand's middle [rad].
        shift: (T, 3) translation in the hand frame [m].
        deeper: (T, 1) translation along the camera's ray [m].
        bends: (T, 5, 3) further bend of each finger's joints [rad].
    """

    turn: Float[ndarray, "T 3"]
    shift: Float[ndarray, "T 3"]
    deeper: Float[ndarray, "T 1"]
    bends: Float[ndarray, "T 5 3"]


def draw(noise: Noise, frames: int, fps: float, rng: np.random.Generator) -> Drawn:
    """Draw the errors of a clip. The same generator draws the same errors, larger or smaller, for every noise."""
    # Generators of their own: hands err alike whatever their depth, fingers and outliers do.
    depth, fingers, levels, bursts = rng.spawn(4)
    a = float(np.exp(-1.0 / (fps * noise.jitter_memory_s))) if noise.jitter_memory_s > 0.0 else 0.0
    bias, jitter = np.exp(noise.spread * levels.normal(size=(2, 4)))
    first = _outliers(noise, frames, fps, bursts)

    def wander(white: Float[ndarray, "T k"], rms: float, kind: int) -> Float[ndarray, "T k"]:
        far = bursts.normal(size=white.shape)[first]  # one error throughout a burst
        times = np.where(first < 0, 0.0, noise.outlier_times)
        return rms * jitter[kind] * (_lasting(white, a) + times[:, None] * far)

    turn = bias[0] * _of_length(rng.normal(size=3), np.radians(noise.hand_bias_deg))
    shift = bias[1] * _of_length(rng.normal(size=3), 1e-3 * noise.hand_bias_mm)
    turn = turn + wander(rng.normal(size=(frames, 3)), np.radians(noise.hand_jitter_deg) / np.sqrt(3.0), 0)
    shift = shift + wander(rng.normal(size=(frames, 3)), 1e-3 * noise.hand_jitter_mm / np.sqrt(3.0), 1)
    deeper = bias[2] * 1e-3 * noise.hand_bias_depth_mm * depth.choice([-1.0, 1.0])
    deeper = deeper + wander(depth.normal(size=(frames, 1)), 1e-3 * noise.hand_jitter_depth_mm, 2)
    bends = bias[3] * np.radians(noise.finger_bias_deg) * fingers.normal(size=15)
    bends = bends + wander(fingers.normal(size=(frames, 5, 3)).reshape(-1, 15), np.radians(noise.finger_jitter_deg), 3)
    return Drawn(turn, shift, deeper, bends.reshape(-1, 5, 3))


def _outliers(noise: Noise, frames: int, fps: float, rng: np.random.Generator) -> Int[ndarray, "T"]:
    """Draw the first frame of the burst of outliers that each frame is in; -1 of those in none.

    Bursts come and go as a chain of two states, with the noise's share of frames and mean duration.
    """
    stay = max(0.0, 1.0 - 1.0 / max(1.0, noise.outlier_s * fps))
    enter = (1.0 - stay) * noise.outlier_share / max(1.0 - noise.outlier_share, 1e-9)
    u, first = rng.random(frames), np.full(frames, -1)
    for n in range(frames):
        inside = n > 0 and first[n - 1] >= 0
        chance = stay if inside else enter if n else noise.outlier_share
        if u[n] < chance:
            first[n] = first[n - 1] if inside else n
    return first


def _lasting(white: Float[ndarray, "T k"], a: float) -> Float[ndarray, "T k"]:
    """White noise of unit variance made into a first-order autoregressive process of unit variance."""
    out = white.copy()
    for n in range(1, len(out)):
        out[n] = a * out[n - 1] + np.sqrt(1.0 - a * a) * white[n]
    return out


def _of_length(v: Float[ndarray, "3"], length: float) -> Float[ndarray, "3"]:
    return np.asarray(v / np.linalg.norm(v) * length)
