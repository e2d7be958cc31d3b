"""Films of results at the clip's speed: over the images, beside a view from the side or, of timelines, in the world."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy.spatial import ConvexHull, QhullError

from getagrip.fitting.methods import label_of
from getagrip.geometry import se3
from getagrip.geometry.camera import Crops
from getagrip.geometry.rasterize import nearest_surface, render_rgb
from getagrip.io.images import write_video
from getagrip.report.pictures.panels import HAND_RGB, INK_COLOUR, PAPER_RGB, STATE_COLOURS, object_rgb
from getagrip.report.pictures.result_view import OWN_CAMERA, View, result_times
from getagrip.report.pictures.stored_results import draw_overlay, draw_side_view, smooth_windows

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

FILM_PANEL_PX, CAPTION_HEIGHT_PX, CAPTION_MARGIN_PX = 540, 36, 12
"""Side of each of two pictures, height of the caption below them, and the caption's margin [px]."""
MIN_FILM_PANEL_PX = 120
"""Side of each of many pictures, at least [px]."""
MIN_LETTER_PX = 12
MIN_FILM_FPS, MAX_FILM_FPS = 1.0, 120.0
FILM_ELEVATION_RAD = np.radians(28.0)
"""Elevation from which the camera looks down on the ground, where up is known."""
FILM_AZIMUTHS_RAD = np.radians([-75.0, -45.0, -20.0, 20.0, 45.0, 75.0])
"""Candidate azimuths, from the mean place of the clip's cameras; the one that shows most of the object is used."""
N_VIEWPOINT_FRAMES, VIEWPOINT_RENDER_PX = 8, 96.0
"""Number of frames, and side of their renderings [px], that decide the azimuth."""
FILM_FRAMING_FACTOR = 1.08
GROUND_SQUARE_M = 0.05
GROUND_MARGIN_FRACTION = 0.7
"""Margin of the ground around hands and object, as a fraction of their extent over all frames."""
GROUND_COLOURS = (0.93, 0.93, 0.90), (0.88, 0.88, 0.85)
SHADOW_COLOUR = (0.74, 0.74, 0.71)
SHADOW_HEIGHT_M = 1e-3
"""Height of shadows above the ground, which would hide them [m]."""
MAX_GROUND_SQUARES = 60
"""Squares along a side of the ground."""
Mesh3 = tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"], tuple[float, float, float] | Float[ndarray, "V 3"]]


def write_film(view: View, path: Path) -> Path:
    """Write all frames of a result as MP4 (H.264) and return its path: what each camera sees, and a rendering.

    Raises ``InputError`` for an image that cannot be read, ``GetagripError`` where PyAV has no encoder for H.264.
    """
    in_world = bool(view.clip.segments) and view.clip.world is not None
    layout = FilmLayout.of(2 + len(view.cameras))
    pictures = (_timeline_frames if in_world else _overlay_and_turned_frames)(view, layout)
    size = layout.width, layout.height + CAPTION_HEIGHT_PX * (1 + in_world)
    write_video(path, pictures, _film_fps(view), size)
    return path


