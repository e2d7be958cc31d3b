"""Errors of hand trackers and of masks, added to clips with ground truth.

A tracker's hand in frame n is the true hand, displaced:

    T_cam_hand' = shift(d_n r) . T_cam_hand . turn_and_shift(w_n, s_n)

w_n turns the hand about its middle, s_n shifts it in any direction, and d_n shifts it along the camera's ray r through
its middle: the direction that one image determines least. The fingers' joints are bent as well. Every error has a
**bias**, constant over all frames, and **jitter**, an autoregressive process: e_n = a e_(n-1) + sqrt(1 - a^2) white
noise, with a = exp(-1 / (fps memory)), so that neighbouring frames have similar errors. The size of errors may vary
between clips, and bursts of frames may be **outliers**.

The preset ``estimated`` has the measured errors of hands estimated from images; ``moderate`` and ``strong`` are
assumptions: see "Noise levels" in docs/datasets.md.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks
from getagrip.errors import InputError, NamedFields
from getagrip.geometry import se3
from getagrip.geometry.camera import bounding_boxes
from getagrip.provenance import estimated

ESTIMATED_HANDS_FILE = Path(__file__).with_name("estimated_hands.json")
"""Measured errors of hands estimated from images, by ``benchmarks/hand_errors.py``, last in commit ea913fa.

