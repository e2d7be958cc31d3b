"""A column on the page with all that is shown of it, and what is still being measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.occlusion import occluded_by_hand
from getagrip.metrics.mask import iou_of_poses
from getagrip.view.curves import angle_curve
from getagrip.view.gap import coarse, gap
from getagrip.view.live.column import TRUTH, Column
from getagrip.view.live.contact import Surfaces
from getagrip.view.live.overlay import Overlays
from getagrip.view.live.plots import Curve, Plot
from getagrip.view.live.stage import Stage
from getagrip.view.style import TRUE

if TYPE_CHECKING:
    from viser import SceneApi

BATCH = 8
"""Frames are measured in so many at a time; between them the page may go on."""


class Actor:
    """A column's nodes, overlays and curves."""

    def __init__(self, scene: SceneApi, name: str, column: Column, beside: Float[ndarray, "3"], colour: str) -> None:
        self.column, self.colour = column, colour
        self.surfaces, self.overlays = Surfaces(column), Overlays(column)
        self.stage = Stage(scene, name, column, self.surfaces, beside)
        self.iou = column.view.result.iou.copy()
        self.gap = np.full(len(self.iou), np.nan)
        self.angle = angle_curve(column.view) if column.posed else None

    def measure(self, go_on: Callable[[], bool]) -> None:
        """Find the gap, and the IOU where it is not known, frame by frame, while ``go_on`` says so."""
        view, posed = self.column.view, coarse(self.column.view)
        for n in range(0, len(self.iou) if self.column.posed else 0, BATCH):
            some = np.arange(n, min(n + BATCH, len(self.iou)))
            if not go_on():
                return
            self.gap[some] = gap(posed.at([view.result.frames[k] for k in some]))
            if view.masks is not None and np.isnan(view.result.iou[some]).all():
                masks, clip = view.masks.take(some), view.clip.take(some)
                masks = masks if view.masks.say_what_hides else occluded_by_hand(clip, masks)
                poses = self.column.T_cam_obj[some]
                self.iou[some] = iou_of_poses(clip.mesh, view.result.scale, poses, clip.K, masks).full


def plots(actors: list[Actor]) -> list[Plot]:
    """Angle, IOU and gap of all columns over the frames. Methods without an axis have another angle: one more plot."""
    out: list[Plot] = []
    posed = [actor for actor in actors if actor.angle is not None]
    titles = dict.fromkeys(actor.angle.title for actor in posed if actor.angle is not None)
    for title in titles:
        same = [(actor, actor.angle) for actor in posed if actor.angle is not None and actor.angle.title == title]
        curves = [Curve(actor.column.name, np.degrees(angle.found), actor.colour) for actor, angle in same]
        true = same[0][1].true
        if true is not None and same[0][0].column.is_result:
            curves.insert(0, Curve(TRUTH, np.degrees(true), TRUE, faint=True))
        out.append(Plot(title, "°", curves))
    if not posed:
        return out
    iou = [Curve(actor.column.name, 100.0 * actor.iou, actor.colour) for actor in posed]
    gap = [Curve(actor.column.name, 1e3 * actor.gap, actor.colour) for actor in posed]
    if any(actor.column.view.masks is not None for actor in posed):
        low = min((float(np.nanmin(c.values)) for c in iou if np.isfinite(c.values).any()), default=50.0)
        out.append(Plot("overlap of the object with its mask (IOU)", "%", iou, (min(50.0, low), 100.0)))
    known = np.concatenate([[0.0], *(curve.values[np.isfinite(curve.values)] for curve in gap)])
    limits = min(float(known.min()), -1.0), max(float(known.max()), 1.0)
    out.append(Plot("gap of hand and object, below 0 inside", "mm", gap, limits))
    return out
