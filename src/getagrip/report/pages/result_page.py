"""The page of one result: it plays in 3D and over its images, with metrics, assumptions and findings.

Tables that are folded at first hold everything that is known but not shown above.

An HTML page in one file, with its styles, scripts and data: nothing is loaded, and nothing else may run.

Names of clips and whatever else results hold may come from untrusted files. They are in the page as JSON whose ``<``,
``>`` and ``&`` are escaped, and reach the screen as text only. The Content-Security-Policy names the hashes of our own
scripts and styles: the browser refuses any other, and every request.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import zlib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip import __version__
from getagrip.checks import input_checks, result_checks
from getagrip.checks.timeline_checks import JUMP_CHECK
from getagrip.fitting.methods import label_of
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition
from getagrip.metrics.evaluate.metric import (
    ADD_MM,
    ADD_SYM_CAM_MM,
    ADD_SYM_MM,
    METRICS,
    REPLAY_STABILITY,
    ROTATION_SYM,
    SCA,
    Metric,
)
from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages import scene_data
from getagrip.report.pages.scene_data import FRAME_PICTURE_PX, draw_page_frame, object_outline
from getagrip.report.pictures.contact_colours import CONTACT_BORDER_M, decimate_view, subdivide_object, surface_gap
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    HAND_LINE_COLOUR,
    INK_COLOUR,
    RESULT_COLOUR,
    STATE_COLOURS,
    TRUTH_COLOUR,
)
from getagrip.report.pictures.result_view import View, angle_curve, candidate_view, result_times
from getagrip.report.pictures.stills import smooth_windows
from getagrip.result import Reconstruction
from getagrip.result.findings import SUCCESS_DEFINITION

ARRAY_TYPE_CODES = {"float32": "f", "uint16": "H", "uint32": "I", "uint8": "B"}
"""Types of the arrays in a page; ``parts/page.js`` reads these."""
ARRAY_ALIGNMENT_BYTES = 8
"""Alignment of arrays in bytes, as JavaScript requires."""
SCRIPT_ESCAPES = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}


def build_document(
    title: str, body: str, scripts: Sequence[str], data: Mapping[str, object], asks: bool = False
) -> str:
    """Build the page: ``body`` and ``scripts`` are files of ``parts/``.

    If it ``asks``, it may load more from its server.
    """
    style = _read_page_part("page.css")
    codes = [_read_page_part(name) for name in scripts]
    asking = "; connect-src 'self'" if asks else ""
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_csp_hash, codes))}; style-src {_csp_hash(style)}; img-src data:; "
        f"base-uri 'none'; form-action 'none'{asking}"
    )
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta name="generator" content="getagrip {__version__}">',
            f"<title>{html.escape(title)}</title>",
            f'<link rel="icon" href="data:,">\n<style>{style}</style>\n</head>\n<body>',
            _read_page_part(body),
            f'<script type="application/json" id="data">{json_for_script(data)}</script>',
            *(f"<script>{code}</script>" for code in codes),
            "</body>\n</html>\n",
        ]
    )


def json_for_script(data: Mapping[str, object]) -> str:
    """Write JSON that can stand in a script element: it holds nothing that ends or begins an element."""
    compact = json.dumps(json.loads(files.to_json(data)), separators=(",", ":"), ensure_ascii=True)
    return compact.translate(SCRIPT_ESCAPES)


def pack_arrays(arrays: Mapping[str, ndarray]) -> tuple[dict[str, dict[str, object]], str]:
    """Pack arrays: where each is (type, shape, offset in bytes), and all of them, deflated, as base64."""
    where, parts, size = {}, [], 0
    for name, values in arrays.items():
        kind = values.dtype.name
        assert kind in ARRAY_TYPE_CODES, kind
        content = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
        content += bytes(-len(content) % ARRAY_ALIGNMENT_BYTES)
        where[name] = {"type": kind, "shape": values.shape, "offset": size}
        parts.append(content)
        size += len(content)
    return where, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode("ascii")


def _read_page_part(name: str) -> str:
    return resources.files("getagrip.report.pages").joinpath("parts", name).read_text("utf-8")


def _csp_hash(code: str) -> str:
    """Return the policy's hash of a script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()}'"


