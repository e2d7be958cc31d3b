"""Measure how far hands that were estimated from images are off, for the noise level ``estimated``.

    python scripts/convert/artigrasp.py ARTIGRASP TRACKS --estimated
    getagrip import tracks TRACKS --shortest 20 --out CLIPS
    python -m benchmarks.hand_errors measure TRACKS CLIPS/grasps.json
    python -m benchmarks.hand_errors table

The first reads true and estimated joints of ARCTIC's s05 (``scripts/convert/artigrasp.py``) in the frames in which both
hands are in a grasp. It writes numbers over all of them to ``datasets/synthetic/estimated_hands.json``: the measures,
and the ``Noise`` whose errors, drawn for clips of the same lengths, have the same measures. The second puts a table of
the measures of all noise levels into docs/datasets.md.

The object's place is not among the estimates, so hands are compared with each other: where a hand is off is taken to be
the difference of both hands' errors over the square root of two, as it is where they err independently.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import page
from getagrip.datasets.arctic import FPS
from getagrip.datasets.synthetic.error_curves import ERROR_MEASURES, SHARES, ErrorCurves, draw, measure
from getagrip.datasets.synthetic.noise import NOISE, TABLE, Noise
from getagrip.datasets.track_files import read_motion
from getagrip.experiments.stamp import stamp
from getagrip.geometry import se3
from getagrip.grasps import lists
from getagrip.grasps.lists import BETWEEN, GraspList
from getagrip.grasps.study import Measure
from getagrip.hands import generic
from getagrip.hands.bending import CHAINS, bent, hinges
from getagrip.hands.model import Side

SHORTEST = 20
"""Frames that both hands are in a grasp."""
PALM = [0, 5, 9, 13, 17]
"""Joints that move with the hand: the wrist and the knuckles."""
INDEX, PINKY = 5, 17
SECTION = "noise-levels"
FITTED = {
    "turn_bias": "hand_bias_deg",
    "turn_jitter": "hand_jitter_deg",
    "across_bias": "hand_bias_mm",
    "across_jitter": "hand_jitter_mm",
    "depth_bias": "hand_bias_depth_mm",
    "depth_jitter": "hand_jitter_depth_mm",
    "finger_bias": "finger_bias_deg",
    "finger_jitter": "finger_jitter_deg",
    "memory": "jitter_memory_s",
    "spread": "spread",
}
"""The field of ``Noise`` that each measure depends on most."""
TAKEN = ("outlier_share", "outlier_times", "outlier_s")
"""Measures that are fields of ``Noise`` as they are."""
ALIGNED = Measure("joints after the best similarity (PA-MPJPE), median over frames", "mm", 1e3)
CLOSED = np.radians(35.0)
"""How far each joint is bent of the hand that drawn bends are tried on."""
DRAWS, ROUNDS, DAMPING = 600, 15, 0.7
"""Clips drawn in each round of the fit; how far a round goes."""


@dataclass(frozen=True)
class HandErrors:
    """The errors of a hand over a grasp."""

    curves: ErrorCurves
    aligned: Float[ndarray, "T"]
    """Mean distance of its joints from the true ones after the best similarity (PA-MPJPE) [m]."""


def hands(root: Path, grasps: GraspList) -> Iterator[HandErrors]:
    """The errors of each hand while both hold the object."""
    for file in sorted(root.glob("*.npz")):
        of = read_motion(file, print)
        if of is None or of.camera is None:
            continue
        true, estimated = (
            {side: se3.transform(of.camera.T_cam_world, joints) for side, joints in hands.items()}
            for hands in (of.joints, of.estimated)
        )
        off = {side: (estimated[side] - true[side]).mean(axis=1) for side in true}
        apart = (off["left"] - off["right"]) / np.sqrt(2.0)
        held = {side: _held(of.subject, of.sequence, of.category, side, of.numbers, grasps) for side in true}
        for first in held["left"]:
            for second in held["right"]:
                rows = np.intersect1d(first, second)
                if len(rows) >= SHORTEST:
                    for side in true:
                        joints, given = true[side][rows], estimated[side][rows]
                        yield HandErrors(_curves(joints, given, apart[rows]), aligned_error(joints, given))


def _held(subject: str, sequence: str, category: str, side: Side, numbers: ndarray, grasps: GraspList) -> list[ndarray]:
    """Rows of the frames of each grasp of a hand."""
    name, frames = BETWEEN.join([subject, sequence, category, side]), [f"{n:06d}" for n in numbers]
    return [grasp.positions(frames, 0) for grasp in grasps.of(name, side, category)]


def _curves(
    true: Float[ndarray, "T 21 3"], given: Float[ndarray, "T 21 3"], apart: Float[ndarray, "T 3"]
) -> ErrorCurves:
    """Errors of joints in the camera frame, and of the hand's place in its axes."""
    w = se3.log_so3(_turn(true, given))
    since = _turn(np.broadcast_to(true[0], true.shape), true)  # the hand's own motion
    ray = true.mean(axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    across = np.stack([np.cross([0.0, 1.0, 0.0], ray), ray], axis=1)
    across[:, 0] /= np.linalg.norm(across[:, 0], axis=1, keepdims=True)
    axes = np.stack([across[:, 0], np.cross(ray, across[:, 0]), ray], axis=1)
    shift = (axes @ apart[..., None])[..., 0]
    bends = _bends(given) - _bends(true)
    return ErrorCurves(
        (np.swapaxes(since, 1, 2) @ w[..., None])[..., 0], shift, (bends + np.pi) % (2.0 * np.pi) - np.pi
    )


def aligned_error(true: Float[ndarray, "T 21 3"], given: Float[ndarray, "T 21 3"]) -> Float[ndarray, "T"]:
    """Mean distance of joints after the best similarity, by frame [m]."""
    a, b = (x - x.mean(axis=1, keepdims=True) for x in (given, true))
    a = a @ np.swapaxes(_turn(a, b, list(range(21))), 1, 2)
    scale = np.sum(a * b, axis=(1, 2)) / np.sum(a * a, axis=(1, 2))
    return np.asarray(np.linalg.norm(scale[:, None, None] * a - b, axis=-1).mean(axis=1))


def _turn(a: Float[ndarray, "T 21 3"], b: Float[ndarray, "T 21 3"], of: list[int] = PALM) -> Float[ndarray, "T 3 3"]:
    """The rotations that bring some joints a nearest to the joints b (Kabsch)."""
    a, b = (x[:, of] - x[:, of].mean(axis=1, keepdims=True) for x in (a, b))
    U, _, Vt = np.linalg.svd(np.swapaxes(b, 1, 2) @ a)
    signs = np.ones((len(a), 3))
    signs[:, 2] = np.linalg.det(U @ Vt)
    return np.asarray(U @ (signs[..., None] * Vt))


def _bends(joints: Float[ndarray, "T 21 3"]) -> Float[ndarray, "T 5 3"]:
    """How far each finger's joints are bent about axes of the palm [rad]; the thumb's about its own."""
    axes = hinges(joints)
    axes[:, 1:] = (joints[:, PINKY] - joints[:, INDEX])[:, None]
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    bends = np.zeros((len(joints), 5, 3))
    for f, chain in enumerate(CHAINS):
        bones = np.diff(joints[:, [0, *chain]], axis=1)
        bones -= np.sum(bones * axes[:, f, None], axis=-1, keepdims=True) * axes[:, f, None]
        turn = np.sum(np.cross(bones[:, :-1], bones[:, 1:]) * axes[:, f, None], axis=-1)
        bends[:, f] = np.arctan2(turn, np.sum(bones[:, :-1] * bones[:, 1:], axis=-1))
    return bends


def drawn(noise: Noise, lengths: Sequence[int]) -> dict[str, float]:
    """Measures of errors that are drawn for clips of some lengths."""
    rng = np.random.default_rng(0)
    return measure([draw(noise, int(n), FPS, rng).curves for n in rng.choice(lengths, DRAWS)], FPS)


def drawn_aligned(noise: Noise, lengths: Sequence[int]) -> float:
    """Median of the aligned error that drawn bends of a half-closed hand have [m]."""
    rng = np.random.default_rng(0)
    posed = generic.load("right").with_shape().with_pose().joints[None]
    nothing = np.zeros((0, 5, 3))  # no vertices: joints alone are bent
    half = bent(np.zeros((1, 0, 3)), posed, nothing, np.full((1, 5, 3), CLOSED))[1]
    errors = []
    for n in rng.choice(lengths, DRAWS):
        true = half.repeat(n, axis=0)
        given = bent(np.zeros((n, 0, 3)), true, nothing, draw(noise, int(n), FPS, rng).bends)[1]
        errors.append(aligned_error(true, given))
    return float(np.median(np.concatenate(errors)))


def fitted(wanted: dict[str, float], lengths: Sequence[int]) -> Noise:
    """The noise whose errors have some measures.

    Bends are drawn independently, but those that were measured are not: a finger that is bent too far at one joint is
    bent too little at the next. So bends are drawn smaller than they are measured, until joints are off as far.
    """
    noise = {name: wanted[name] for name in TAKEN} | {
        field: (ERROR_MEASURES | SHARES)[name].factor * wanted[name] for name, field in FITTED.items()
    }
    for n in range(ROUNDS):
        found = drawn(Noise(**noise), lengths)
        for name, field in FITTED.items():
            noise[field] *= (wanted[name] / max(found[name], 1e-9)) ** DAMPING
        print(f"round {n + 1}: " + ", ".join(f"{name} {found[name] / wanted[name]:.2f}" for name in FITTED), flush=True)
    for _ in range(2):
        larger = wanted["aligned"] / drawn_aligned(Noise(**noise), lengths)
        noise |= {field: larger * noise[field] for field in ("finger_bias_deg", "finger_jitter_deg")}
        print(f"joints: {1.0 / larger:.2f}", flush=True)
    return Noise(**{field: float(f"{value:.3g}") for field, value in noise.items()})


def write(root: Path, grasps: Path) -> None:
    """Measure, fit, and write both into the table."""
    made = stamp()
    found = list(hands(root, lists.read(grasps)))
    lengths = [len(hand.aligned) for hand in found]
    wanted = measure([hand.curves for hand in found], FPS)
    wanted["aligned"] = float(np.median(np.concatenate([hand.aligned for hand in found])))
    noise = fitted(wanted, lengths)
    values = {field.name: value for field in fields(Noise) if (value := getattr(noise, field.name)) != field.default}
    measures = {name: float(f"{value:.3g}") for name, value in wanted.items()}
    content = {
        "made": made,
        "of": f"ARCTIC's s05, {len(found)} hands in grasps of both hands, {sum(lengths)} frames",
        "noise": values,
        "measured": measures,
        "lengths": [int(n) for n in np.percentile(lengths, np.arange(5, 100, 10))],
    }
    TABLE.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def table() -> None:
    """Put the measures of the estimates and of all noise levels beside each other into the page."""
    content = json.loads(TABLE.read_text(encoding="utf-8"))
    lengths = content["lengths"]
    columns = {"measured": content["measured"]} | {
        f"`{name}`": drawn(NOISE[name], lengths) | {"aligned": drawn_aligned(NOISE[name], lengths)}
        for name in ("estimated", "moderate", "strong")
    }
    rows = []
    for name, what in (ERROR_MEASURES | SHARES | {"aligned": ALIGNED}).items():
        digits = 2 if what.unit in ("s", "") else 1
        unit = f" [{what.unit}]" if what.unit else ""
        rows.append([f"{what.label}{unit}", *(f"{what.factor * one[name]:.{digits}f}" for one in columns.values())])
    page.write(SECTION, f"*Made {stamp()}.*\n\n{page.table(['', *columns], rows)}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["measure", root, grasps]:
            write(Path(root), Path(grasps))
        case ["table"]:
            table()
        case _:
            sys.exit(__doc__)
