"""One picture of a reconstruction: over the images, from the camera and from the side, and the motion over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from getagrip.clip import Clip, Masks, check_masks
from getagrip.errors import InputError
from getagrip.evaluation.metric import ADD_MM, ADD_SYM_MM, ROTATION_SYM
from getagrip.fitting.methods import method_of
from getagrip.geometry import se3
from getagrip.geometry.camera import Crops, project
from getagrip.geometry.depth import depth_and_face
from getagrip.geometry.render import render_rgb
from getagrip.result import Reconstruction
from getagrip.view.style import AXIS, FAINT, FOUND, HIDDEN, INK, LINE, PAPER, TRUE, letters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TILES = 5
"""Frames shown."""
TILE = 320
"""Side of a tile [px]."""
LETTERS = 150
"""In a line of a finding."""
SIDE_VIEW = np.radians(80.0)
"""The side view looks from this far to the left."""
SHOWN = {"ADD": ADD_MM, "ADD sym.": ADD_SYM_MM, "rotation": ROTATION_SYM}
"""Metrics in the title, each under a short name."""
HAND, OBJECT = (0.87, 0.72, 0.63), (0.44, 0.58, 0.69)
OBSERVED, IGNORED = (126, 158, 184), (216, 200, 186)


def write_report(
    result: Reconstruction,
    clip: Clip,
    masks: Masks | None,
    path: str | Path,
    metrics: Mapping[str, float] | None = None,
) -> Path:
    """Write ``report_figure`` as a PNG and return its path. Raises as it does."""
    report_figure(result, clip, masks, metrics).savefig(path, facecolor="white")
    return Path(path)


def report_figure(
    result: Reconstruction, clip: Clip, masks: Masks | None, metrics: Mapping[str, float] | None = None
) -> Figure:
    """The picture as a matplotlib figure: three rows of tiles, one tile per frame shown, above two plots over time.

    ``clip`` and ``masks`` may have more frames than the result. ``metrics`` are those of ``evaluate``; those in
    ``SHOWN`` are shown if given. Images are read from the clip's folder where it has them; without images the masks are
    drawn. Raises ``InputError`` for a frame of the result that is none of the clip's, and ``UsageError`` for masks of
    another clip or an unknown method.
    """
    if masks is not None:
        check_masks(clip, masks)
    index = clip.index_of(result.frames)
    view = _View(clip.take(index).with_hand_at(result.T_cam_hand), None if masks is None else masks.take(index), result)
    return _draw(view, metrics or {})


@dataclass(frozen=True)
class _View:
    """A result with the clip's and the masks' frames beside it."""

    clip: Clip
    masks: Masks | None
    result: Reconstruction

    def hand(self, n: int) -> Float[ndarray, "V 3"]:
        """The hand in the camera frame [m]."""
        return se3.transform(self.clip.hand.T_cam_hand[n], self.clip.hand.vertices[n])

    def object(self, n: int) -> Float[ndarray, "V 3"]:
        """The reconstructed object in the camera frame [m]."""
        T_cam_obj = self.clip.hand.T_cam_hand[n] @ self.result.T_hand_obj[n]
        return se3.transform(T_cam_obj, self.result.scale * self.clip.mesh.vertices)

    def crops(self, frames: Int[ndarray, "n"]) -> Crops:
        """Square windows of one size around hand and object."""
        boxes = []
        for n in frames:
            uv = project(self.clip.K[n], np.concatenate([self.hand(n), self.object(n)]))
            boxes.append(np.concatenate([uv.min(axis=0), uv.max(axis=0)]))
        low, high = np.split(np.array(boxes), 2, axis=1)
        side = 1.10 * float((high - low).max())
        return Crops(corner=(low + high - side) / 2.0, side=side, size=TILE)


def _draw(view: _View, metrics: Mapping[str, float]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with letters():
        left, right, gap, tile = 0.62, 0.25, 0.08, 2.3  # inches
        width = left + right + TILES * tile + (TILES - 1) * gap
        found = [str(finding) for finding in view.result.findings]
        lines = [line for text in found for line in wrap(text, LETTERS)]
        head, foot, plots, between = 1.22 + 0.2 * len(lines), 0.48, 1.75, 0.62
        height = head + 3 * tile + 2 * gap + between + plots + foot
        figure = Figure(figsize=(width, height), dpi=130)
        FigureCanvasAgg(figure)

        def place(x: float, top: float, w: float, h: float) -> Axes:
            return figure.add_axes((x / width, 1.0 - (top + h) / height, w / width, h / height))

        _title(figure, view, metrics, left / width, 1.0 - 0.2 / height, 0.27 / height)
        figure.text(left / width, 1.0 - 1.02 / height, "\n".join(lines), color=FOUND, fontsize=9.5, va="top")
        frames = np.unique(np.linspace(0, len(view.result.frames) - 1, TILES).round().astype(int))
        crops = view.crops(frames)
        rows = ("input and fitted contour", "result, from the camera", "result, from the side")
        for row, label in enumerate(rows):
            top = head + row * (tile + gap)
            figure.text(0.35 / width, 1.0 - (top + tile / 2) / height, label, rotation=90, ha="center", va="center")
            for k, n in enumerate(frames):
                axes = place(left + k * (tile + gap), top, tile, tile)
                axes.set(xticks=[], yticks=[], xlim=(0, TILE), ylim=(TILE, 0), facecolor=PAPER)
                K = crops.intrinsics(view.clip.K[frames])[k]
                if row == 0:
                    _over_image(axes, view, int(n), crops, k, K)
                else:
                    _rendered(axes, view, int(n), K, from_side=row == 2)
        top = head + 3 * tile + 2 * gap + between
        half = (width - left - right - 0.75) / 2.0
        _angle_plot(place(left, top, half, plots), view)
        _iou_plot(place(left + half + 0.75, top, half, plots), view)
    return figure


def _title(figure: Figure, view: _View, metrics: Mapping[str, float], x: float, y: float, step: float) -> None:
    result, clip = view.result, view.clip
    figure.text(x, y, clip.name, fontsize=15, fontweight="bold", va="top")
    facts = [
        method_of(result.method).label,
        _frames(result),
        f"{clip.side} hand",
    ]
    facts.append(f"scale {result.scale:.3f} is a guess" if clip.scale == "free" else "scale known")
    figure.text(x, y - 1.25 * step, "  ·  ".join(facts), color=FAINT, fontsize=9.5, va="top")
    figure.text(x, y - 2.0 * step, result.status, color=INK, fontsize=9.5, va="top")

    numbers = [("IOU", f"{100 * result.mean_iou:.1f} %")]
    for name, metric in SHOWN.items():
        if metric.name in metrics:
            unit = "°" if metric.unit == "deg" else f" {metric.unit}"
            numbers.append((name, f"{metric.text(metrics[metric.name])}{unit}"))
    if "total" in result.seconds:
        numbers.append(("time", f"{result.seconds['total']:.2f} s"))
    right = 0.98
    for name, number in numbers[::-1]:
        figure.text(right, y, number, fontsize=15, va="top", ha="right")
        figure.text(right, y - 1.25 * step, name, fontsize=9.5, color=FAINT, va="top", ha="right")
        right -= 0.092
    if result.ambiguous:
        warning = "ambiguous: another pose explains the masks almost as well"
        figure.text(0.98, y - 2.0 * step, warning, color=FOUND, fontsize=9.5, va="top", ha="right")


def _frames(result: Reconstruction) -> str:
    """How many frames there are and, where they differ, how their poses were found."""
    counts = Counter(result.frame_kind)
    kinds = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
    return f"{len(result.frames)} frames" + (f" ({kinds})" if len(counts) > 1 else "")


def _over_image(axes: Axes, view: _View, n: int, crops: Crops, k: int, K: Float[ndarray, "3 3"]) -> None:
    """The image or the masks, and the contour of the reconstructed object."""
    shift = -crops.corner[k] * crops.zoom
    centre = shift + crops.zoom / 2.0 - 0.5  # cv2 counts from the centre of the first pixel
    warp = np.array([[crops.zoom, 0.0, centre[0]], [0.0, crops.zoom, centre[1]]])
    picture = _image(view, n)
    grey = (244, 244, 241)
    tile = cv2.warpAffine(
        picture, warp, (TILE, TILE), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=grey
    )
    axes.imshow(tile, extent=(0, TILE, TILE, 0), interpolation="antialiased")
    fine = np.diag([2.0, 2.0, 1.0]) @ K  # else the contour shows the tile's pixels
    drawn = depth_and_face(view.object(n), view.clip.mesh.faces, fine, (2 * TILE, 2 * TILE))[1] >= 0
    for fine_line in _contours(drawn):
        line = fine_line / 2.0
        axes.plot(*line.T, color="white", linewidth=2.6, alpha=0.8, solid_joinstyle="round")
        axes.plot(*line.T, color=FOUND, linewidth=1.3, solid_joinstyle="round")
    axes.set_title(view.result.frames[n], fontsize=8.5, color=FAINT, pad=4)


def _image(view: _View, n: int) -> UInt8[ndarray, "H W 3"]:
    """The frame's image where the clip has one, else its masks in colours."""
    for suffix in (".jpg", ".png") if view.clip.folder else ():
        file = view.clip.origin / "frames" / f"{view.clip.frames[n]}{suffix}"
        if file.is_file():
            read = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if read is None:
                raise InputError(file, "", "a file that is no image", "an image")
            return np.asarray(read[..., ::-1], dtype=np.uint8)
    width, height = view.clip.size
    picture = np.full((height, width, 3), (244, 244, 241), dtype=np.uint8)
    if view.masks is not None:
        picture[view.masks.ignore[n]] = IGNORED
        picture[view.masks.object[n]] = OBSERVED
    return picture