@dataclass(frozen=True)
class FilmLayout:
    """Square pictures in rows, ``columns`` in each, with sides of ``panel`` pixels; rows are filled up with paper."""

    panels: int
    columns: int
    panel: int

    @staticmethod
    def of(panels: int) -> FilmLayout:
        """Choose columns and sizes: pictures, at least two, in a square or a little wider, as wide as two."""
        columns = int(np.ceil(np.sqrt(panels)))
        return FilmLayout(panels, columns, max(MIN_FILM_PANEL_PX, 2 * (FILM_PANEL_PX // columns)))

    @property
    def width(self) -> int:
        """Width of all pictures [px]."""
        return self.columns * self.panel

    @property
    def height(self) -> int:
        """Height of all pictures [px]."""
        return -(-self.panels // self.columns) * self.panel

    def joined(self, pictures: Sequence[UInt8[ndarray, "panel panel 3"]]) -> UInt8[ndarray, "H W 3"]:
        """Join the pictures, row by row."""
        out = np.empty((self.height, self.width, 3), dtype=np.uint8)
        out[:] = np.round(255.0 * np.array(PAPER_RGB))
        for k, picture in enumerate(pictures):
            top, left = (self.panel * at for at in divmod(k, self.columns))
            out[top : top + self.panel, left : left + self.panel] = picture
        return out


def _film_fps(view: View) -> Fraction:
    """Return the frame rate: below the clip's where the result has only some of the clip's frames."""
    times = result_times(view)
    lasts = float(times[-1] - times[0])
    rate = (len(times) - 1) / lasts if lasts > 0.0 else view.clip.fps
    return Fraction(float(np.clip(rate, MIN_FILM_FPS, MAX_FILM_FPS))).limit_denominator(1001)


def _overlay_and_turned_frames(view: View, layout: FilmLayout) -> Iterator[UInt8[ndarray, "H W 3"]]:
    crops, others = smooth_windows(view, layout.panel), _further_views(view, layout)
    for n, under in enumerate(_frame_captions(view)):
        own, turned = draw_overlay(view, n, crops, n), draw_side_view(view, n, crops, n)
        own = draw_caption(own, OWN_CAMERA) if others else own
        yield np.concatenate([layout.joined([own, *_draw_others(others, n), turned]), _caption_strip(under, layout)])


def _timeline_frames(view: View, layout: FilmLayout) -> Iterator[UInt8[ndarray, "H W 3"]]:
    crops, stage = smooth_windows(view, layout.panel), FilmStage.of(view, layout.panel)
    others = _further_views(view, layout)
    for n, under in enumerate(_frame_captions(view)):
        seen = draw_caption(draw_overlay(view, n, crops, n), OWN_CAMERA if others else "from the camera")
        panels = [seen, *_draw_others(others, n), draw_caption(stage.picture(n), "in the world")]
        bar = draw_segment_bar(view, n, (layout.width, CAPTION_HEIGHT_PX))
        yield np.concatenate([layout.joined(panels), bar, _caption_strip(under, layout)])


def _further_views(view: View, layout: FilmLayout) -> list[tuple[list[str], View, Crops]]:
    """Return what each further camera sees: its name and IOU in each frame as a caption, itself, and its windows."""
    found = []
    for name, seen in view.in_each_view().items():
        met = ["" if np.isnan(iou) else f"  ·  IOU {100 * iou:.0f} %" for iou in seen.measured_iou()]
        found.append(([name + words for words in met], seen, smooth_windows(seen, layout.panel)))
    return found


def _draw_others(others: Sequence[tuple[list[str], View, Crops]], n: int) -> Iterator[UInt8[ndarray, "side side 3"]]:
    for captions, seen, crops in others:
        yield draw_caption(draw_overlay(seen, n, crops, n), captions[n])


def _frame_captions(view: View) -> Iterator[str]:
    result, clip = view.result, view.clip
    shared = [label_of(result.method), *["scale is a guess"] * (clip.scale == "free")]
    shared += ["shape is a guess"] * (result.warp is not None)
    shared += ["ambiguous"] * result.ambiguous
    for name, kind in zip(result.frames, result.frame_kind, strict=True):
        yield "  ·  ".join([f"frame {name}", *[kind] * (kind == "interpolated"), *shared, clip.name])


def _caption_strip(words: str, layout: FilmLayout) -> UInt8[ndarray, "STRIP W 3"]:
    from PIL import Image, ImageDraw

    strip = Image.new("RGB", (layout.width, CAPTION_HEIGHT_PX), "white")
    left = (CAPTION_MARGIN_PX, CAPTION_HEIGHT_PX / 2)
    ImageDraw.Draw(strip).text(left, words, INK_COLOUR, load_font(CAPTION_HEIGHT_PX // 2), "lm")
    return np.asarray(strip)


@dataclass(frozen=True)
class FilmStage:
    """A static camera, and the ground where it is known."""

    view: View
    T_world_cam: Float[ndarray, "T 4 4"]
    T_eye_world: Float[ndarray, "4 4"]
    K: Float[ndarray, "3 3"]
    size: int
    up: Float[ndarray, "3"] | None
    height: float | None
    """Height of the ground along ``up`` [m]."""
    ground: tuple[Mesh3, ...]

    @staticmethod
    def of(view: View, size: int) -> FilmStage:
        """Make a stage on which all frames of a view are visible. The view's clip must have a world."""
        world = view.clip.world
        assert world is not None
        frames = range(len(view.result.frames))
        points = [np.concatenate([*(v for v, _ in view.hands(n)), view.object(n)]) for n in frames]
        seen = np.concatenate([se3.transform(world.T_world_cam[n], points[n]) for n in frames])
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2.0
        reach = float(np.linalg.norm(seen - middle, axis=1).max())
        eyes = _candidate_eye_poses(world.T_world_cam, world.up, middle, reach)
        T_eye_world = max(eyes, key=lambda T: _visible_fraction(view, T, world.T_world_cam))
        in_eye = se3.transform(T_eye_world, seen)
        slope = in_eye[:, :2] / in_eye[:, 2:]
        low, high = slope.min(axis=0), slope.max(axis=0)
        f = size / (FILM_FRAMING_FACTOR * float((high - low).max()))
        K = np.array([[f, 0.0, size / 2.0], [0.0, f, size / 2.0], [0.0, 0.0, 1.0]])
        K[:2, 2] -= f * (low + high) / 2.0
        height, ground = view.ground_height(), tuple[Mesh3, ...]()
        if world.up is not None and height is not None:
            ground = (_ground_mesh(seen, T_eye_world[0, :3], world.up, height),)
        return FilmStage(view, world.T_world_cam, T_eye_world, K, size, world.up, height, ground)

    def picture(self, n: int) -> UInt8[ndarray, "size size 3"]:
        """Draw hands and object in frame ``n``, with their shadows."""
        hands, grasped = self.view.hands(n), self.view.object(n)
        meshes: list[Mesh3] = [(se3.transform(self.T_eye_world, v), f, c) for v, f, c in self.ground]
        if self.ground:
            in_world = [se3.transform(self.T_world_cam[n], v) for v in (*(v for v, _ in hands), grasped)]
            meshes += [(se3.transform(self.T_eye_world, v), f, SHADOW_COLOUR) for v, f in map(self._shadow, in_world)]
        T = self.T_eye_world @ self.T_world_cam[n]
        meshes += [(se3.transform(T, hand), faces, HAND_RGB) for hand, faces in hands]
        mesh = self.view.clip.mesh
        meshes.append((se3.transform(T, grasped), mesh.faces, object_rgb(mesh)))
        return render_rgb(meshes, self.K, (self.size, self.size), PAPER_RGB)

    def _shadow(self, vertices: Float[ndarray, "V 3"]) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"]]:
        """Return the convex hull of vertices projected onto the ground, as vertices and faces."""
        assert self.up is not None
        assert self.height is not None
        flat = vertices - (vertices @ self.up - self.height - SHADOW_HEIGHT_M)[:, None] * self.up
        across = _ground_axes(self.up)
        try:
            corners = flat[ConvexHull(flat @ across.T).vertices]
        except QhullError:  # no area
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
        k = np.arange(1, len(corners) - 1)
        return corners, np.stack([np.zeros_like(k), k, k + 1], axis=1)


def _ground_axes(up: Float[ndarray, "3"]) -> Float[ndarray, "2 3"]:
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def _candidate_eye_poses(
    T_world_cam: Float[ndarray, "T 4 4"], up: Float[ndarray, "3"] | None, middle: Float[ndarray, "3"], reach: float
) -> Iterator[Float[ndarray, "4 4"]]:
    """Yield candidate poses ``T_eye_world`` of a static camera that sees everything within ``reach`` [m] of ``middle``.

    Where up is known: upright, from several azimuths; else one, turned as the clip's middle camera.
    """
    back = se3.rigid(None, np.array([0.0, 0.0, 2.5 * reach]))
    if up is None:
        R = T_world_cam[len(T_world_cam) // 2, :3, :3].T
        yield np.asarray(back @ se3.rigid(R, -R @ middle))
        return
    away = T_world_cam[:, :3, 3].mean(axis=0) - middle
    away -= (away @ up) * up
    if np.linalg.norm(away) < 1e-6:
        away = _ground_axes(up)[0]
    for aside in FILM_AZIMUTHS_RAD:
        level = -np.cos(FILM_ELEVATION_RAD) * se3.exp_so3(aside * up) @ (away / np.linalg.norm(away))
        forward = level - np.sin(FILM_ELEVATION_RAD) * up
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        yield np.asarray(back @ se3.rigid(R, -R @ middle))


def _visible_fraction(view: View, T_eye_world: Float[ndarray, "4 4"], T_world_cam: Float[ndarray, "T 4 4"]) -> float:
    """Compute the visible fraction of the object's silhouette, the mean over some frames."""
    f, size, shares = VIEWPOINT_RENDER_PX, (int(VIEWPOINT_RENDER_PX), int(VIEWPOINT_RENDER_PX)), []
    K = np.array([[f, 0.0, f / 2.0], [0.0, f, f / 2.0], [0.0, 0.0, 1.0]])
    for n in np.unique(np.linspace(0, len(view.clip) - 1, N_VIEWPOINT_FRAMES).round().astype(int)):
        T = T_eye_world @ T_world_cam[n]
        hand = se3.transform(T, view.hand(n)), view.clip.hand.faces
        grasped = se3.transform(T, view.object(n)), view.clip.mesh.faces
        part, alone = (nearest_surface(surfaces, K, size) for surfaces in ([grasped, hand], [grasped]))
        shares.append(np.count_nonzero(part == 0) / (np.count_nonzero(alone == 0) or 1))
    return float(np.mean(shares))


def _ground_mesh(
    seen: Float[ndarray, "n 3"], right: Float[ndarray, "3"], up: Float[ndarray, "3"], height: float
) -> Mesh3:
    """Make a chequered ground around the points ``seen``, its squares along ``right``."""
    across = np.stack([right, np.cross(up, right)])
    at = seen @ across.T
    low, high = at.min(axis=0), at.max(axis=0)
    margin = GROUND_MARGIN_FRACTION * (high - low).max()
    low, high = low - margin, high + margin
    side = max(GROUND_SQUARE_M, float((high - low).max()) / MAX_GROUND_SQUARES)
    i, j = np.meshgrid(*(np.arange(np.floor(a / side), np.ceil(b / side)) for a, b in zip(low, high, strict=True)))
    cells = np.stack([i.ravel(), j.ravel()], axis=1)
    corners = cells[:, None] + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    vertices = side * corners.reshape(-1, 2) @ across + height * up
    first = 4 * np.arange(len(cells))[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    colours = np.array(GROUND_COLOURS)[(cells.sum(axis=1) % 2).astype(int)].repeat(4, axis=0)
    return vertices, faces, colours


def draw_segment_bar(view: View, n: int, size: tuple[int, int]) -> UInt8[ndarray, "H W 3"]:
    """Draw the segments of a view as a bar of width and height ``size`` [px], with frame ``n`` marked."""
    from PIL import Image, ImageDraw

    width, height = size
    picture = Image.new("RGB", size, "white")
    draw, letters = ImageDraw.Draw(picture), load_font(int(0.4 * height))
    edge = np.linspace(0, width, len(view.clip) + 1)
    top, bottom = int(0.15 * height), int(0.85 * height)
    draw.rectangle((0, top, width, bottom), STATE_COLOURS["unknown"])
    for segment in view.clip.segments:
        left, right = float(edge[segment.first]), float(edge[segment.last + 1])
        draw.rectangle((left + 1, top, right - 2, bottom), STATE_COLOURS[segment.state])
        for said in view.called(segment):
            if draw.textlength(said, letters) < right - left - 8:
                draw.text(((left + right) / 2, height / 2), said, "white", letters, "mm")
                break
    at = float(edge[n] + edge[n + 1]) / 2.0
    draw.rectangle((at - 2, 0, at + 2, height), INK_COLOUR)
    return np.asarray(picture)


def draw_caption(picture: UInt8[ndarray, "H W 3"], words: str) -> UInt8[ndarray, "H W 3"]:
    """Draw words in the upper left corner of a picture."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    size = max(len(picture) // 28, MIN_LETTER_PX)
    ImageDraw.Draw(image).text((size / 2, size / 2), words, INK_COLOUR, load_font(size))
    return np.asarray(image)


def load_font(size: int) -> FreeTypeFont:
    """Load the project's font at a height in pixels."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
