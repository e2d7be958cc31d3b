"""Contact of hand and object over a grasp, on both surfaces, and the agreement of frames (Fig. 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from getagrip.metrics.contact import (
    ContactDefinition,
    at_millimetres,
    contact_distances,
    pairwise_iou,
    stable_contact_area,
)
from getagrip.metrics.pose import ObjectTrack
from getagrip.pictures.figures.kind import Count, Fail, Kind, Millimetres, evenly, summary, the_one
from getagrip.pictures.matrix import IOU_RAMP
from getagrip.pictures.sheet import HEAD, Sheet, frame
from getagrip.pictures.shown import View
from getagrip.pictures.stored_results import StoredResult
from getagrip.pictures.style import FAINT, LINE, TRUE
from getagrip.pictures.tiles import rendered, show, windows
from getagrip.pictures.touched import SHARE, Touched, touched

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

SMALL, LARGE, MATRIX, GAP, LEFT = 1.32, 1.66, 3.0, 0.06, 0.55
"""Sides of the tiles of frames, of the tiles of all frames and of the matrix; the gap between them; the margin [in]."""
ROWS = ("on the object", "on the hand")
ALL = ("object, where most contact is", "object, the other side", "hand, from one side", "hand, from the other")


@dataclass(frozen=True, kw_only=True)
class Contact(Kind):
    """Contact areas of one result on the object and on the hand, frame by frame and as the share of all frames.

    Beside them is the contact IOU of every pair of frames, whose mean is the stable contact area. Of a clip they are
    those of the ground truth.
    """

    draws_truth: ClassVar[bool] = True
    frames: Count = 5
    """Frames to draw; shares and IOU are of all."""
    contact: Millimetres = 10.0
    """Largest distance [mm] from the other surface that counts as contact."""

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        (definition,) = at_millimetres([self.contact])
        view = the_one(results, "contact")
        surfaces = touched(view, definition.threshold)
        chosen = evenly(self.frames, len(view.result.frames))
        block = max(len(chosen) * (SMALL + GAP), 4 * (LARGE + GAP))
        top = HEAD + 0.24
        lower = top + 3 * (SMALL + GAP) + 0.42
        sheet = Sheet.of(LEFT + block + 0.65 + MATRIX + 0.75, lower + LARGE + 0.2, self.dpi)
        sheet.title(view.clip.name, f"{summary(view)}  ·  contact: within {definition.distance}")
        _frames(sheet, top, view, chosen, surfaces)
        _all_frames(sheet, lower, surfaces)
        _matrix(sheet, LEFT + block + 0.65, top, view, definition)
        _shares_bar(sheet, LEFT + block + 0.65, lower)
        return sheet.figure


def _frames(sheet: Sheet, top: float, view: View, chosen: Sequence[int], surfaces: tuple[Touched, Touched]) -> None:
    """Draw some frames: the result from the camera, and the contact."""
    crops = windows([view], np.array(chosen), sheet.pixels(SMALL))
    for k, n in enumerate(chosen):
        x = LEFT + k * (SMALL + GAP)
        sheet.text(x + SMALL / 2, top - 0.19, f"frame {view.result.frames[n]}", color=FAINT, ha="center")
        rendered(sheet.tile(x, top, SMALL), view, n, crops, k, from_side=False)
        for r, surface in enumerate(surfaces):
            show(sheet.tile(x, top + (r + 1) * (SMALL + GAP), SMALL), surface.at_frame(n, 0, sheet.pixels(SMALL)))
    for r, words in enumerate(("truth" if view.of_truth else "result", *ROWS)):
        y = top + r * (SMALL + GAP) + SMALL / 2
        sheet.text(LEFT - 0.17, y, words, rotation=90, ha="center", va="center", color=TRUE)


def _all_frames(sheet: Sheet, top: float, surfaces: tuple[Touched, Touched]) -> None:
    """Shares of all frames in contact, on each surface from two sides."""
    for k, words in enumerate(ALL):
        x = LEFT + k * (LARGE + GAP)
        sheet.text(x, top - 0.2, words, color=TRUE, fontsize=8)
        show(sheet.tile(x, top, LARGE), surfaces[k // 2].over_all(k % 2, sheet.pixels(LARGE)))


def _shares_bar(sheet: Sheet, x: float, top: float) -> None:
    """Draw the legend of the surfaces' colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap

    ramp = ScalarMappable(cmap=LinearSegmentedColormap.from_list("share", SHARE))
    ramp.set_clim(0.0, 100.0)
    bar = sheet.axes(x, top, MATRIX, 0.11)
    sheet.text(x, top - 0.2, "share of all frames in contact", color=TRUE)
    _bar(sheet, ramp, bar, "horizontal", [0, 50, 100], ["0 %", "50 %", "100 %"])
    first, _, last = bar.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    sheet.text(x, top + 0.5, "in single frames: red in contact, grey not", color=FAINT)


def _matrix(sheet: Sheet, x: float, top: float, view: View, definition: ContactDefinition) -> None:
    """Draw the contact IOU of all pairs of frames, by the definition of the stable contact area."""
    from matplotlib.colors import LinearSegmentedColormap

    clip, T = view.clip, len(view.result.frames)
    track = ObjectTrack(view.result.T_hand_obj, view.result.scale)
    (distances,) = contact_distances(
        clip.mesh, [track], clip.hand.vertices, clip.hand.faces, definition.threshold + 1e-3
    )
    iou = pairwise_iou(distances.contact(definition.side, definition.threshold))
    axes = sheet.axes(x, top, MATRIX, MATRIX)
    colours = LinearSegmentedColormap.from_list("contact", IOU_RAMP)
    drawn = axes.imshow(iou, extent=(0, T, T, 0), vmin=0.0, vmax=1.0, cmap=colours, interpolation="nearest")
    axes.set_xlabel(f"frame of the {'clip' if view.of_truth else 'result'}, counted from 0")
    axes.tick_params(length=2)
    frame(axes)
    sheet.text(x, top - 0.19, "contact IOU of every pair of frames", color=TRUE)
    _bar(sheet, drawn, sheet.axes(x + MATRIX + 0.12, top, 0.11, MATRIX), "vertical", [0, 0.5, 1], ["0", "0.5", "1"])
    if T > 1:
        words = f"stable contact area (SCA) {100.0 * stable_contact_area(iou):.1f} %:\nthe mean of the pairs"
        sheet.text(x, top + MATRIX + 0.5, words, fontsize=9.5, linespacing=1.4)
    sheet.text(x, top + MATRIX + 0.92, definition.description, color=FAINT)


def _bar(
    sheet: Sheet, drawn: ScalarMappable, axes: Axes, way: str, ticks: Sequence[float], labels: Sequence[str]
) -> None:
    bar = sheet.figure.colorbar(drawn, cax=axes, orientation=way)
    bar.outline.set_edgecolor(LINE)
    bar.set_ticks(ticks, labels=labels)
    axes.tick_params(length=2)