def _rendered(axes: Axes, view: _View, n: int, K: Float[ndarray, "3 3"], from_side: bool) -> None:
    """Hand, object and axis, from the camera or from the side."""
    hand, held = view.hand(n), view.object(n)
    T_view_cam = np.eye(4)
    if from_side:
        both = np.concatenate([hand, held])
        middle = (both.min(axis=0) + both.max(axis=0)) / 2.0
        R = se3.exp_so3(np.array([0.0, -SIDE_VIEW, 0.0]))
        T_view_cam = se3.rigid(R, np.array([0.0, 0.0, np.linalg.norm(middle)]) - R @ middle)
        K = np.array([[K[0, 0], 0.0, TILE / 2.0], [0.0, K[1, 1], TILE / 2.0], [0.0, 0.0, 1.0]])
    hand, held = se3.transform(T_view_cam, hand), se3.transform(T_view_cam, held)
    meshes = [(hand, view.clip.hand.faces, HAND), (held, view.clip.mesh.faces, OBJECT)]
    paper = np.array([0xF4, 0xF4, 0xF1]) / 255.0
    axes.imshow(render_rgb(meshes, K, (TILE, TILE), tuple(paper)), extent=(0, TILE, TILE, 0))
    if view.result.axis is not None:
        T_view_hand = T_view_cam @ view.clip.hand.T_cam_hand[n]
        _axis_line(axes, view, T_view_hand, np.concatenate([hand, held]), K, (hand, held))


