"""Changes of clips before a benchmark reconstructs them: noise, other sizes and objects, true hands, mistakes.

Faults of masks are those of a video segmenter that loses its object; their sizes are in units of the mask's size, the
root of its area.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Protocol

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.bench.inputs.wrong_inputs import INPUT_MISTAKES, flip_hands
from getagrip.clip import Clip, FrameMasks, Masks
from getagrip.clip.clip import frame_indices
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import Surface, render_coverage, true_masks
from getagrip.geometry.warp import align_similarity
from getagrip.metrics.contact import signed_distance
from getagrip.provenance import estimated, kind_of_hands
from getagrip.synthetic.noise import Noise, perturbed
from getagrip.synthetic.objects import draw_deformation

Fault = Callable[[Bool[ndarray, "H W"], Float[ndarray, "2"]], Bool[ndarray, "H W"]]
"""Makes a wrong mask from a mask that is not empty and a direction (x, y) in the image."""
TOUCH_DISTANCE_M = 0.01
"""Distance below which a hand touches an object [m]."""
OTHER_OBJECT_OFFSET, MASK_DISC_OFFSET, MASK_DISC_RADIUS = 1.2, 0.6, 0.6
"""Distance to another object; distance to, and radius of, a disc added to a mask; from the mask's middle."""


class Change(Protocol):
    """A change of a clip before it is reconstructed, identified by its ``repr`` and its ``inputs``."""

    other_hands: ClassVar[bool] = False
    """True if the clip gets another estimator's hands, which its results keep."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        """Return the changed clip and masks, possibly at fewer frames. Raises ``InputError`` for unsuitable clips."""

    def inputs(self, clip: str) -> Mapping[str, Path]:
        """Return the files that the change reads for a clip, by name. Raises ``InputError`` where one is missing."""
        return {}


@dataclass(frozen=True)
class Unchanged(Change):
    """Leaves the clip as it is."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        return clip, masks


@dataclass(frozen=True)
class Noisy(Change):
    """Adds noise to hands and masks; a seed draws the same errors, scaled, at every level of noise."""

    noise: Noise

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        return perturbed(clip, masks, self.noise, [seed, *clip.name.encode()])


@dataclass(frozen=True)
class EstimatedHands(Change):
    """Adds noise to hands that are not estimated, and marks them as estimated."""

    noise: Noise

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        if kind_of_hands(clip.provenance) == "estimated":
            return clip, masks
        clip, masks = Noisy(self.noise)(clip, masks, seed)
        source = {"hands": estimated("true hands, displaced")}
        return replace(clip, provenance=clip.provenance | source), masks


@dataclass(frozen=True)
class ScaleKnown(Change):
    """Gives the mesh its true size."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        if clip.scale == "known":
            return clip, masks
        if clip.truth is None:
            raise InputError(clip.origin / "truth.npz", "scale", "no ground truth", "the true scale, to make it known")
        return replace(_scale_clip_mesh(clip, clip.truth.scale), scale="known"), masks


@dataclass(frozen=True)
class ScaleFree(Change):
    """Frees the scale, and scales the mesh by a random factor between 1 / 1.25 and 1.25."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        factor = float(np.exp(np.random.default_rng([seed, *clip.name.encode()]).uniform(-1.0, 1.0) * np.log(1.25)))
        return replace(_scale_clip_mesh(clip, 1.0 / factor), scale="free"), masks