MAX_PAGE_FRAMES = 120
"""Frames that a page plays, at most; of longer clips as many, evenly sampled, and the worst."""
RESULT_PAGE_SCRIPTS = ("page.js", "scene.js", "viewer.js", "plots.js", "sources.js", "columns.js", "report.js")
PAGE_SCA_CONTACT = ContactDefinition("object", 0.010)
"""Definition of contact of SCA among the main metrics."""
MAIN_METRICS: Mapping[str, Metric] = {
    "ADD": ADD_MM, "ADD sym.": ADD_SYM_MM, "in the camera": ADD_SYM_CAM_MM, "rotation sym.": ROTATION_SYM,
    f"SCA {PAGE_SCA_CONTACT.distance}": SCA, "stays in the simulated hand": REPLAY_STABILITY,
}  # fmt: skip
"""Metrics at the top of the page beside the IOU, each under a short name."""
PLOTTED_METRICS: Mapping[str, Metric] = {"ADD, symmetries allowed": ADD_SYM_MM}
"""Metrics of each frame that are plotted where they are known."""
METRIC_LABELS = {"iou": "iou, in the crop", "iou_soft": "iou_soft, in the crop"}
"""Metrics whose keys could be taken for the IOU at the top of the page."""


def write_page(view: View, evaluation: Evaluation, record: Json, path: Path) -> Path:
    """Write the page of a result and return its path.

    ``evaluation`` is what ``evaluate`` gives for it, ``record`` the content of its ``result.json``. Raises
    ``InputError`` for an image that cannot be read, ``UsageError`` for an unknown method.
    """
    view, label = decimate_view(view), label_of(view.result.method)
    shown = _select_page_frames(view)
    some = view.at([view.result.frames[n] for n in shown])
    surface, crops = subdivide_object(some), smooth_windows(some, FRAME_PICTURE_PX)
    where, packed = pack_arrays(scene_data.constant_arrays(some, surface) | scene_data.per_frame_arrays(some, surface))
    pictures = [draw_page_frame(some, n, crops, n) for n in range(len(shown))]
    others = [candidate_view(some, rank) for rank in range(1, len(view.result.candidates.scale))]
    for n, picture in enumerate(pictures):
        picture["others"] = [object_outline(one, n, crops, n) for one in others]
    column = describe_result(view, label, evaluation, record) | {"masked": view.masks is not None}
    column |= {
        "arrays": where,
        "packed": packed,
        "pictures": pictures,
        "plots": [*column["plots"], gap_plot(surface_gap(view))],
    }
    page = build_document(
        f"{view.clip.name}, {label}",
        "viewer.html",
        RESULT_PAGE_SCRIPTS,
        {"shown": {**timeline_data(view, shown), "columns": [column]}},
    )
    files.write_text(path, page)
    return path


def _select_page_frames(view: View) -> Int[ndarray, "n"]:
    """Return the frames that are played."""
    T, iou = len(view.result.frames), view.result.iou
    chosen = {int(n) for n in np.linspace(0, T - 1, min(T, MAX_PAGE_FRAMES)).round()}
    if not np.isnan(iou).all():
        chosen.add(int(np.nanargmin(iou)))
    return np.array(sorted(chosen))


def timeline_data(view: View, shown: Int[ndarray, "n"]) -> Json:
    """Return what all results of a page share: the times of all frames, which of them are shown, and the segments."""
    names, kinds = view.result.frames, view.result.frame_kind
    return {
        "clip": view.clip.name,
        "times": result_times(view),
        "frames": [{"n": n, "name": names[n], "kind": kinds[n]} for n in shown.tolist()],
        "segments": [
            {"words": view.called(s)[0], "colour": STATE_COLOURS[s.state], "first": s.first, "last": s.last}
            for s in view.clip.segments
        ],
        "size": FRAME_PICTURE_PX,
        "near": {
            "reach": scene_data.MAX_EXACT_DISTANCE_M,
            "fades": CONTACT_BORDER_M,
            "at": scene_data.DEFAULT_CONTACT_DISTANCE_M,
            "most": scene_data.MAX_CONTACT_SLIDER_M,
        },
        "colours": {
            "object": RESULT_COLOUR,
            "hand": HAND_LINE_COLOUR,
            "true": TRUTH_COLOUR,
            "observed": INK_COLOUR,
            "axis": AXIS_COLOUR,
        },
    }


