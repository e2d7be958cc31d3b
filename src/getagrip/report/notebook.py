"""Notebook output of the package's data: a table and a picture; and a result's figure and page."""

from __future__ import annotations

import base64
import tempfile
from dataclasses import dataclass, replace
from functools import singledispatch
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks, find_masks
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import render_rgb
from getagrip.io import files
from getagrip.io.array_data import summarise_fields, summarise_value
from getagrip.io.images import read_image
from getagrip.io.terminal import format_count
from getagrip.metrics.evaluate import Evaluation, evaluate
from getagrip.metrics.evaluate.metric import METRICS
from getagrip.report.pages import write_page
from getagrip.report.pictures.panels import (
    BLANK_RGB,
    HAND_RGB,
    IGNORED_MASK_RGB,
    OBSERVED_MASK_RGB,
    PAPER_RGB,
    look_at,
    object_rgb,
)
from getagrip.report.pictures.result_picture import report_figure
from getagrip.report.pictures.result_view import View
from getagrip.result import Reconstruction
from getagrip.result.findings import format_probability
from getagrip.result.write import software_versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOTEBOOK_PICTURE_PX = 320
Picture = UInt8[ndarray, "H W 3"]


@dataclass(frozen=True, repr=False)
class HtmlPage:
    """An HTML page in one file; a notebook shows it in a sandboxed frame."""

    html: str
    height: int

    def __repr__(self) -> str:
        return f"Page of {len(self.html) / 1e6:.1f} MB: a notebook shows it, .write('report.html') saves it"

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{self.height}px;border:1px solid #d9dad6"
        return f'<iframe sandbox="allow-scripts" srcdoc="{_escape_html(self.html)}" style="{style}"></iframe>'

    def write(self, path: str | Path) -> Path:
        """Write the page to a file, and return its path."""
        files.write_text(Path(path), self.html)
        return Path(path)


def plot_result(result: Reconstruction, clip: Clip | None, masks: Masks | None) -> Figure:
    """Draw the report of a result as a figure that a notebook displays, with or without pyplot."""
    figure = report_figure(result, *_result_inputs(result, clip, masks))
    figure.__dict__["_repr_png_"] = lambda: _figure_to_png(figure)
    return figure


def make_result_page(result: Reconstruction, clip: Clip | None, masks: Masks | None, height: int) -> HtmlPage:
    """Make the page of a result, with its metrics."""
    clip, masks = _result_inputs(result, clip, masks)
    index = clip.index_of(result.frames)
    clip, masks = clip.take(index), None if masks is None else masks.take(index)
    record = {"software": software_versions(), "options": result.options, "seed": result.seed}
    view, evaluation = View.of(result, clip, masks), evaluate(result, clip, masks)
    with tempfile.TemporaryDirectory() as folder:
        written = write_page(view, evaluation, record | {"provenance": clip.provenance}, Path(folder) / "report.html")
        return HtmlPage(written.read_text(encoding="utf-8"), height)


def _result_inputs(result: Reconstruction, clip: Clip | None, masks: Masks | None) -> tuple[Clip, Masks | None]:
    """Return the clip and masks, by default those that the result was made from. Raises ``UsageError`` without any."""
    if clip is None and result.inputs is None:
        raise UsageError("missing clip: this result does not know what it was made of; say result.plot(clip, masks)")
    clip, masks = (clip, masks) if clip is not None else result.inputs or (clip, masks)
    assert clip is not None
    return clip, find_masks(clip) if masks is None and clip.folder is not None else masks


def render_html(data: object) -> str:
    """Write HTML of data: a table of its fields and, where data can be drawn, a picture beside it."""
    rows = "".join(
        f'<tr><td style="text-align:left;color:#8a9096">{_escape_html(name)}</td>'
        f'<td style="text-align:left;white-space:normal">{_escape_html(text)}</td></tr>'
        for name, text in describe_data(data).items()
    )
    seen = draw_picture(data)
    image = "" if seen is None else f'<img style="max-width:100%" alt="" src="{_png_data_url(seen)}">'
    title = f"<caption><b>{escape(type(data).__name__)}</b></caption>"
    table = f'<div style="flex:1 1 24em"><table>{title}{rows}</table></div>'  # a picture that is too wide goes below it
    return f'<div style="display:flex;flex-wrap:wrap;gap:16px;align-items:start">{table}{image}</div>'


@singledispatch
def describe_data(data: object) -> dict[str, str]:
    """Describe data in rows of a name and a text."""
    return summarise_fields(data)


@describe_data.register
def _(clip: Clip) -> dict[str, str]:
    held = summarise_fields(replace(clip, provenance={}, segments=()))
    segments = [f"{s.state}{f', {s.side} hand' if s.side else ''}: {s.first} to {s.last}" for s in clip.segments]
    taken = {f"segment {n + 1}": text for n, text in enumerate(segments)}
    return {**held, **taken, **{f"from: {topic}": summarise_value(text) for topic, text in clip.provenance.items()}}