``noise``: fields of ``Noise`` whose errors, drawn for clips of the same lengths, have the measured statistics (fingers:
equally displaced joints). ``measured``: these statistics, as tests measure them, and the joints' error after the best
similarity; SI units. ``lengths``: 5, 15, ..., 95 % quantiles of the numbers of frames of these grasps."""


@dataclass(frozen=True)
class Noise(NamedFields):
    """The errors of a clip's hands and masks.

    Attributes:
        hand_bias_deg: rotation of the hand about a random axis, constant over all frames [degrees].
        hand_bias_mm: translation of the hand in a random direction of the hand frame, constant over all frames [mm].
        hand_bias_depth_mm: translation of the hand along the camera's ray, nearer or farther, constant over all frames
            [mm].
        finger_bias_deg: root mean square bend of each finger joint, constant over all frames [degrees].
        hand_jitter_deg: root mean square rotation of the hand that varies from frame to frame [degrees].
        hand_jitter_mm: root mean square translation that varies from frame to frame [mm].
        hand_jitter_depth_mm: root mean square translation along the camera's ray that varies from frame to frame [mm].
        finger_jitter_deg: root mean square bend of each finger joint that varies from frame to frame [degrees].
        jitter_memory_s: time after which the correlation of the jitter is 1/e [s]; zero: independent frames.
        spread: standard deviation of the logarithm of a factor on the errors above, drawn anew per clip, for the bias
            and for the jitter of rotation, translation, depth and fingers.
        outlier_share: fraction of outlier frames.
        outlier_times: additional error of outliers, as a multiple of the jitter; constant over a burst.
        outlier_s: mean duration of a burst of outliers [s].
        mask_ragged_px: root mean square distance of the masks' boundaries from the true ones [px].
    """

    hand_bias_deg: float = 0.0
    hand_bias_mm: float = 0.0
    hand_bias_depth_mm: float = 0.0
    finger_bias_deg: float = 0.0
    hand_jitter_deg: float = 0.0
    hand_jitter_mm: float = 0.0
    hand_jitter_depth_mm: float = 0.0
    finger_jitter_deg: float = 0.0
    jitter_memory_s: float = 0.0
    spread: float = 0.0
    outlier_share: float = 0.0
    outlier_times: float = 0.0
    outlier_s: float = 0.0
    mask_ragged_px: float = 0.0


_MODERATE = {"hand_bias_deg": 3.0, "hand_bias_mm": 3.0, "hand_bias_depth_mm": 8.0, "finger_bias_deg": 8.0}
_MODERATE |= {"hand_jitter_deg": 1.5, "hand_jitter_mm": 1.5, "hand_jitter_depth_mm": 4.0, "finger_jitter_deg": 4.0}
_STRONG = {name: (2.0 if name.startswith("finger") else 2.5) * error for name, error in _MODERATE.items()}
NOISE_PRESETS: dict[str, Noise] = {
    "none": Noise(),
    "moderate": Noise(**_MODERATE, jitter_memory_s=0.1, mask_ragged_px=1.0),
    "strong": Noise(**_STRONG, jitter_memory_s=0.1, mask_ragged_px=1.0),
    "estimated": Noise(**json.loads(ESTIMATED_HANDS_FILE.read_text(encoding="utf-8"))["noise"], mask_ragged_px=1.0),
}
"""Noise by name; the hands of ``estimated`` are measured, all else is assumed."""


def perturbed(clip: Clip, masks: Masks, noise: Noise, seed: int | Sequence[int]) -> tuple[Clip, Masks]:
    """Add noise to a clip: displace its hand, and move the boundaries of its masks.

    The ground truth keeps the true hand. Errors of one seed differ between noises by their size only. Raises
    ``InputError`` where fingers are to be bent and the clip has no joints.
    """
    rng = np.random.default_rng(seed)
    hand = noisy_hand(clip, noise, rng)
    provenance = clip.provenance | {"noise": {"seed": seed} | {f.name: getattr(noise, f.name) for f in fields(Noise)}}
    if replace(noise, mask_ragged_px=0.0) == replace(NOISE_PRESETS["estimated"], mask_ragged_px=0.0):
        provenance |= {"hands": estimated("true hands with the errors of hands estimated from images")}
    return replace(clip, hand=hand, provenance=provenance), noisy_masks(masks, noise, rng)


def noisy_hand(clip: Clip, noise: Noise, rng: np.random.Generator) -> HandTrack:
    """Displace the clip's hand; see ``perturbed``."""
    from getagrip.hands.bending import bend_fingers, finger_weights  # with kernels; options are light to load

    errors = draw_hand_errors(noise, len(clip), clip.fps, rng)
    middle = clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(errors.turn)
    displaced = clip.hand.T_cam_hand @ se3.rigid(R, middle + errors.shift - R @ middle)
    ray = se3.transform(clip.hand.T_cam_hand, middle[None])[:, 0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    hand = replace(clip.hand, T_cam_hand=se3.rigid(None, errors.deeper * ray) @ displaced)
    if noise.finger_bias_deg == 0.0 and noise.finger_jitter_deg == 0.0:
        return hand
    if hand.joints is None:
        raise InputError(clip.origin / "hand.npz", "joints", "none", "joints (T, 21, 3), to bend the fingers about")
    vertices, joints = bend_fingers(hand.vertices, hand.joints, finger_weights(hand), errors.bends)
    return replace(hand, vertices=vertices, joints=joints)


def noisy_masks(masks: Masks, noise: Noise, rng: np.random.Generator) -> Masks:
    """Displace the boundaries of masks; ignored pixels are removed from the object's mask."""
    if noise.mask_ragged_px == 0.0:
        return masks
    objects, ignored, hands = [], [], []
    for mask, ignore in zip(masks.object, masks.ignore, strict=True):
        ignored.append(perturb_mask_boundary(ignore, noise.mask_ragged_px, rng))
        objects.append(perturb_mask_boundary(mask, noise.mask_ragged_px, rng) & ~ignored[-1])
    for hand, ignore, moved in zip(() if masks.hand is None else masks.hand, masks.ignore, ignored, strict=False):
        alone = np.array_equal(hand, ignore)  # both are one contour
        hands.append(moved if alone else perturb_mask_boundary(hand, noise.mask_ragged_px, rng))
    return Masks(np.stack(objects), np.stack(ignored), np.stack(hands) if hands else None)


def perturb_mask_boundary(mask: Bool[ndarray, "H W"], px: float, rng: np.random.Generator) -> Bool[ndarray, "H W"]:
    """Move a mask's boundary by a random field, ``px`` root mean square, smooth over about 5 px."""
    import cv2

    if not mask.any():
        return mask
    margin = int(np.ceil(4.0 * px)) + 2
    left, top, right, bottom = bounding_boxes(mask[None])[0] + [-margin, -margin, margin, margin]
    window = slice(max(top, 0), bottom), slice(max(left, 0), right)
    part = mask[window]
    inside = cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 3)
    outside = cv2.distanceTransform((~part).astype(np.uint8), cv2.DIST_L2, 3)
    field = cv2.GaussianBlur(rng.normal(size=part.shape).astype(np.float32), (0, 0), 5.0)
    moved = mask.copy()
    moved[window] = inside - outside > field * (px / field.std())
    return moved