def _axis_line(
    axes: Axes,
    view: _View,
    T_view_hand: Float[ndarray, "4 4"],
    both: Float[ndarray, "V 3"],
    K: Float[ndarray, "3 3"],
    parts: tuple[Float[ndarray, "_ 3"], Float[ndarray, "_ 3"]],
) -> None:
    """The latent axis: a line where it is visible, dots where something is in front of it."""
    axis = view.result.axis
    assert axis is not None
    ends = view.result.scale * view.clip.mesh.diameter
    point = axis.point + axis.direction * _along(view, axis.point, axis.direction)
    line = se3.transform(T_view_hand, point + np.linspace(-0.85, 0.85, 400)[:, None] * ends * axis.direction)
    line = line[line[:, 2] > 0.05]
    uv = project(K, line)
    faces = np.concatenate([view.clip.hand.faces, view.clip.mesh.faces + len(parts[0])])
    depth, _ = depth_and_face(both, faces, K, (TILE, TILE))
    column, row = np.clip(np.floor(uv).astype(int), 0, TILE - 1).T
    visible = line[:, 2] < depth[row, column] + 1e-3
    axes.plot(*np.where(visible[:, None], uv, np.nan).T, color="white", linewidth=3.0, alpha=0.7)
    axes.plot(*np.where(visible[:, None], uv, np.nan).T, color=AXIS, linewidth=1.6)
    axes.plot(*np.where(visible[:, None], np.nan, uv).T, color=HIDDEN, linewidth=1.3, linestyle=(0, (1, 1.6)))