@describe_data.register
def _(result: Reconstruction) -> dict[str, str]:
    return {
        "clip": result.clip,
        "method": result.method,
        "frames": format_count(len(result.frames), "frame"),
        "status": result.message,
        "mask IOU": f"{100 * result.mean_iou:.1f} %",
        **{f"probability right {where}": format_probability(one.value) for where, one in result.probabilities.items()},
        **({"by eye": result.looks} if result.looks else {}),
        "scale": f"{result.scale:.4g}",
        **{f"finding: {finding.check}": finding.message for finding in result.findings},
        **{f"segment {n + 1}": f"{s.state}: {s.first} to {s.last}" for n, s in enumerate(result.segments)},
    }


@describe_data.register
def _(evaluation: Evaluation) -> dict[str, str]:
    metrics = {metric.name: metric for metric in METRICS.working().values()}
    shown = {name: metrics[name] for name in evaluation.headline if name in metrics}
    units = {name: "°" if one.unit == "deg" else f" {one.unit}" for name, one in shown.items()}
    numbers = {name: f"{one.text(evaluation.headline[name])}{units[name]}" for name, one in shown.items()}
    return {"clip": evaluation.clip, "method": evaluation.method, **numbers}


@singledispatch
def draw_picture(data: object) -> Picture | None:
    """Draw data in a small picture; None for data without one."""
    return None


@draw_picture.register
def _(clip: Clip) -> Picture | None:
    n = len(clip) // 2
    if (file := clip.image_file(n)) is not None:
        return read_image(file, clip.size)
    hand = se3.transform(clip.hand.T_cam_hand[n], clip.hand.vertices[n]), clip.hand.faces, HAND_RGB
    if clip.truth is None:
        return render_rgb([hand], clip.K[n], clip.size, PAPER_RGB)
    true = se3.transform(clip.truth.T_cam_obj[n], clip.truth.scale * clip.mesh.vertices)
    return render_rgb([hand, (true, clip.mesh.faces, object_rgb(clip.mesh))], clip.K[n], clip.size, PAPER_RGB)


@draw_picture.register
def _(masks: Masks) -> Picture | None:
    known = np.flatnonzero(masks.known)
    n = known[len(known) // 2] if len(known) else 0
    drawn = np.full((*masks.object.shape[1:], 3), BLANK_RGB, dtype=np.uint8)
    drawn[masks.ignore[n]] = IGNORED_MASK_RGB
    drawn[masks.object[n]] = OBSERVED_MASK_RGB
    return drawn


@draw_picture.register
def _(hand: HandTrack) -> Picture | None:
    return _render_surface(hand.vertices[len(hand.vertices) // 2], hand.faces, HAND_RGB) if hand.vertices.size else None


@draw_picture.register
def _(mesh: Mesh) -> Picture | None:
    return _render_surface(mesh.light.vertices, mesh.light.faces, object_rgb(mesh.light))


@draw_picture.register
def _(result: Reconstruction) -> Picture | None:
    if result.inputs is None:
        return None
    png = np.frombuffer(_figure_to_png(plot_result(result, None, None)), np.uint8)
    return np.asarray(cv2.imdecode(png, cv2.IMREAD_COLOR_RGB), dtype=np.uint8)


def _render_surface(vertices: ndarray, faces: ndarray, colour: tuple[float, float, float] | ndarray) -> Picture:
    eye = look_at(vertices, np.array([0.6, -0.5, -0.8]), np.array([0.0, -1.0, 0.0]), NOTEBOOK_PICTURE_PX)
    surface = se3.transform(eye.T_view_frame, vertices), faces, colour
    return render_rgb([surface], eye.K, (eye.size, eye.size), PAPER_RGB)


def _escape_html(text: str) -> str:
    """Escape text as HTML in ASCII, valid in a page of any encoding."""
    return escape(text).encode("ascii", "xmlcharrefreplace").decode()


def _png_data_url(seen: Picture) -> str:
    height, width = seen.shape[:2]
    most = NOTEBOOK_PICTURE_PX * (2.5 if width > 3 * NOTEBOOK_PICTURE_PX else 1.0)  # a report has small letters
    factor = min(1.0, most / max(height, width))
    small = cv2.resize(seen, (round(factor * width), round(factor * height)), interpolation=cv2.INTER_AREA)
    _, png = cv2.imencode(".png", cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
    return f"data:image/png;base64,{base64.b64encode(png.tobytes()).decode()}"


def _figure_to_png(figure: Figure) -> bytes:
    out = BytesIO()
    figure.savefig(out, format="png", facecolor="white")
    return out.getvalue()
