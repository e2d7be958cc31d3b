"""Frames of a grasp aligned in the hand frame, and in the object frame, which shows their relative motion (Fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.bench.figures.kind import (
    Count,
    Fail,
    FigureKind,
    evenly_spaced_indices,
    require_one_result,
    summarise_view,
)
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.rasterize import Colour, Surface, depth_and_face, render_rgb
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    HAND_RGB,
    OBJECT_RGB,
    PAPER_RGB,
    SHEET_TITLE_INCHES,
    TRUTH_COLOUR,
    DistantCamera,
    Sheet,
    axis_points,
    content_windows,
    draw_axis_line,
    draw_border,
    draw_contour,
    draw_rendered,
    look_at,
    show_picture,
)
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import StoredResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALIGNED_FRAME_INCHES, ALIGNED_VIEW_INCHES, ALIGNED_GAP_INCHES = 1.72, 2.16, 0.08
"""Sides of the tiles of frames and of the aligned views, and the gap between them [in]."""
ANGLE_COLOURS = ("#2f5f8a", "#8662b5", "#cf5f9e", "#e3a21f", "#b8352a")
"""Colours of frames, by angle."""
ALIGNED_PANELS = tuple(f"{fixed} fixed, {way} the axis" for fixed in ("hand", "object") for way in ("across", "along"))
AXISLESS_PANELS = tuple(f"{fixed} fixed, from the {way}" for fixed in ("hand", "object") for way in ("camera", "side"))
"""Headings of panels, with and without an axis."""


@dataclass(frozen=True, kw_only=True)
class Aligned(FigureKind):
    """Frames of one result aligned in the hand frame, where the object turns about the axis, and in the object's frame.

    Frames are spread evenly over the angle about the axis; without an axis, over time. Of a clip the ground truth is
    drawn, with the axis nearest to its motion.
    """

    draws_truth: ClassVar[bool] = True
    frames: Count = 5
    """Frames to draw."""

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        view = require_one_result(results, "aligned")
        chosen, colours = self._frames(view)
        upper_width = len(chosen) * (ALIGNED_FRAME_INCHES + ALIGNED_GAP_INCHES)
        width = 0.25 + max(upper_width, 4 * (ALIGNED_VIEW_INCHES + ALIGNED_GAP_INCHES)) + 0.17
        lower = SHEET_TITLE_INCHES + 0.28 + ALIGNED_FRAME_INCHES + 0.5
        sheet = Sheet.of(width, lower + ALIGNED_VIEW_INCHES + 0.45, self.dpi)
        sheet.title(view.clip.name, summarise_view(view))
        self._as_seen(sheet, view, chosen, colours)
        panels = ALIGNED_PANELS if view.result.axis is not None else AXISLESS_PANELS
        for k, words in enumerate(panels):
            x = 0.25 + k * (ALIGNED_VIEW_INCHES + ALIGNED_GAP_INCHES)
            sheet.text(x, lower - 0.24, words, color=TRUTH_COLOUR, fontsize=9)
            self._aligned(sheet, x, lower, view, chosen, colours, fixed_hand=k < 2, along=k % 2 == 1)
        if view.result.axis is None:
            words = "the method has no latent axis  ·  contours: the frames above, in the colours of their borders"
            sheet.text(0.25, sheet.height - 0.31, words)
        else:
            which = "nearest" if view.of_truth else "latent"
            sheet.legend(0.25, sheet.height - 0.36, [(AXIS_COLOUR, f"{which} axis, pale where hidden")])
            sheet.text(2.9, sheet.height - 0.31, "contours: the frames above, in the colours of their borders")
        return sheet.figure

    def _frames(self, view: View) -> tuple[Int[ndarray, "n"], list[str]]:
        """Choose the frames to draw and their colours, in order of the angle about the axis, without one of time."""
        from matplotlib.colors import LinearSegmentedColormap, to_hex

        axis, T = view.result.axis, len(view.result.frames)
        if axis is None:
            chosen = np.array(evenly_spaced_indices(self.frames, T))
        else:
            wanted = np.linspace(axis.angle.min(), axis.angle.max(), min(self.frames, T))
            nearest = np.array([int(np.argmin(np.abs(axis.angle - angle))) for angle in wanted])
            chosen = nearest[np.sort(np.unique(nearest, return_index=True)[1])]
        ramp = LinearSegmentedColormap.from_list("angle", ANGLE_COLOURS)
        return chosen, [to_hex(ramp(t)) for t in np.linspace(0.0, 1.0, len(chosen))]

    def _as_seen(self, sheet: Sheet, view: View, chosen: Int[ndarray, "n"], colours: Sequence[str]) -> None:
        """Draw the frames from the camera, each with its angle and a border of its colour."""
        axis = view.result.axis
        crops = content_windows([view], chosen, sheet.pixels(ALIGNED_FRAME_INCHES))
        for k, (n, colour) in enumerate(zip(chosen, colours, strict=True)):
            x = 0.25 + k * (ALIGNED_FRAME_INCHES + ALIGNED_GAP_INCHES)
            tile = sheet.tile(x, SHEET_TITLE_INCHES + 0.28, ALIGNED_FRAME_INCHES)
            draw_rendered(tile, view, int(n), crops, k, from_side=False)
            draw_border(tile, colour, 2.4)
            turned = 0.0 if axis is None else np.degrees(axis.angle[n] - axis.angle[chosen[0]])
            angle = "" if axis is None else f"{turned:+.1f}°  ·  " if k else "0°  ·  "
            heading = f"{angle}frame {view.result.frames[n]}"
            sheet.text(x, SHEET_TITLE_INCHES + 0.06, heading, color=colour, fontweight="bold")

    def _aligned(
        self, sheet: Sheet, x: float, top: float, view: View, chosen: Int[ndarray, "n"], colours: Sequence[str],
        fixed_hand: bool, along: bool,
    ) -> None:  # fmt: skip
        """Draw all frames in one view, aligned to the hand or the object of the middle frame."""
        from matplotlib.colors import to_rgb

        result, clip = view.result, view.clip
        middle = int(chosen[len(chosen) // 2])
        surfaces = [se3.transform(result.T_hand_obj[n], result.scale * clip.mesh.vertices) for n in chosen]
        # For a fixed object: transforms that move each frame's object to its pose in the middle frame.
        fix = [result.T_hand_obj[middle] @ se3.inverse(result.T_hand_obj[n]) for n in chosen]
        hands = [se3.transform(T, clip.hand.vertices[n]) for T, n in zip(fix, chosen, strict=True)]
        if fixed_hand:
            one, many, faces = (clip.hand.vertices[middle], clip.hand.faces), surfaces, clip.mesh.faces
        else:
            one, many, faces = (surfaces[len(chosen) // 2], clip.mesh.faces), hands, clip.hand.faces
        eye = _place_camera(view, middle, np.concatenate([one[0], *many]), along, sheet.pixels(ALIGNED_VIEW_INCHES))
        moved = [(se3.transform(eye.T_view_frame, vertices), faces) for vertices in many]
        still = (se3.transform(eye.T_view_frame, one[0]), one[1])
        tile = sheet.tile(x, top, ALIGNED_VIEW_INCHES)
        draw_border(tile)
        whole = (HAND_RGB, OBJECT_RGB) if fixed_hand else (OBJECT_RGB, HAND_RGB)
        show_picture(tile, _blend_surfaces(still, moved, whole, np.array([to_rgb(colour) for colour in colours]), eye))
        for surface, colour in zip(moved, colours, strict=True):
            draw_contour(tile, *surface, eye.K, eye.size, colour, halo=False)
        if result.axis is not None:
            line = se3.transform(eye.T_view_frame, axis_points(view))
            if along:
                dot = project(eye.K, line[200:201]).T
                tile.plot(*dot, "o", color=AXIS_COLOUR, markersize=6, markeredgecolor="white")
            else:
                draw_axis_line(tile, line, [still, *moved], eye.K, eye.size)


def _place_camera(view: View, middle: int, points: Float[ndarray, "n 3"], along: bool, size: int) -> DistantCamera:
    """Look across or along the axis, as near to the camera's direction as possible; up is the camera's."""
    R = view.clip.hand.T_cam_hand[middle, :3, :3].T  # camera to hand
    camera, up = -R[:, 2], -R[:, 1]
    axis = view.result.axis
    if axis is None:
        return look_at(points, R[:, 0] if along else camera, up, size)
    a = axis.direction
    if along:
        return look_at(points, a if a @ camera >= 0.0 else -a, up, size)
    across = camera - (camera @ a) * a
    return look_at(points, across, up, size)


def _blend_surfaces(
    still: Surface, moved: Sequence[Surface], whole: tuple[Colour, Colour], colours: Float[ndarray, "n 3"],
    eye: DistantCamera,
) -> UInt8[ndarray, "size size 3"]:  # fmt: skip
    """Render ``still`` opaque, and the ``moved`` surfaces blended over it, in ``colours`` where they disagree.

    ``whole`` are the colours of the still surface, and of the moved ones where all agree.
    """
    fine, size = np.diag([2.0, 2.0, 1.0]) @ eye.K, (2 * eye.size, 2 * eye.size)
    picture = render_rgb([(*still, whole[0])], fine, size, PAPER_RGB).astype(float)
    behind = depth_and_face(*still, fine, size)[0]
    light, tint = np.zeros_like(picture), np.zeros_like(picture)
    count = np.zeros((*picture.shape[:2], 1))
    for surface, colour in zip(moved, colours, strict=True):
        visible = depth_and_face(*surface, fine, size)[0] < behind
        light[visible] += render_rgb([(*surface, (1.0, 1.0, 1.0))], fine, size)[visible]
        tint[visible] += colour
        count[visible] += 1.0
    agree, each = count / len(moved), np.maximum(count, 1.0)
    blend = light / each * (agree * np.array(whole[1]) + (1.0 - agree) * tint / each)
    weight = np.where(count > 0.0, 0.4 + 0.4 * agree, 0.0)
    picture = (1.0 - weight) * picture + weight * blend
    return np.asarray(np.round(picture.reshape(eye.size, 2, eye.size, 2, 3).mean(axis=(1, 3))), dtype=np.uint8)
