"""Common mistakes with inputs, made on purpose (``perturbations.Wrong``) to test the checks (docs/checks.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.geometry import se3
from getagrip.geometry.camera import bounding_boxes
from getagrip.geometry.mesh import Mesh, merge_vertices
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES

Mistake = Callable[[Clip, Masks, np.random.Generator], tuple[Clip, Masks]]
HAND_FLIP_FRACTION, HAND_JITTER_SIGMA_M = 0.2, 0.03
"""Fraction of frames with a flipped hand; standard deviation of a hand's jitter along each axis [m]."""
OVERSIZED_HAND_FACTOR = 1.15
"""Factor on a hand's size and distance; its image stays the same."""

INPUT_MISTAKES: dict[str, Mistake] = {
    "other mesh": lambda clip, masks, _: (_with_other_mesh(clip), masks),
    "hands reversed": lambda clip, masks, _: (replace(clip, hand=clip.take(np.arange(len(clip))[::-1]).hand), masks),
    # Files that count frames from different numbers; by 2 frames, where one counts from 0.
    "masks late": lambda clip, masks, _: (clip, _delay_masks(masks, len(clip) // 3)),
    "masks 2 frames late": lambda clip, masks, _: (clip, _delay_masks(masks, 2)),
    "side flipped": lambda clip, masks, _: (replace(clip, side=clip.other_side), masks),
    "hands 24 cm away": lambda clip, masks, _: (_move_hand_along_rays(clip, shift=np.array([0.0, 0.0, 0.24])), masks),
    "hand at 10 m": lambda clip, masks, _: (_move_hand_along_rays(clip, 10.0 / clip.hand.T_cam_hand[:, 2:3, 3]), masks),
    "hand too large": lambda clip, masks, _: (_with_large_hand(clip), masks),
    "hand flips": lambda clip, masks, rng: (flip_hands(clip, HAND_FLIP_FRACTION, rng), masks),
    "hand jitters": lambda clip, masks, rng: (
        _move_hand_along_rays(clip, shift=rng.normal(scale=HAND_JITTER_SIGMA_M, size=(len(clip), 3))), masks
    ),
    "masks with the hand": lambda clip, masks, _: (
        clip, replace(masks, object=masks.object | masks.ignore, ignore=np.zeros_like(masks.ignore))
    ),
    "masks of the background": lambda clip, masks, _: (
        replace(clip, scale="free"), replace(masks, object=~masks.object & ~masks.ignore)
    ),
    "one-pixel masks": lambda clip, masks, _: (clip, _reduce_to_one_pixel(masks)),
    "noise masks": lambda clip, masks, rng: (
        clip, Masks(rng.random(masks.object.shape) < 0.5, np.zeros_like(masks.ignore))
    ),
    "focal jumps": lambda clip, masks, _: (_with_focal_jumps(clip), masks),
    "needle mesh": lambda clip, masks, _: (_stretch_mesh(clip, np.array([1.0, 0.01, 0.01])), masks),
    "flat mesh": lambda clip, masks, _: (
        _stretch_mesh(clip, np.where(np.ptp(clip.mesh.vertices, axis=0).argmin() == np.arange(3), 1e-3, 1.0)), masks
    ),
    "6 mm mesh": lambda clip, masks, _: (
        replace(_stretch_mesh(clip, 0.006 / np.ptp(clip.mesh.vertices, axis=0).max()), scale="known"), masks
    ),
    "mesh too large": lambda clip, masks, _: (replace(_stretch_mesh(clip, 1.1), scale="known"), masks),
    "mesh too small": lambda clip, masks, _: (replace(_stretch_mesh(clip, 0.9), scale="known"), masks),
    "a third of the faces missing": lambda clip, masks, _: (_with_missing_faces(clip), masks),
}  # fmt: skip


def _with_other_mesh(clip: Clip) -> Clip:
    """Replace the mesh by scissors; scissors by a mug."""
    return replace(clip, mesh=SYNTHETIC_CATEGORIES["mug" if clip.category == "scissors" else "scissors"]())


def _delay_masks(masks: Masks, frames: int) -> Masks:
    return masks.take(np.maximum(np.arange(len(masks.object)) - frames, 0))


def _move_hand_along_rays(
    clip: Clip, factor: Float[ndarray, "T 1"] | float = 1.0, shift: Float[ndarray, "*T 3"] | float = 0.0
) -> Clip:
    """Move the hand along its rays, by a factor of its distance, and by a shift in the camera frame [m]."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, 3] = factor * T[:, :3, 3] + shift
    return clip.with_hand_at(T)


def _with_large_hand(clip: Clip) -> Clip:
    """Enlarge the hand and its distance by the same factor: an estimator that assumes a large hand."""
    larger = _move_hand_along_rays(clip, OVERSIZED_HAND_FACTOR)
    return replace(larger, hand=replace(larger.hand, vertices=OVERSIZED_HAND_FACTOR * clip.hand.vertices))


def _reduce_to_one_pixel(masks: Masks) -> Masks:
    """Reduce each mask to the pixel in the middle of its box."""
    shown, boxes = np.zeros_like(masks.object), bounding_boxes(masks.object)
    for n in np.flatnonzero(masks.object.any(axis=(1, 2))):
        rows, columns = np.nonzero(masks.object[n])
        middle = (boxes[n, :2] + boxes[n, 2:]) / 2
        nearest = np.argmin((columns - middle[0]) ** 2 + (rows - middle[1]) ** 2)
        shown[n, rows[nearest], columns[nearest]] = True
    return Masks(shown, masks.ignore)


def _with_focal_jumps(clip: Clip) -> Clip:
    """Enlarge the focal length by half in every second frame."""
    K = clip.K.copy()
    K[::2, [0, 1], [0, 1]] *= 1.5
    return replace(clip, K=K)


def _with_missing_faces(clip: Clip) -> Clip:
    """Drop the last third of the mesh's faces."""
    vertices, faces = clip.mesh.vertices, clip.mesh.faces[: 2 * len(clip.mesh.faces) // 3]
    used, kept = np.unique(merge_vertices(vertices)[faces], return_inverse=True)
    return replace(clip, mesh=Mesh(vertices[used], kept.reshape(faces.shape)))


def _stretch_mesh(clip: Clip, by: Float[ndarray, "3"] | float) -> Clip:
    return replace(clip, mesh=Mesh(clip.mesh.vertices * by, clip.mesh.faces))


def flip_hands(clip: Clip, share: float, rng: np.random.Generator) -> Clip:
    """Rotate the hand by 180 degrees about one of its own axes in a share of the frames: a tracker glitch."""
    frames = rng.choice(len(clip), max(1, round(share * len(clip))), replace=False)
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(np.pi * np.eye(3)[rng.integers(3, size=len(frames))])
    T[frames] = T[frames] @ se3.rigid(R, middle - R @ middle)
    return clip.with_hand_at(T)