@dataclass(frozen=True)
class Gapped(Change):
    """Erodes the masks of hand and occluders, which leaves gaps between them and the object's masks."""

    px: float
    """Width of the gaps [px of the image]."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        def shrunk(each: Bool[ndarray, "N H W"]) -> Bool[ndarray, "N H W"]:
            return np.stack([cv2.distanceTransform(m.view(np.uint8), cv2.DIST_L2, 5) > self.px for m in each])

        return clip, Masks(masks.object, shrunk(masks.ignore), None if masks.hand is None else shrunk(masks.hand))


@dataclass(frozen=True)
class OtherObject(Change):
    """Replaces the masks by those of another object of the category, so that the mesh becomes a template mesh.

    The other object is the mesh, deformed and stretched, at its place and size, with nearly the same symmetries.

    Attributes:
        deformed: root mean square of the smooth deformation, in diameters.
        stretched: largest relative change of each side.
    """

    deformed: float = 0.03
    stretched: float = 0.1

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        truth, mesh = clip.truth, clip.mesh
        if truth is None:
            raise InputError(clip.origin / "truth.npz", "", "no ground truth", "poses at which to draw another object")
        rng = np.random.default_rng([seed, *clip.name.encode()])
        deformation = draw_deformation(mesh, self.deformed, rng)
        sides = np.exp(rng.uniform(-1.0, 1.0, 3) * np.log(1.0 + self.stretched))
        other = Mesh(mesh.centre + sides * (deformation(mesh.vertices) - mesh.centre), mesh.faces)
        T, size = align_similarity(mesh, other, resize=True)
        grasped = truth.scale * se3.transform(se3.inverse(T), other.vertices) / size
        hands = se3.transform(truth.T_cam_hand, truth.hand_vertices)
        return clip, Masks.of(
            _render_changed_masks(
                masks.take(np.array([n])),
                (se3.transform(truth.T_cam_obj[n], grasped), mesh.faces),
                (hands[n], clip.hand.faces),
                clip.K[n],
                clip.size,
            )
            for n in range(len(clip))
        )


@dataclass(frozen=True)
class OtherSize(Change):
    """Scales the object in the grasp, with its masks and truth; hand and camera stay.

    The object is scaled about the middle of its contact with the hand. The factor moves towards 1 until the touching
    part of the hand stays near the surface.

    Attributes:
        most: largest factor; the least is its inverse.
        off_mm: largest mean distance of the touching part of the hand from the scaled surface [mm].
    """

    most: float = 1.6
    off_mm: float = 10.0

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        truth, mesh = clip.truth, clip.mesh
        if truth is None:
            raise InputError(clip.origin / "truth.npz", "", "no ground truth", "poses at which to draw another size")
        rng = np.random.default_rng([seed, *clip.name.encode()])
        factor = float(np.exp(rng.uniform(-1.0, 1.0) * np.log(self.most)))
        few, hands = frame_indices(len(clip), 3), se3.transform(truth.T_cam_hand, truth.hand_vertices)
        points = se3.transform(se3.inverse(truth.T_cam_obj[few]), hands[few]).reshape(-1, 3)
        surface = truth.scale * mesh.vertices
        distance = np.abs(signed_distance(points, surface, mesh.faces))
        touching = points[distance <= max(TOUCH_DISTANCE_M, np.quantile(distance, 0.02))]
        middle = touching.mean(axis=0)
        while True:
            grown = middle + factor * (surface - middle)
            if abs(np.log(factor)) < 0.05:
                break
            if 1e3 * np.abs(signed_distance(touching, grown, mesh.faces)).mean() <= self.off_mm:
                break
            factor = float(np.sqrt(factor))
        resized = _scale_clip_mesh(clip, factor)
        assert resized.truth is not None
        T_cam_obj = truth.T_cam_obj @ se3.rigid(None, (1.0 - factor) * middle)
        truth = replace(resized.truth, scale=truth.scale, T_cam_obj=T_cam_obj)
        clip = replace(resized, truth=truth)
        posed = se3.transform(T_cam_obj, truth.object_vertices(clip.mesh.vertices, slice(None)))
        return clip, Masks.of(
            _render_changed_masks(
                masks.take(np.array([n])), (posed[n], mesh.faces), (hands[n], clip.hand.faces), clip.K[n], clip.size
            )
            for n in range(len(clip))
        )


def _render_changed_masks(
    seen: Masks, grasped: Surface, hand: Surface, K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> FrameMasks:
    """Render a frame's masks with another object; pixels behind other occluders stay ignored."""
    visible, ignore, holding = true_masks(grasped, [hand], [], K, size)
    others = seen.ignore[0] & ~render_coverage(*hand, K, size)
    return FrameMasks(visible & ~others, ignore | others, None if seen.hand is None else holding & ~others)


@dataclass(frozen=True)
class Several(Change):
    """Applies changes one after the other."""

    changes: tuple[Change, ...]

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        for change in self.changes:
            clip, masks = change(clip, masks, seed)
        return clip, masks


