"""Building blocks of pictures, in this order.

Colours and font; a distant camera for a rendering from any side; a sheet laid out in inches, with titles, square tiles
and legends; and a tile's content: a result over the image, or rendered from the camera or the side, with its axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import Crops, bounding_boxes, project
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import (
    MIN_ZBUFFER_DEPTH_M,
    Surface,
    depth_and_face,
    render_coverage,
    render_rgb,
)
from getagrip.io.images import read_image
from getagrip.report.pictures.result_view import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_COLOUR, INK_COLOUR, MUTED_COLOUR, LINE_COLOUR = "#f4f4f1", "#2b2f33", "#8a9096", "#d9dad6"
RESULT_COLOUR, TRUTH_COLOUR, HAND_LINE_COLOUR = "#c8553d", "#6c757d", "#7b5ea7"
AXIS_COLOUR, HIDDEN_AXIS_COLOUR = "#2a9d8f", "#a8e0d5"
STATE_COLOURS = {"static": "#6f9a8d", "contact": "#e0a458", "grasp": "#c8553d", "free": "#7b5ea7", "unknown": "#d9dad6"}
"""Colours of the states in a timeline's bar."""
HAND_RGB, OBJECT_RGB = (0.87, 0.72, 0.63), (0.44, 0.58, 0.69)
"""Colours of rendered surfaces, of an object where its mesh has none."""
PAPER_RGB = (0xF4 / 255.0, 0xF4 / 255.0, 0xF1 / 255.0)
"""``PAPER_COLOUR`` for rendered pictures."""
BLANK_RGB, OBSERVED_MASK_RGB, IGNORED_MASK_RGB = (244, 244, 241), (126, 158, 184), (216, 200, 186)
"""Pixel colours of masks that are drawn in place of a missing image: neither, object, ignored."""


def figure_style() -> AbstractContextManager[None]:
    """Set the project's font and colours of text and axes for figures drawn in this context."""
    from matplotlib import rc_context

    return rc_context(
        {
            "font.family": "DejaVu Sans",
            "font.size": 8.5,
            "text.color": INK_COLOUR,
            "axes.edgecolor": LINE_COLOUR,
            "axes.labelcolor": MUTED_COLOUR,
            "xtick.color": MUTED_COLOUR,
            "ytick.color": MUTED_COLOUR,
        }
    )


CAMERA_DISTANCE_RADII = 8.0
"""Distance in radii of the points: nearly an orthographic view."""
TILE_FILL_FRACTION = 0.92
"""Fraction of the tile's side that the points span."""


@dataclass(frozen=True, eq=False)
class DistantCamera:
    """A camera: ``T_view_frame`` maps the points' frame to the view frame [m], ``K`` that to ``size`` pixels."""

    T_view_frame: Float[ndarray, "4 4"]
    K: Float[ndarray, "3 3"]
    size: int


def look_at(
    points: Float[ndarray, "n 3"], side: Float[ndarray, "3"], up: Float[ndarray, "3"], size: int
) -> DistantCamera:
    """Place a camera that sees all points from the direction ``side``, with ``up`` upwards; lengths do not matter.

    Where ``up`` is parallel to ``side``, or either is zero, a coordinate axis replaces it.
    """
    forward = -_normalise_or(side, np.array([0.0, 0.0, 1.0]))
    axis = np.eye(3)[np.argmin(np.abs(forward))]
    across, other = (_orthogonal_component(np.asarray(v, dtype=float), forward) for v in (up, axis))
    down = -_normalise_or(across, other)
    R = np.stack([np.cross(down, forward), down, forward])
    seen = points @ R.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    radius = float(np.linalg.norm(high - low)) / 2.0
    t = np.array([0.0, 0.0, CAMERA_DISTANCE_RADII * radius]) - (low + high) / 2.0
    nearest = CAMERA_DISTANCE_RADII * radius - (high[2] - low[2]) / 2.0
    f = TILE_FILL_FRACTION * size * nearest / float((high - low)[:2].max())
    K = np.array([[f, 0.0, size / 2.0], [0.0, f, size / 2.0], [0.0, 0.0, 1.0]])
    return DistantCamera(se3.rigid(R, t), K, size)


