"""Common mistakes with inputs, made on purpose to test the checks (docs/checks.md).

``settings.Wrong`` makes them, on clips without ground truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.geometry import se3
from getagrip.geometry.camera import bounding_boxes
from getagrip.geometry.mesh import Mesh, merged

Mistake = Callable[[Clip, Masks, np.random.Generator], tuple[Clip, Masks]]
AWAY, FAR, TINY = 0.24, 10.0, 0.006
"""How much farther from the camera a hand is moved [m], how far from it one is put [m], and a tiny mesh's size [m]."""
FLIPPED, JITTER = 0.2, 0.03
"""Share of the frames in which a hand is flipped, and standard deviation of where one is put along each axis [m]."""
A_LITTLE = 2
"""Delay of the masks in frames, as where one file counts from 0 or leaves frames out."""
TOO_LARGE = 1.15
"""How many times too large a hand is, and too far away: it looks as before."""


def other_mesh(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Replace the mesh by scissors; scissors by a mug."""
    return replace(clip, mesh=CATEGORIES["mug" if clip.category == "scissors" else "scissors"].make()), masks


def reversed_hands(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Reverse the hands in time: that of the last frame comes first."""
    return replace(clip, hand=clip.take(np.arange(len(clip))[::-1]).hand), masks


def late_masks(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Delay the masks by a third of the clip, as where two files count frames from different numbers."""
    return clip, masks.take(np.maximum(np.arange(len(clip)) - len(clip) // 3, 0))


def masks_a_little_late(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Delay the masks by ``A_LITTLE`` frames."""
    return clip, masks.take(np.maximum(np.arange(len(clip)) - A_LITTLE, 0))


def other_side(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Call a left hand a right one, or the other way round."""
    return replace(clip, side="right" if clip.side == "left" else "left"), masks


def away(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Move the hand away from the camera by ``AWAY``."""
    T = clip.hand.T_cam_hand.copy()
    T[:, 2, 3] += AWAY
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def far(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Move the hand along its ray, to ``FAR`` from the camera."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, 3] *= FAR / T[:, 2:3, 3]
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def too_large(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Enlarge the hand by ``TOO_LARGE`` and its distance by as much: an estimator that takes every hand for large."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, 3] *= TOO_LARGE
    return replace(clip, hand=replace(clip.hand, vertices=TOO_LARGE * clip.hand.vertices, T_cam_hand=T)), masks


def flips(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Flip the hand in ``FLIPPED`` of the frames."""
    return flipped(clip, FLIPPED, rng), masks


def jitters(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Move the hand by ``JITTER``, independently in each frame."""
    T = clip.hand.T_cam_hand.copy()
    T[:, :3, 3] += rng.normal(scale=JITTER, size=(len(T), 3))
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def with_hand(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Add the hand's pixels to the object's masks."""
    return clip, replace(masks, object=masks.object | masks.ignore, ignore=np.zeros_like(masks.ignore))


def background(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Replace the masks by the background, and leave the object's size unknown."""
    return replace(clip, scale="free"), replace(masks, object=~masks.object & ~masks.ignore)


def one_pixel(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Reduce each mask to the pixel in the middle of its box."""
    shown, boxes = np.zeros_like(masks.object), bounding_boxes(masks.object)
    for n in np.flatnonzero(masks.object.any(axis=(1, 2))):
        rows, columns = np.nonzero(masks.object[n])
        middle = (boxes[n, :2] + boxes[n, 2:]) / 2
        nearest = np.argmin((columns - middle[0]) ** 2 + (rows - middle[1]) ** 2)
        shown[n, rows[nearest], columns[nearest]] = True
    return clip, Masks(shown, masks.ignore)


def noise_masks(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Set each pixel at random."""
    return clip, Masks(rng.random(masks.object.shape) < 0.5, np.zeros_like(masks.ignore))


def focal_jumps(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Enlarge the focal length by half in every second frame."""
    K = clip.K.copy()
    K[::2, [0, 1], [0, 1]] *= 1.5
    return replace(clip, K=K), masks


def needle(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Shrink the mesh to a hundredth of its width and height."""
    return _stretched(clip, np.array([1.0, 0.01, 0.01])), masks


def flat(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Flatten the mesh to a thousandth of its least extent."""
    return _stretched(clip, np.where(np.ptp(clip.mesh.vertices, axis=0).argmin() == np.arange(3), 1e-3, 1.0)), masks


def tiny(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Shrink the mesh to ``TINY``, as where it is in other units, with its scale taken for known."""
    vertices = clip.mesh.vertices * (TINY / np.ptp(clip.mesh.vertices, axis=0).max())
    return replace(clip, mesh=Mesh(vertices, clip.mesh.faces), scale="known"), masks


def mesh_too_large(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Enlarge the mesh by a tenth, with its scale taken for known."""
    return replace(_stretched(clip, np.full(3, 1.1)), scale="known"), masks


def mesh_too_small(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Shrink the mesh by a tenth."""
    return replace(_stretched(clip, np.full(3, 0.9)), scale="known"), masks


def missing_faces(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Drop the last third of the mesh's faces."""
    vertices, faces = clip.mesh.vertices, clip.mesh.faces[: 2 * len(clip.mesh.faces) // 3]
    used, kept = np.unique(merged(vertices)[faces], return_inverse=True)
    return replace(clip, mesh=Mesh(vertices[used], kept.reshape(faces.shape))), masks


MISTAKES: dict[str, Mistake] = {
    "other mesh": other_mesh,
    "hands reversed": reversed_hands,
    "masks late": late_masks,
    "masks 2 frames late": masks_a_little_late,
    "side flipped": other_side,
    "hands 24 cm away": away,
    "hand at 10 m": far,
    "hand too large": too_large,
    "hand flips": flips,
    "hand jitters": jitters,
    "masks with the hand": with_hand,
    "masks of the background": background,
    "one-pixel masks": one_pixel,
    "noise masks": noise_masks,
    "focal jumps": focal_jumps,
    "needle mesh": needle,
    "flat mesh": flat,
    "6 mm mesh": tiny,
    "mesh too large": mesh_too_large,
    "mesh too small": mesh_too_small,
    "a third of the faces missing": missing_faces,
}


def _stretched(clip: Clip, by: Float[ndarray, "3"]) -> Clip:
    return replace(clip, mesh=Mesh(clip.mesh.vertices * by, clip.mesh.faces))


def flipped(clip: Clip, share: float, rng: np.random.Generator) -> Clip:
    """Turn the hand by half a turn about an axis of its own in a share of the frames, as trackers flip it."""
    frames = rng.choice(len(clip), max(1, round(share * len(clip))), replace=False)
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(np.pi * np.eye(3)[rng.integers(3, size=len(frames))])
    T[frames] = T[frames] @ se3.rigid(R, middle - R @ middle)
    return clip.with_hand_at(T)