@dataclass(frozen=True)
class DrawnHandErrors:
    """The errors of a clip's hand.

    Attributes:
        turn: (T, 3) rotation vector about the hand's middle [rad].
        shift: (T, 3) translation in the hand frame [m].
        deeper: (T, 1) translation along the camera's ray [m].
        bends: (T, 5, 3) additional bend of each finger's joints [rad].
    """

    turn: Float[ndarray, "T 3"]
    shift: Float[ndarray, "T 3"]
    deeper: Float[ndarray, "T 1"]
    bends: Float[ndarray, "T 5 3"]


def draw_hand_errors(noise: Noise, frames: int, fps: float, rng: np.random.Generator) -> DrawnHandErrors:
    """Draw the errors of a clip; with equal generators, noises differ by the size of errors only."""
    # Separate generators: the hand's errors do not depend on depth, fingers and outliers.
    depth, fingers, levels, bursts = rng.spawn(4)
    a = float(np.exp(-1.0 / (fps * noise.jitter_memory_s))) if noise.jitter_memory_s > 0.0 else 0.0
    bias, jitter = np.exp(noise.spread * levels.normal(size=(2, 4)))
    first = _draw_outlier_bursts(noise, frames, fps, bursts)

    def wander(white: Float[ndarray, "T k"], rms: float, kind: int) -> Float[ndarray, "T k"]:
        far = bursts.normal(size=white.shape)[first]  # one error per burst
        times = np.where(first < 0, 0.0, noise.outlier_times)
        return rms * jitter[kind] * (_autoregressive_noise(white, a) + times[:, None] * far)

    turn = bias[0] * _scale_to_length(rng.normal(size=3), np.radians(noise.hand_bias_deg))
    shift = bias[1] * _scale_to_length(rng.normal(size=3), 1e-3 * noise.hand_bias_mm)
    turn = turn + wander(rng.normal(size=(frames, 3)), np.radians(noise.hand_jitter_deg) / np.sqrt(3.0), 0)
    shift = shift + wander(rng.normal(size=(frames, 3)), 1e-3 * noise.hand_jitter_mm / np.sqrt(3.0), 1)
    deeper = bias[2] * 1e-3 * noise.hand_bias_depth_mm * depth.choice([-1.0, 1.0])
    deeper = deeper + wander(depth.normal(size=(frames, 1)), 1e-3 * noise.hand_jitter_depth_mm, 2)
    bends = bias[3] * np.radians(noise.finger_bias_deg) * fingers.normal(size=15)
    bends = bends + wander(fingers.normal(size=(frames, 5, 3)).reshape(-1, 15), np.radians(noise.finger_jitter_deg), 3)
    return DrawnHandErrors(turn, shift, deeper, bends.reshape(-1, 5, 3))


def _draw_outlier_bursts(noise: Noise, frames: int, fps: float, rng: np.random.Generator) -> Int[ndarray, "T"]:
    """Draw the first frame of each frame's burst of outliers; -1 for frames in none.

    Bursts are a Markov chain of two states, with the noise's fraction of frames and mean duration.
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


def _autoregressive_noise(white: Float[ndarray, "T k"], a: float) -> Float[ndarray, "T k"]:
    """Filter white noise to a first-order autoregressive process, both of unit variance."""
    out = white.copy()
    for n in range(1, len(out)):
        out[n] = a * out[n - 1] + np.sqrt(1.0 - a * a) * white[n]
    return out


def _scale_to_length(v: Float[ndarray, "3"], length: float) -> Float[ndarray, "3"]:
    return np.asarray(v / np.linalg.norm(v) * length)