def describe_result(view: View, label: str, evaluation: Evaluation, record: Json) -> Json:
    """Return the page's fields of a result."""
    return {
        **_summarise_result(view, label, record),
        "main": [
            *_probability_rows(view.result),
            *_mask_iou_rows(view.result),
            *_main_metric_rows(evaluation.headline, bool(evaluation.metrics_of_grasps)),
            *_main_metric_rows({REPLAY_STABILITY.name: record.get("metrics", {}).get(REPLAY_STABILITY.name)}, False),
        ],
        "plots": _metric_plots(view, evaluation.per_frame),
        "tables": result_tables(view, evaluation, record),
    }


def _summarise_result(view: View, label: str, record: Json) -> Json:
    result, clip = view.result, view.clip
    hand = f"a {clip.side} hand" if clip.other_hand is None else "both hands"
    return {
        "label": label,
        "facts": [f"{clip.category} in {hand}", view.frames_in_words, *view.size_in_words],
        "status": "; ".join(filter(None, (result.message, result.looks))),
        "ambiguous": result.ambiguous,
        "findings": [{"serious": f.serious, "check": f.check, "message": f.message} for f in result.findings],
        "notes": [
            *_describe_segments(result),
            *map(str, result.notes),
            *[f"probability: {SUCCESS_DEFINITION}"] * bool(probability_meanings(result)),
        ],
        "candidates": [{"energy": energy} for energy in result.candidates.energy.tolist()],
        "version": str(record.get("software", {}).get("getagrip", "")),
    }


def _describe_segments(result: Reconstruction) -> list[str]:
    """Say what the object of a timeline does, and how well each segment meets its masks."""
    out = []
    for segment in result.segments:
        met = "" if segment.iou is None else f", IOU {segment.iou:.2f}"
        side = f" ({segment.side} hand)" if segment.side else ""
        how = ", tracked by the masks only" if segment.by_masks else ""
        if segment.state == "grasp":
            how += f", probability right {segment.probability_right or 'unknown'}"
        out.append(f"{segment.state}{side}: frames {segment.first} to {segment.last}{met}{how}")
    return out


def _probability_rows(result: Reconstruction) -> list[dict[str, str]]:
    """How probable it is that the result is right, where that is calibrated."""
    return [
        {"name": f"probability right {where}", "value": f"{right}{right.keeping}", "meaning": right.meaning}
        for where, right in result.probabilities.items()
    ]


def _mask_iou_rows(result: Reconstruction) -> list[dict[str, str]]:
    """How well the masks are met, where they are known: the mean of the curve below."""
    return [] if np.isnan(result.mean_iou) else [{"name": "IOU", "value": f"{100 * result.mean_iou:.1f} %"}]


def _main_metric_rows(metrics: Mapping[str, float | None], of_grasps: bool) -> list[dict[str, str]]:
    out = []
    for name, metric in MAIN_METRICS.items():
        if (value := metrics.get(metric.key(PAGE_SCA_CONTACT))) is not None and not np.isnan(value):
            where = ", in grasps" if of_grasps and metric is SCA else ""
            out.append({"name": f"{name}{where}", "value": f"{metric.text(value)}{unit_of(metric)}"})
    return out


