"""Contact of hand and object over a grasp, on both surfaces, and its IOU between frames (Fig. 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from getagrip.bench.figures.contact_matrix import IOU_RAMP
from getagrip.bench.figures.kind import (
    Count,
    Fail,
    FigureKind,
    Millimetres,
    evenly_spaced_indices,
    require_one_result,
    summarise_view,
)
from getagrip.metrics.contact import (
    ContactDefinition,
    contact_definitions_at,
    contact_distances,
    pairwise_iou,
    stable_contact_area,
)
from getagrip.metrics.pose import ObjectTrack
from getagrip.report.pictures.contact_colours import CONTACT_SHARE_COLOURS, ContactSurface, contact_surfaces
from getagrip.report.pictures.panels import (
    LINE_COLOUR,
    MUTED_COLOUR,
    SHEET_TITLE_INCHES,
    TRUTH_COLOUR,
    Sheet,
    content_windows,
    draw_border,
    draw_rendered,
    show_picture,
)
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import StoredResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

CONTACT_FRAME_INCHES, CONTACT_SHARE_INCHES, IOU_MATRIX_INCHES = 1.32, 1.66, 3.0
"""Sides of the tiles of frames, of the tiles of all frames and of the matrix [in]."""
CONTACT_GAP_INCHES, CONTACT_MARGIN_INCHES = 0.06, 0.55
CONTACT_ROW_LABELS = ("on the object", "on the hand")
CONTACT_VIEW_LABELS = (
    "object, where most contact is",
    "object, the other side",
    "hand, from one side",
    "hand, from the other",
)


@dataclass(frozen=True, kw_only=True)
class Contact(FigureKind):
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
        (definition,) = contact_definitions_at([self.contact])
        view = require_one_result(results, "contact")
        surfaces = contact_surfaces(view, definition.threshold)
        chosen = evenly_spaced_indices(self.frames, len(view.result.frames))
        frame_step, share_step = CONTACT_FRAME_INCHES + CONTACT_GAP_INCHES, CONTACT_SHARE_INCHES + CONTACT_GAP_INCHES
        right = CONTACT_MARGIN_INCHES + max(len(chosen) * frame_step, 4 * share_step) + 0.65
        top = SHEET_TITLE_INCHES + 0.24
        lower = top + 3 * frame_step + 0.42
        sheet = Sheet.of(right + IOU_MATRIX_INCHES + 0.75, lower + CONTACT_SHARE_INCHES + 0.2, self.dpi)
        sheet.title(view.clip.name, f"{summarise_view(view)}  ·  contact: within {definition.distance}")
        _draw_contact_frames(sheet, top, view, chosen, surfaces)
        _draw_contact_shares(sheet, lower, surfaces)
        _draw_iou_matrix(sheet, right, top, view, definition)
        _draw_shares_legend(sheet, right, lower)
        return sheet.figure


def _draw_contact_frames(
    sheet: Sheet, top: float, view: View, chosen: Sequence[int], surfaces: tuple[ContactSurface, ContactSurface]
) -> None:
    """Draw some frames: the result from the camera, and the contact."""
    crops = content_windows([view], np.array(chosen), sheet.pixels(CONTACT_FRAME_INCHES))
    for k, n in enumerate(chosen):
        x, heading = CONTACT_MARGIN_INCHES + k * (CONTACT_FRAME_INCHES + CONTACT_GAP_INCHES), view.result.frames[n]
        sheet.text(x + CONTACT_FRAME_INCHES / 2, top - 0.19, f"frame {heading}", color=MUTED_COLOUR, ha="center")
        draw_rendered(sheet.tile(x, top, CONTACT_FRAME_INCHES), view, n, crops, k, from_side=False)
        for r, surface in enumerate(surfaces):
            y = top + (r + 1) * (CONTACT_FRAME_INCHES + CONTACT_GAP_INCHES)
            picture = surface.at_frame(n, 0, sheet.pixels(CONTACT_FRAME_INCHES))
            show_picture(sheet.tile(x, y, CONTACT_FRAME_INCHES), picture)
    for r, words in enumerate(("truth" if view.of_truth else "result", *CONTACT_ROW_LABELS)):
        y = top + r * (CONTACT_FRAME_INCHES + CONTACT_GAP_INCHES) + CONTACT_FRAME_INCHES / 2
        sheet.text(CONTACT_MARGIN_INCHES - 0.17, y, words, rotation=90, ha="center", va="center", color=TRUTH_COLOUR)


def _draw_contact_shares(sheet: Sheet, top: float, surfaces: tuple[ContactSurface, ContactSurface]) -> None:
    """Draw the share of frames in contact, on each surface from two sides."""
    for k, words in enumerate(CONTACT_VIEW_LABELS):
        x = CONTACT_MARGIN_INCHES + k * (CONTACT_SHARE_INCHES + CONTACT_GAP_INCHES)
        sheet.text(x, top - 0.2, words, color=TRUTH_COLOUR, fontsize=8)
        picture = surfaces[k // 2].over_all(k % 2, sheet.pixels(CONTACT_SHARE_INCHES))
        show_picture(sheet.tile(x, top, CONTACT_SHARE_INCHES), picture)


def _draw_shares_legend(sheet: Sheet, x: float, top: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap

    ramp = ScalarMappable(cmap=LinearSegmentedColormap.from_list("share", CONTACT_SHARE_COLOURS))
    ramp.set_clim(0.0, 100.0)
    bar = sheet.axes(x, top, IOU_MATRIX_INCHES, 0.11)
    sheet.text(x, top - 0.2, "share of all frames in contact", color=TRUTH_COLOUR)
    _draw_colour_bar(sheet, ramp, bar, "horizontal", [0, 50, 100], ["0 %", "50 %", "100 %"])
    first, _, last = bar.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    sheet.text(x, top + 0.5, "in single frames: red in contact, grey not", color=MUTED_COLOUR)


def _draw_iou_matrix(sheet: Sheet, x: float, top: float, view: View, definition: ContactDefinition) -> None:
    """Draw the contact IOU of all pairs of frames, by the definition of the stable contact area."""
    from matplotlib.colors import LinearSegmentedColormap

    clip, T = view.clip, len(view.result.frames)
    track = ObjectTrack(view.result.T_hand_obj, view.result.scale)
    margin = definition.threshold + 1e-3
    (distances,) = contact_distances(clip.mesh, [track], clip.hand.vertices, clip.hand.faces, margin)
    iou = pairwise_iou(distances.contact(definition.side, definition.threshold))
    axes = sheet.axes(x, top, IOU_MATRIX_INCHES, IOU_MATRIX_INCHES)
    colours = LinearSegmentedColormap.from_list("contact", IOU_RAMP)
    drawn = axes.imshow(iou, extent=(0, T, T, 0), vmin=0.0, vmax=1.0, cmap=colours, interpolation="nearest")
    axes.set_xlabel(f"frame of the {'clip' if view.of_truth else 'result'}, counted from 0")
    axes.tick_params(length=2)
    draw_border(axes)
    sheet.text(x, top - 0.19, "contact IOU of every pair of frames", color=TRUTH_COLOUR)
    bar = sheet.axes(x + IOU_MATRIX_INCHES + 0.12, top, 0.11, IOU_MATRIX_INCHES)
    _draw_colour_bar(sheet, drawn, bar, "vertical", [0, 0.5, 1], ["0", "0.5", "1"])
    if T > 1:
        words = f"stable contact area (SCA) {100.0 * stable_contact_area(iou):.1f} %:\nthe mean of the pairs"
        sheet.text(x, top + IOU_MATRIX_INCHES + 0.5, words, fontsize=9.5, linespacing=1.4)
    sheet.text(x, top + IOU_MATRIX_INCHES + 0.92, definition.description, color=MUTED_COLOUR)


def _draw_colour_bar(
    sheet: Sheet, drawn: ScalarMappable, axes: Axes, way: str, ticks: Sequence[float], labels: Sequence[str]
) -> None:
    bar = sheet.figure.colorbar(drawn, cax=axes, orientation=way)
    bar.outline.set_edgecolor(LINE_COLOUR)
    bar.set_ticks(ticks, labels=labels)
    axes.tick_params(length=2)
