"""How far trackers' hands are off, measured: by what ``Noise`` was set, and what is drawn from it must have.

The measures are robust: medians over frames and over clips, so that they describe the usual clip. What is far outside a
clip's own jitter is counted apart, as outliers.

Grasps to learn initial poses from.

Scores of which every metric in the tables of benchmarks has the same value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.bench.comparison import GraspVariantScore
from getagrip.clip import Clip
from getagrip.fitting.options import Options, PriorsFile
from getagrip.fitting.solver import initial_poses as priors
from getagrip.fitting.solver.cluster_poses import learn_pose_priors, true_grasp_pose
from getagrip.geometry import se3
from getagrip.synthetic.noise import DrawnHandErrors
from helpers.clips import small_clip


def rotations(n: int, seed: int = 0) -> ndarray:
    return se3.from_quaternion(np.random.default_rng(seed).normal(size=(n, 4)))


def held(name: str, subject: str = "", seed: int = 0, category: str = "box") -> Clip:
    """A clip of somebody's, in which the object is held still in some way."""
    clip = small_clip()[0]
    T_hand_obj = se3.rigid(rotations(1, seed)[0], np.array([0.01 * seed, 0.02, -0.03]))
    assert clip.truth is not None
    truth = replace(clip.truth, T_cam_obj=clip.truth.T_cam_hand @ T_hand_obj)
    return replace(clip, name=name, category=category, truth=truth, provenance={"subject": subject} if subject else {})


def old_file(path: Path, *clips: Clip) -> Options:
    """Options with a file of the first version, which holds poses learnt from some clips."""
    learnt = learn_pose_priors([true_grasp_pose(clip) for clip in clips], k=10)
    names = {name: np.array(getattr(learnt, name), np.str_) for name in priors.PRIOR_NAME_KEYS}
    np.savez(path, version=np.array(1), T_hand_obj=learnt.T_hand_obj, **names)  # type: ignore[arg-type]
    return Options(init="clusters", priors=PriorsFile(path), inits=12)


def score(variant: str, value: float, failed: bool = False) -> GraspVariantScore:
    """A score of which every metric in the tables has the same value."""
    kinds = ("sca", "truth_sca", "sca_add", "sca_add_sym", "sca_iou_80", "sca_iou_60")
    keys = ["iou", "add_success", "add_sym_success", *(f"{kind}_object_10mm" for kind in kinds)]
    return GraspVariantScore(variant, {} if failed else dict.fromkeys(keys, value), 1.0, 2.0, False, "stopped", failed)


OUTSIDE = 4.0
"""Distance of an outlier's rotation from the clip's median, in units of the usual jitter about one axis."""
ROBUST = 1.4826
"""A normal distribution's standard deviation, in medians of its magnitude."""
ERROR_MEASURES = (
    "turn_bias",
    "turn_jitter",
    "across_bias",
    "across_jitter",
    "depth_bias",
    "depth_jitter",
    "finger_bias",
    "finger_jitter",
    "memory",
)
"""Of a clip, in SI units; bias is the same in all frames, jitter frame by frame (root mean square)."""


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

    @staticmethod
    def of(drawn: DrawnHandErrors) -> ErrorCurves:
        """Curves as they are measured: shifts in the hand frame have no direction of their own."""
        shift = drawn.shift.copy()
        shift[:, 2:] += drawn.deeper
        return ErrorCurves(drawn.turn, shift, drawn.bends)


def measure(clips: Sequence[ErrorCurves], fps: float) -> dict[str, float]:
    """``ERROR_MEASURES``, medians over clips, and of all clips ``spread`` (standard deviation of the logarithms), the
    share of frames with outliers, how large these are in jitters, and how long they last [s].

    No clip may be without jitter.
    """
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


def correlation_time(x: Float[ndarray, "N 3"], fps: float) -> float:
    """Measure the lag at which a curve's autocorrelation first falls to 1/e [s], linear between frames.

    At most half of it.
    """
    x = x - x.mean(axis=0)
    lags = np.arange(len(x) // 2)
    product = np.array([np.mean(np.sum(x[: len(x) - lag] * x[lag:], axis=1)) for lag in lags])
    if product[0] <= 0.0:
        return float("nan")
    correlation = product / product[0]
    below = np.flatnonzero(correlation < np.exp(-1.0))
    if not below.size:
        return float(lags[-1] / fps)
    k = int(below[0])
    part = (correlation[k - 1] - np.exp(-1.0)) / (correlation[k - 1] - correlation[k])
    return float((k - 1 + part) / fps)