@dataclass(frozen=True)
class FlippedHands(Change):
    """Flips the hand in a share of the frames (``wrong_inputs.flip_hands``)."""

    share: float

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        return flip_hands(clip, self.share, np.random.default_rng([seed, *clip.name.encode()])), masks


@dataclass(frozen=True)
class TrueHands(Change):
    """Replaces the hands by those of the ground truth."""

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        if clip.truth is None:
            raise InputError(clip.origin / "truth.npz", "T_cam_hand", "no ground truth", "the true hands")
        hand = replace(clip.hand, vertices=clip.truth.hand_vertices, T_cam_hand=clip.truth.T_cam_hand, joints=None)
        return replace(clip, hand=hand), masks


def _scale_clip_mesh(clip: Clip, factor: float) -> Clip:
    """Scale a clip's mesh by a factor; the true object stays."""
    truth = clip.truth
    if truth is not None:
        joint = truth.joint and replace(truth.joint, point=factor * truth.joint.point)
        truth = replace(truth, scale=truth.scale / factor, joint=joint)
    return replace(clip.resized(factor), truth=truth)


@dataclass(frozen=True)
class Wrong(Change):
    """Makes a mistake, a key of ``INPUT_MISTAKES``, and removes the ground truth, which no longer applies."""

    mistake: str

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        return INPUT_MISTAKES[self.mistake](replace(clip, truth=None), masks, np.random.default_rng(seed))


@dataclass(frozen=True)
class WrongMasks(Change):
    """Makes a fault, a key of ``MASK_FAULTS``, in a share of the masks that show the object; not in ignored pixels."""

    fault: str
    share: float

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        rng = np.random.default_rng([seed, *clip.name.encode()])
        shown = rng.permutation(np.flatnonzero(masks.object.any(axis=(1, 2))))
        changed = masks.object.copy()
        for n in shown[: round(self.share * len(shown))]:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            wrong = MASK_FAULTS[self.fault](masks.object[n], np.array([np.cos(angle), np.sin(angle)]))
            changed[n] = wrong & (masks.object[n] | ~masks.ignore[n])
        return clip, replace(masks, object=changed)


UNCHANGED = Unchanged()


def displace_mask(mask: Bool[ndarray, "H W"], towards: Float[ndarray, "2"]) -> Bool[ndarray, "H W"]:
    """Move a mask beside the object."""
    rows, columns = np.nonzero(mask)
    dx, dy = np.rint(OTHER_OBJECT_OFFSET * np.sqrt(len(rows)) * towards).astype(int)
    rows, columns = rows + dy, columns + dx
    inside = (rows >= 0) & (rows < len(mask)) & (columns >= 0) & (columns < mask.shape[1])
    wrong = np.zeros_like(mask)
    wrong[rows[inside], columns[inside]] = True
    return wrong


def halve_mask(mask: Bool[ndarray, "H W"], towards: Float[ndarray, "2"]) -> Bool[ndarray, "H W"]:
    """Cut a mask to one side of the object."""
    dx, dy = _offsets_from_centroid(mask)
    return mask & (dx * towards[0] + dy * towards[1] < 0.0)


def extend_mask_by_disc(mask: Bool[ndarray, "H W"], towards: Float[ndarray, "2"]) -> Bool[ndarray, "H W"]:
    """Extend a mask by a disc that overlaps it."""
    dx, dy = _offsets_from_centroid(mask)
    size = np.sqrt(np.count_nonzero(mask))
    distance = np.hypot(dx - MASK_DISC_OFFSET * size * towards[0], dy - MASK_DISC_OFFSET * size * towards[1])
    return mask | (distance < MASK_DISC_RADIUS * size)


def _offsets_from_centroid(mask: Bool[ndarray, "H W"]) -> tuple[Float[ndarray, "1 W"], Float[ndarray, "H 1"]]:
    rows, columns = np.nonzero(mask)
    return np.arange(mask.shape[1])[None] - columns.mean(), np.arange(len(mask))[:, None] - rows.mean()


MASK_FAULTS: dict[str, Fault] = {"another object": displace_mask, "half": halve_mask, "runs over": extend_mask_by_disc}
"""Faults by their names in tables."""