def _orthogonal_component(v: Float[ndarray, "3"], along: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    return np.asarray(v - (v @ along) * along)


def _normalise_or(v: Float[ndarray, "3"], instead: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    length = float(np.linalg.norm(v))
    return np.asarray(v / length if length > 1e-9 else instead / np.linalg.norm(instead))


SHEET_TITLE_INCHES = 0.78
"""Height of a sheet's title and subtitle [in]."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A figure laid out in inches from its top left corner, with ``dpi`` pixels an inch."""

    figure: Figure
    width: float
    height: float
    dpi: int

    @staticmethod
    def of(width: float, height: float, dpi: int) -> Sheet:
        """Make an empty sheet; its size is rounded up to whole pixels."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        width, height = np.ceil(width * dpi) / dpi, np.ceil(height * dpi) / dpi
        figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
        FigureCanvasAgg(figure)
        return Sheet(figure, width, height, dpi)

    def pixels(self, inches: float) -> int:
        """Convert a length to pixels."""
        return round(inches * self.dpi)

    def axes(self, x: float, top: float, width: float, height: float) -> Axes:
        """Add axes with the top left corner at ``x`` and ``top`` [in]."""
        return self.figure.add_axes(
            (x / self.width, 1.0 - (top + height) / self.height, width / self.width, height / self.height)
        )

    def tile(self, x: float, top: float, side: float) -> Axes:
        """Add square axes in pixel coordinates, without ticks."""
        size, axes = self.pixels(side), self.axes(x, top, side, side)
        axes.set(xticks=[], yticks=[], xlim=(0, size), ylim=(size, 0), facecolor=PAPER_COLOUR)
        return axes

    def text(self, x: float, top: float, words: str, within: float = np.inf, **style: Any) -> None:
        """Write words verbatim: a dollar sign in a name begins no formula.

        Words wider than ``within`` [in] are shortened in the middle, since names of clips differ at their ends.
        """
        style = {"va": "top", "color": INK_COLOUR} | style
        text = self.figure.text(x / self.width, 1.0 - top / self.height, words, parse_math=False, **style)
        kept = len(words)
        while kept > 1 and text.get_window_extent().width > within * self.dpi:
            kept -= 1
            text.set_text(f"{words[: (kept + 1) // 2].rstrip()}...{words[len(words) - kept // 2 :].lstrip()}")

    def title(self, words: str, under: str) -> None:
        """Write the title and the subtitle, of height ``SHEET_TITLE_INCHES``."""
        self.text(0.25, 0.17, words, self.width - 0.4, fontsize=13, fontweight="bold")
        self.text(0.25, 0.47, under, self.width - 0.4, fontsize=9.5, color=MUTED_COLOUR)

    def legend(self, x: float, top: float, entries: Sequence[tuple[str, str]], style: str = "line") -> None:
        """Draw (colour, meaning) entries side by side, in the ``style`` line, dots or square."""
        from matplotlib.lines import Line2D

        drawn = {
            "line": partial(Line2D, linewidth=2.0),
            "dots": partial(Line2D, linewidth=2.0, linestyle=(0, (1, 1.2))),
            "square": partial(Line2D, linewidth=0.0, marker="s", markersize=8.0),
        }
        handles = [drawn[style]([], [], color=colour) for colour, _ in entries]
        axes = self.axes(x, top, self.width - x - 0.1, 0.22)
        axes.set_axis_off()
        axes.legend(
            handles, [words for _, words in entries], loc="center left", bbox_to_anchor=(0.0, 0.5), ncols=len(entries),
            frameon=False, borderpad=0.0, borderaxespad=0.0, handlelength=1.6, columnspacing=1.6,
        )  # fmt: skip


def draw_border(axes: Axes, colour: str = LINE_COLOUR, width: float = 0.8) -> None:
    """Draw a border of a colour around axes."""
    for spine in axes.spines.values():
        spine.set(edgecolor=colour, linewidth=width)


SIDE_VIEW_ANGLE_RAD = np.radians(80.0)
"""Angle of the side view, to the left of the camera."""
CROP_MARGIN_FACTOR = 1.10
"""Size of windows, relative to the content."""
AxisLine = tuple[Float[ndarray, "n 2"], Bool[ndarray, "n"]]
"""The latent axis in a picture: points [px], and True for visible ones."""


def content_windows(views: Sequence[View], frames: Int[ndarray, "n"], size: int) -> Crops:
    """Return square windows of one size around hand and object of all views, at the same frames of one clip."""
    shown = [[seen_points(v, n, np.concatenate([v.hand(n), v.object(n)])) for v in views] for n in frames]
    return _square_windows(shown, size)


def input_windows(views: Sequence[View], frames: Int[ndarray, "n"], size: int) -> Crops:
    """Return windows around hands and observed masks, whose size a wrong, distant object does not affect."""
    shown = []
    for n in frames:
        shown.append([seen_points(view, n, view.hand(n)) for view in views])
        for masks in (view.masks for view in views if view.masks is not None and view.masks.object[n].any()):
            shown[-1].append(bounding_boxes(masks.object[n : n + 1]).reshape(2, 2).astype(float))
    return _square_windows(shown, size)


def seen_points(view: View, n: int, points: Float[ndarray, "_n 3"]) -> Float[ndarray, "_m 2"]:
    """Project points of frame ``n``; the image's corners if some are behind its camera."""
    if points[:, 2].min() > MIN_ZBUFFER_DEPTH_M:
        return project(view.clip.K[n], points)
    return np.array([(0.0, 0.0), view.clip.size])


def _square_windows(shown: Sequence[Sequence[Float[ndarray, "_n 2"]]], size: int) -> Crops:
    low = np.array([np.concatenate(points).min(axis=0) for points in shown])
    high = np.array([np.concatenate(points).max(axis=0) for points in shown])
    side = CROP_MARGIN_FACTOR * float((high - low).max())
    return Crops(corner=(low + high - side) / 2.0, side=side, size=size)


def draw_over_image(axes: Axes, view: View, n: int, crops: Crops, k: int, with_hand: bool = False) -> None:
    """Draw the image or the masks in window ``k``, the object's contour and, with ``with_hand``, the hands'."""
    show_picture(axes, crop_image(view, n, crops, k))
    K = window_intrinsics(view, n, crops, k)
    if with_hand:
        for hand in view.hands(n):
            draw_contour(axes, *hand, K, crops.size, HAND_LINE_COLOUR)
    if len((found := view.surface(n))[1]):
        draw_contour(axes, *found, K, crops.size, RESULT_COLOUR)


def crop_image(view: View, n: int, crops: Crops, k: int) -> UInt8[ndarray, "size size 3"]:
    """Return the image or the masks of frame ``n`` in window ``k``."""
    shift = -crops.corner[k] * crops.zoom
    centre = shift + crops.zoom / 2.0 - 0.5  # cv2 counts from the centre of the first pixel
    warp = np.array([[crops.zoom, 0.0, centre[0]], [0.0, crops.zoom, centre[1]]])
    image, size = _frame_image(view, n), (crops.size, crops.size)
    picture = cv2.warpAffine(image, warp, size, borderMode=cv2.BORDER_CONSTANT, borderValue=BLANK_RGB)
    return np.asarray(picture, dtype=np.uint8)


def draw_rendered(axes: Axes, view: View, n: int, crops: Crops, k: int, from_side: bool) -> None:
    """Draw hand, object and axis in window ``k``, from the camera, or from the side at the same scale if it fits."""
    picture, line = render_posed(view, n, crops, k, from_side)
    show_picture(axes, picture)
    if line is not None:
        _draw_axis_segments(axes, *line)


def render_posed(
    view: View, n: int, crops: Crops, k: int, from_side: bool
) -> tuple[UInt8[ndarray, "size size 3"], AxisLine | None]:
    """Render hand and object in window ``k``, as ``draw_rendered`` shows it; also return the axis, None without one."""
    K, size = window_intrinsics(view, n, crops, k), crops.size
    hand, (grasped, faces) = view.hand(n), view.surface(n)
    T_view_cam = np.eye(4)
    if from_side:
        both = np.concatenate([hand, grasped])
        middle = (both.min(axis=0) + both.max(axis=0)) / 2.0
        R = se3.exp_so3(np.array([0.0, -SIDE_VIEW_ANGLE_RAD, 0.0]))
        T_view_cam = se3.rigid(R, np.array([0.0, 0.0, np.linalg.norm(middle)]) - R @ middle)
        K = np.array([[K[0, 0], 0.0, size / 2.0], [0.0, K[1, 1], size / 2.0], [0.0, 0.0, 1.0]])
    others = [(se3.transform(T_view_cam, v), f) for v, f in view.hands(n)[1:]]
    hand, grasped = se3.transform(T_view_cam, hand), se3.transform(T_view_cam, grasped)
    if from_side:  # else an object far before or behind the hand is cut off
        reach = np.abs(project(K, np.concatenate([hand, grasped])) - size / 2.0).max()
        K[:2, :2] *= min(1.0, 0.48 * size / reach)
    colours = object_rgb(view.clip.mesh) if view.frame_meshes is None else OBJECT_RGB
    meshes = [(hand, view.clip.hand.faces, HAND_RGB), *(((grasped, faces, colours),) if len(faces) else ())]
    meshes += [(*other, HAND_RGB) for other in others]
    picture = render_rgb(meshes, K, (size, size), PAPER_RGB)
    if view.result.axis is None:
        return picture, None
    line = se3.transform(T_view_cam @ view.clip.hand.T_cam_hand[n], axis_points(view))
    return picture, _project_visible(line, [mesh[:2] for mesh in meshes], K, size)


def object_rgb(mesh: Mesh) -> tuple[float, float, float] | Float[ndarray, "V 3"]:
    """Return the colours in which a mesh is rendered, 0 to 1: its own, else ``OBJECT_RGB``."""
    return OBJECT_RGB if mesh.colours is None else mesh.colours / 255.0


def axis_points(view: View) -> Float[ndarray, "n 3"]:
    """Return the latent axis as a line through the object, in the hand frame [m]."""
    axis, mesh, scale = view.result.axis, view.clip.mesh, view.result.scale
    assert axis is not None
    middle = se3.transform(view.result.T_hand_obj, scale * mesh.centre[None])[:, 0].mean(axis=0)
    nearest = axis.point + axis.direction * float((middle - axis.point) @ axis.direction)
    return np.asarray(nearest + np.linspace(-0.85, 0.85, 400)[:, None] * scale * mesh.diameter * axis.direction)


def draw_axis_line(
    axes: Axes, line: Float[ndarray, "n 3"], surfaces: Sequence[Surface], K: Float[ndarray, "3 3"], size: int
) -> None:
    """Draw a line in the view frame: solid where visible, dotted where one of the surfaces hides it."""
    _draw_axis_segments(axes, *_project_visible(line, surfaces, K, size))


def _project_visible(
    line: Float[ndarray, "n 3"], surfaces: Sequence[Surface], K: Float[ndarray, "3 3"], size: int
) -> AxisLine:
    """Project a line into a picture, and find the points that no surface hides."""
    line = line[line[:, 2] > 0.05]
    uv = project(K, line)
    depth = np.min([depth_and_face(*surface, K, (size, size))[0] for surface in surfaces], axis=0)
    column, row = np.clip(np.floor(uv).astype(int), 0, size - 1).T
    return uv, line[:, 2] < depth[row, column] + 1e-3


def _draw_axis_segments(axes: Axes, uv: Float[ndarray, "n 2"], visible: Bool[ndarray, "n"]) -> None:
    shown, hidden = np.where(visible[:, None], uv, np.nan), np.where(visible[:, None], np.nan, uv)
    axes.plot(*shown.T, color="white", linewidth=3.0, alpha=0.7)
    axes.plot(*shown.T, color=AXIS_COLOUR, linewidth=1.6)
    axes.plot(*hidden.T, color=HIDDEN_AXIS_COLOUR, linewidth=1.3, linestyle=(0, (1, 1.6)))


def show_picture(axes: Axes, picture: UInt8[ndarray, "H W 3"]) -> None:
    """Fill a tile with a picture."""
    size = len(picture)
    axes.imshow(picture, extent=(0, size, size, 0), interpolation="antialiased")


def draw_contour(
    axes: Axes,
    vertices: Float[ndarray, "_V 3"],
    faces: Int[ndarray, "_F 3"],
    K: Float[ndarray, "3 3"],
    size: int,
    colour: str,
    halo: bool = True,
) -> None:
    """Draw the boundary of a surface's silhouette, with a white halo for contrast."""
    for line in silhouette_lines(vertices, faces, K, size):
        if halo:
            axes.plot(*line.T, color="white", linewidth=2.6, alpha=0.8, solid_joinstyle="round")
        axes.plot(*line.T, color=colour, linewidth=1.3, solid_joinstyle="round")


def silhouette_lines(
    vertices: Float[ndarray, "_V 3"], faces: Int[ndarray, "_F 3"], K: Float[ndarray, "3 3"], size: int
) -> list[Float[ndarray, "_n 2"]]:
    """Return the closed lines that bound a surface's silhouette in a picture [px]."""
    fine = np.diag([2.0, 2.0, 1.0]) @ K  # else the contour follows the picture's pixels
    return [line / 2.0 for line in mask_contours(render_coverage(vertices, faces, fine, (2 * size, 2 * size)))]


def window_intrinsics(view: View, n: int, crops: Crops, k: int) -> Float[ndarray, "3 3"]:
    """Return the intrinsics of window ``k``, which shows frame ``n``."""
    return np.asarray(replace(crops, corner=crops.corner[k : k + 1]).intrinsics(view.clip.K[n : n + 1])[0])


def _frame_image(view: View, n: int) -> UInt8[ndarray, "H W 3"]:
    """Read the frame's image or, without one, draw its masks."""
    if (file := view.image_file(n)) is not None:
        return read_image(file, view.clip.size)
    width, height = view.clip.size
    picture = np.full((height, width, 3), BLANK_RGB, dtype=np.uint8)
    if view.masks is not None:
        ignored = view.masks.ignore[n]
        picture[ignored & ~ignored.all()] = IGNORED_MASK_RGB  # all of them: the mask is not known
        picture[view.masks.object[n]] = OBSERVED_MASK_RGB
    return picture


def mask_contours(mask: Bool[ndarray, "H W"]) -> list[Float[ndarray, "_n 2"]]:
    """Return closed boundary lines of a mask, in pixel coordinates."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    lines = [contour[:, 0].astype(float) + 0.5 for contour in contours if len(contour) > 8]
    return [np.concatenate([line, line[:1]]) for line in lines]