def _along(view: _View, point: Float[ndarray, "3"], direction: Float[ndarray, "3"]) -> float:
    """Where on the axis the object's middle comes nearest, in the hand frame [m]."""
    middle = se3.transform(view.result.T_hand_obj, view.result.scale * view.clip.mesh.centre[None])[:, 0].mean(axis=0)
    return float((middle - point) @ direction)


def _contours(mask: Bool[ndarray, "H W"]) -> list[Float[ndarray, "_n 2"]]:
    """Closed boundary lines of a mask, in pixel coordinates."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    lines = [contour[:, 0].astype(float) + 0.5 for contour in contours if len(contour) > 8]
    return [np.concatenate([line, line[:1]]) for line in lines]


def _plain(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=9.5, color=INK, pad=6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.grid(axis="y", color=LINE, linewidth=0.6)
    axes.tick_params(length=0)
    axes.set_xlabel("time [s]")
    axes.margins(x=0.01)


def _seconds(view: _View) -> Float[ndarray, "T"]:
    """Times of the frames, from the numbers in their names where these are numbers, else evenly spaced."""
    names = view.result.frames
    if all(name.isdecimal() for name in names):
        return np.asarray((np.array([int(name) for name in names]) - int(names[0])) / view.clip.fps)
    return np.arange(len(names)) / view.clip.fps


def _angle_plot(axes: Axes, view: _View) -> None:
    """The angle about the axis or, without an axis, the rotation since the first frame; of the ground truth, too."""
    t, result, truth = _seconds(view), view.result, view.clip.truth
    true = None if truth is None else (se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj)[:, :3, :3]
    if result.axis is None:
        _plain(axes, "rotation of the object in the hand since the first frame [°]")
        R = result.T_hand_obj[:, :3, :3]
        curves = [se3.angle_between(r[:1], r) for r in (R, true) if r is not None]
    else:
        _plain(axes, "angle of the object about the axis [°]")
        curves = [result.axis.angle - result.axis.angle.mean()]
        if true is not None:
            about = se3.log_so3(true @ true[0].T) @ result.axis.direction
            curves.append(about - about.mean())
    if len(curves) > 1:
        axes.plot(t, np.degrees(curves[1]), color=TRUE, linewidth=1.4, linestyle=(0, (4, 2)), label="ground truth")
    axes.plot(t, np.degrees(curves[0]), color=AXIS, linewidth=2.0, label="reconstructed")
    if len(curves) > 1:
        axes.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderpad=0.0)


def _iou_plot(axes: Axes, view: _View) -> None:
    _plain(axes, "overlap of the object with its mask (IOU)")
    t, iou = _seconds(view), view.result.iou
    axes.axhline(view.result.mean_iou, color=LINE, linewidth=1.2)
    axes.plot(t, iou, color=FOUND, linewidth=2.0)
    sampled = view.result.frames_of("sampled")
    if len(sampled) < len(t):
        axes.plot(t[sampled], iou[sampled], ".", color=FOUND, markersize=5, label="fitted together")
        axes.legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderpad=0.0)
    axes.set_ylim(min(0.8, float(np.floor(10.0 * np.nanmin(iou)) / 10.0)), 1.0)
