"""Views of cameras that stand around a grasp, rendered from its ground truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.bench.inputs.perturbations import Change
from getagrip.clip import Clip, FrameMasks, Masks
from getagrip.clip.views import View, clip_in_view, with_views
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import true_masks

VIEW_ANGLES_DEG = ((75.0, 0.0), (-75.0, 10.0), (150.0, 0.0), (-150.0, 10.0), (35.0, 15.0), (-35.0, 15.0), (110.0, 5.0))
"""Angles of the further cameras from the first one, about its vertical axis through the object, and upwards."""


@dataclass(frozen=True)
class AddedViews(Change):
    """Adds views of the true object and hand; another change applies to the masks of each.

    Cameras are as far from the object as the first one, whose intrinsics they have. They stand still in its frame.

    Attributes:
        views: number of views, the clip's own included.
        change: a change of the clip, and of the masks of each view.
    """

    views: int
    change: Change

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        if clip.truth is None:
            raise InputError(clip.origin / "truth.npz", "", "no ground truth", "poses to render in further views")
        changed, own = self.change(clip, masks, seed)
        added = []
        for n, angles in enumerate(VIEW_ANGLES_DEG[: self.views - 1]):
            view = _true_view(clip, f"view{n + 2}", _camera_around(clip, *np.radians(angles)))
            seen = self.change(clip_in_view(clip, view), view.masks, seed + n + 1)[1]
            added.append(View(name=view.name, size=view.size, K=view.K, T_cam_view=view.T_cam_view, masks=seen))
        return with_views(changed, added), own


def _camera_around(clip: Clip, across: float, up: float) -> Float[ndarray, "4 4"]:
    """Return the pose of a camera turned about the object's mean place, in the clip's camera frame."""
    assert clip.truth is not None
    middle = se3.transform(clip.truth.T_cam_obj, clip.truth.scale * clip.mesh.centre[None]).mean(axis=(0, 1))
    R = se3.exp_so3(np.array([0.0, -across, 0.0])) @ se3.exp_so3(np.array([-up, 0.0, 0.0]))
    return se3.rigid(R, middle - R @ middle)


def _true_view(clip: Clip, name: str, T_cam_view: Float[ndarray, "4 4"]) -> View:
    """Render a view of the true object and hand."""
    everywhere, unknown = np.tile(T_cam_view, (len(clip), 1, 1)), FrameMasks.unknown(clip.size)
    blank = Masks.of([unknown] * len(clip))
    view = View(name=name, size=clip.size, K=clip.K, T_cam_view=everywhere, masks=blank)
    masks = Masks.packed(_rendered_masks(clip_in_view(clip, view)), clip.size)
    return View(name=name, size=clip.size, K=clip.K, T_cam_view=everywhere, masks=masks)


def _rendered_masks(seen: Clip) -> Iterable[FrameMasks]:
    """Render the true masks of a clip in each frame."""
    truth = seen.truth
    assert truth is not None
    posed = se3.transform(truth.T_cam_obj, truth.object_vertices(seen.mesh.vertices, slice(None)))
    hands = se3.transform(truth.T_cam_hand, truth.hand_vertices)
    for n in range(len(seen)):
        grasped, hand = (posed[n], seen.mesh.faces), (hands[n], seen.hand.faces)
        yield FrameMasks(*true_masks(grasped, [hand], [], seen.K[n], seen.size))