def _metric_plots(view: View, per_frame: Mapping[str, Sequence[float]]) -> list[dict[str, object]]:
    """Curves over all frames of the result that take no time."""
    if not view.posed:
        return []
    curve = angle_curve(view)
    angles = [_plot_line("reconstructed", np.degrees(curve.found), AXIS_COLOUR)]
    if curve.true is not None and not view.of_truth:
        angles.append(_plot_line("ground truth", np.degrees(curve.true), TRUTH_COLOUR))
    iou = _plot_line("IOU", 100 * view.result.iou, RESULT_COLOUR)
    plots: list[dict[str, object]] = [{"title": curve.title, "unit": "°", "lines": angles}]
    if not np.isnan(view.result.iou).all():
        plots.append({"title": "overlap with the mask, IOU", "unit": "%", "lines": [iou], "upTo": (80, 100)})
    for title, metric in PLOTTED_METRICS.items():
        if metric.name in per_frame:
            line = _plot_line(metric.name, np.array(per_frame[metric.name], dtype=float), TRUTH_COLOUR)
            plots.append({"title": title, "unit": metric.unit, "lines": [line], "upTo": (0, 0)})
    return plots


def gap_plot(values: Float[ndarray, "T"]) -> Json:
    """Compute the curve of distances [m], which is slow."""
    line = _plot_line("gap", 1e3 * values, HAND_LINE_COLOUR)
    return {"title": "gap of hand and object", "unit": "mm", "lines": [line], "upTo": (0, 0)}


def _plot_line(name: str, values: Float[ndarray, "T"], colour: str) -> Json:
    return {"name": name, "values": np.round(values, 3), "colour": colour}


def result_tables(view: View, evaluation: Evaluation, record: Json) -> list[dict[str, object]]:
    """Return tables as ``parts/report.js`` reads them: a title, names of columns or none, and rows of texts."""
    result = view.result
    known = {metric.key(contact): metric for metric in METRICS.working().values() for contact in CONTACT_DEFINITIONS}
    values = [
        [f"{METRIC_LABELS.get(key, key)}{where}", f"{known[key].text(value)}{unit_of(known[key])}"]
        for metrics, where in ((evaluation.metrics, ""), (evaluation.metrics_of_grasps, ", in grasps"))
        for key, value in metrics.items()
        if key in known
    ]
    content = {
        "What the probabilities mean": _key_value_rows(probability_meanings(result)),
        "Metrics (docs/metrics.md)": values,
        "Checks (docs/checks.md)": _check_rows(result.checks),
        "Energy [px²]": _key_value_rows(result.energy),
        "Time [s]": _key_value_rows(result.seconds),
        "Options": [*_key_value_rows(result.options), ["seed", str(result.seed)]] if result.options else [],
        "Sources of the clip": _key_value_rows(view.clip.provenance),
        "Software": _key_value_rows(record.get("software", {})),
    }
    heads = {"Checks (docs/checks.md)": ("check", "value", "usual", "verdict")}
    return [{"title": title, "head": heads.get(title, ()), "rows": rows} for title, rows in content.items() if rows]


def probability_meanings(result: Reconstruction) -> dict[str, str]:
    """Explain its probabilities at length, by where; of a timeline, that of its grasps."""
    of_grasps = [segment.probability_right for segment in result.segments if segment.probability_right is not None]
    known = [*result.probabilities.items(), *(("in the hand", right) for right in of_grasps[:1])]
    return {f"right {where}": right.meaning for where, right in known}


def unit_of(metric: Metric) -> str:
    """Return a metric's unit as it follows a number."""
    return "°" if metric.unit == "deg" else f" {metric.unit}"


def _check_rows(checks: Mapping[str, float]) -> list[list[str]]:
    """Return each check's value, its limits and its verdict; for an unknown one the value alone."""
    known = {check.name: check for check in (*input_checks(), *result_checks(), JUMP_CHECK)}
    out = []
    for name, value in checks.items():
        check = known.get(name)
        if check is None:
            out.append([name, f"{value:.3g}", "", ""])
        else:
            out.append([name, "" if np.isnan(value) else check.shown(value), check.usual, check.verdict(value)])
    return out


def _key_value_rows(content: Mapping[str, object]) -> list[list[str]]:
    return [[str(key), f"{value:.4g}" if isinstance(value, float) else str(value)] for key, value in content.items()]
