"""Errors of a tracker's hand in each frame of a clip: curves, drawn from ``Noise`` or measured.

The measures are robust: medians over frames and over clips, so that they describe the usual clip. What is far outside a
clip's own jitter is counted apart, as outliers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.grasps.motion import correlation_time
from getagrip.grasps.study import Measure

if TYPE_CHECKING:
    from getagrip.datasets.synthetic.noise import Noise

OUTSIDE = 4.0
"""Distance of an outlier's rotation from the clip's median, in units of the usual jitter about one axis."""
ROBUST = 1.4826
"""A normal distribution's standard deviation, in medians of its magnitude."""
_DEGREES, _MM = float(np.degrees(1.0)), 1e3
ERROR_MEASURES = {
    "turn_bias": Measure("rotation, the same in all frames", "deg", _DEGREES),
    "turn_jitter": Measure("rotation, frame by frame (rms)", "deg", _DEGREES),
    "across_bias": Measure("place across the view, the same in all frames", "mm", _MM),
    "across_jitter": Measure("place across the view, frame by frame (rms)", "mm", _MM),
    "depth_bias": Measure("depth, the same in all frames", "mm", _MM),
    "depth_jitter": Measure("depth, frame by frame (rms)", "mm", _MM),
    "finger_bias": Measure("bend of each finger joint, the same in all frames (rms)", "deg", _DEGREES),
    "finger_jitter": Measure("bend of each finger joint, frame by frame (rms)", "deg", _DEGREES),
    "memory": Measure("correlation time of the rotation", "s", 1.0),
}
"""Measures of a clip's errors, by name; shown in these units, stored in SI units."""
SHARES = {
    "spread": Measure("spread over clips of the logarithm of these errors (standard deviation)", "", 1.0),
    "outlier_share": Measure("frames with outliers", "%", 100.0),
    "outlier_times": Measure("outliers, in jitters", "", 1.0),
    "outlier_s": Measure("duration of a run of outliers, mean", "s", 1.0),
}
"""Measures over all clips."""


@dataclass(frozen=True)
class ErrorCurves:
    """A hand's errors over T frames.

    Attributes:
        turn: (T, 3) rotation vector of the hand about its middle [rad].
        shift: (T, 3) how far its middle is off [m]; the last number is along the camera's ray.
        bends: (T, 5, 3) how much more each finger's joints are bent, from the palm to the tip [rad].
    """

    turn: Float[ndarray, "T 3"]
    shift: Float[ndarray, "T 3"]
    bends: Float[ndarray, "T 5 3"]


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

    @property
    def curves(self) -> ErrorCurves:
        """Curves as they are measured: shifts in the hand frame have no direction of their own."""
        shift = self.shift.copy()
        shift[:, 2:] += self.deeper
        return ErrorCurves(self.turn, shift, self.bends)


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


def measure(clips: Sequence[ErrorCurves], fps: float) -> dict[str, float]:
    """Compute ``ERROR_MEASURES``, medians over clips, and ``SHARES``. No clip may be without jitter."""
    rows, outside, beyond, runs = [], list[Bool[ndarray, "_"]](), list[Float[ndarray, "_"]](), list[int]()
    for clip in clips:
        bends = clip.bends.reshape(len(clip.bends), -1)
        (turn, turns), (across, acrosses), (depth, depths), (bend, bendings) = (
            _parts(x) for x in (clip.turn, clip.shift[:, :2], clip.shift[:, 2:], bends)
        )
        sigma = ROBUST * np.median(np.abs(turns))
        jitters = np.linalg.norm(turns, axis=1) / sigma
        out = jitters > OUTSIDE
        outside.append(out)
        beyond.append(jitters[out] / np.sqrt(3.0))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], out, [0]])))
        runs += list(edges[1::2] - edges[::2])
        rows.append(
            {
                "turn_bias": np.linalg.norm(turn),
                "turn_jitter": np.sqrt(3.0) * sigma,
                "across_bias": np.linalg.norm(across),
                "across_jitter": np.sqrt(2.0) * ROBUST * np.median(np.abs(acrosses)),
                "depth_bias": np.abs(depth[0]),
                "depth_jitter": ROBUST * np.median(np.abs(depths)),
                "finger_bias": ROBUST * np.median(np.abs(bend)),
                "finger_jitter": ROBUST * np.median(np.abs(bendings)),
                "memory": correlation_time(np.where(out[:, None], 0.0, turns), fps),
            }
        )
    found = {name: np.array([row[name] for row in rows]) for name in ERROR_MEASURES}
    spread = [np.log(found[name]).std() for name in ("turn_bias", "turn_jitter", "across_jitter", "finger_bias")]
    far = np.concatenate(beyond)
    return {name: float(np.median(x)) for name, x in found.items()} | {
        "spread": float(np.mean(spread)),
        "outlier_share": float(np.concatenate(outside).mean()),
        "outlier_times": float(np.sqrt(np.mean(far**2))) if far.size else 1.0,
        "outlier_s": float(np.mean(runs)) / fps if runs else 0.0,
    }


def _parts(x: Float[ndarray, "T k"]) -> tuple[Float[ndarray, "k"], Float[ndarray, "T k"]]:
    """Split into what all frames share, and the rest."""
    middle = np.median(x, axis=0)
    return middle, x - middle


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
