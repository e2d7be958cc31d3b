"""The page of one result: a player in 3D and over the images, with metrics, assumptions, findings and folded tables.

A page is one HTML file with its styles, scripts and data; it loads nothing.

Clip names and other texts of results may come from untrusted files. They are in the page as JSON whose ``<``,
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
    IOU_FULL,
    METRICS,
    REPLAY_STABILITY,
    ROTATION_SYM,
    SCA,
    Metric,
)
from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages import scene_data
from getagrip.report.pages.scene_data import FRAME_PICTURE_PX, VIEW_PICTURE_PX, draw_page_frame
from getagrip.report.pictures.contact_colours import CONTACT_BORDER_M, decimate_view, subdivide_object, surface_gap
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    HAND_LINE_COLOUR,
    INK_COLOUR,
    RESULT_COLOUR,
    STATE_COLOURS,
    TRUTH_COLOUR,
)
from getagrip.report.pictures.result_view import View, angle_curve, candidate_views, result_times
from getagrip.report.pictures.stored_results import smooth_windows
from getagrip.result import Reconstruction
from getagrip.result.findings import Finding, format_probability

ARRAY_TYPE_CODES = {"float32": "f", "uint16": "H", "uint32": "I", "uint8": "B"}
"""Types of the arrays in a page, as ``parts/page.js`` reads them."""
ARRAY_ALIGNMENT_BYTES = 8
"""Alignment of arrays that JavaScript requires."""
SCRIPT_ESCAPES = {letter: f"\\u{ord(letter):04x}" for letter in "<>&"}


def build_document(
    title: str, body: str, scripts: Sequence[str], data: Mapping[str, object], asks: bool = False
) -> str:
    """Build a page of the files ``body`` and ``scripts`` of ``parts/``; a server adds data if the page ``asks``."""
    style = _read_page_part("tokens.css") + _read_page_part("page.css")
    codes = [_read_page_part(name) for name in scripts]
    asking = "; connect-src 'self'" if asks else ""
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_csp_hash, codes))}; style-src {_csp_hash(style)}; "
        f"img-src data:; base-uri 'none'; form-action 'none'{asking}"
    )
    lines = [
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta name="generator" content="getagrip {__version__}">\n<title>{html.escape(title)}</title>',
        f'<link rel="icon" href="data:,">\n<style>{style}</style>\n</head>\n<body>',
        _read_page_part(body),
        f'<script type="application/json" id="data">{json_for_script(data)}</script>',
        *(f"<script>{code}</script>" for code in codes),
    ]
    return "\n".join([*lines, "</body>\n</html>\n"])


def json_for_script(data: Mapping[str, object]) -> str:
    """Write JSON for a script element, without characters that end or begin an element."""
    compact = json.dumps(json.loads(files.to_json(data)), separators=(",", ":"), ensure_ascii=True)
    for letter, escape in SCRIPT_ESCAPES.items():  # many times as quick as str.translate
        compact = compact.replace(letter, escape)
    return compact


def pack_arrays(arrays: Mapping[str, ndarray]) -> tuple[dict[str, dict[str, object]], str]:
    """Pack arrays: type, shape and offset [bytes] of each by name, and the deflated content of all as base64."""
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
    return f"'sha256-{base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()}'"


MAX_PAGE_FRAMES = 120
"""Maximum number of frames that a page plays; longer clips are sampled evenly, and the worst frame is added."""
RESULT_PAGE_SCRIPTS = ("page.js", "scene.js", "viewer.js", "plots.js", "sources.js", "columns.js", "report.js")
PAGE_SCA_CONTACT = ContactDefinition("object", 0.010)
"""Definition of contact for SCA among ``MAIN_METRICS``."""
MAIN_METRICS: Mapping[str, Metric] = {
    "ADD": ADD_MM, "ADD sym.": ADD_SYM_MM, "in the camera": ADD_SYM_CAM_MM, "rotation sym.": ROTATION_SYM,
    f"SCA {PAGE_SCA_CONTACT.distance}": SCA, "stays in the simulated hand": REPLAY_STABILITY,
}  # fmt: skip
"""Metrics at the top of the page beside the IOU, each under a short name."""
PLOTTED_METRICS: Mapping[str, Metric] = {"ADD, symmetries allowed": ADD_SYM_MM}
"""Metrics per frame that are plotted where known, by the title of the plot."""
METRIC_LABELS = {"iou": "iou, in the crop", "iou_soft": "iou_soft, in the crop"}
"""Labels of metrics whose keys could be confused with the IOU at the top of the page."""


def write_page(view: View, evaluation: Evaluation, record: Json, path: Path) -> Path:
    """Write the page of a result and return its path.

    ``evaluation`` holds the result's metrics, ``record`` the content of its ``result.json``. Raises ``InputError`` for
    an unreadable image, ``UsageError`` for an unknown method.
    """
    view, label = decimate_view(view), label_of(view.result.method)
    shown = _select_page_frames(view)
    some = view.at([view.result.frames[n] for n in shown])
    surface, crops = subdivide_object(some), smooth_windows(some, FRAME_PICTURE_PX)
    candidates = candidate_views(some)
    constant = scene_data.constant_arrays(candidates, surface)
    where, packed = pack_arrays(constant | scene_data.per_frame_arrays(some, surface))
    pictures = [draw_page_frame(some, n, crops, n, candidates[1:]) for n in range(len(shown))]
    views: list[list[dict[str, object]]] = [[] for _ in shown]
    for camera in some.cameras:
        seen, others = some.in_view(camera), [one.in_view(camera, with_masks=False) for one in candidates[1:]]
        crops = smooth_windows(seen, VIEW_PICTURE_PX)
        for n, iou in enumerate(seen.measured_iou().tolist()):
            views[n].append(draw_page_frame(seen, n, crops, n, others, iou))
    pictures = [picture | {"views": each} for picture, each in zip(pictures, views, strict=True)]
    column = describe_result(view, label, evaluation, record) | {"masked": view.masks is not None}
    column |= {"arrays": where, "packed": packed, "pictures": pictures}
    column["plots"].append(gap_plot(surface_gap(view)))
    data = {"shown": {**timeline_data(view, shown), "columns": [column]}}
    files.write_text(path, build_document(f"{view.clip.name}, {label}", "viewer.html", RESULT_PAGE_SCRIPTS, data))
    return path


def _select_page_frames(view: View) -> Int[ndarray, "n"]:
    T, iou = len(view.result.frames), view.result.iou
    chosen = {int(n) for n in np.linspace(0, T - 1, min(T, MAX_PAGE_FRAMES)).round()}
    if not np.isnan(iou).all():
        chosen.add(int(np.nanargmin(iou)))
    return np.array(sorted(chosen))


def timeline_data(view: View, shown: Int[ndarray, "n"]) -> Json:
    """Return the data that all results of a page share: times, frames, segments, contact distances [m] and colours."""
    names, kinds, segments = view.result.frames, view.result.frame_kind, view.clip.segments
    near = {"at": scene_data.DEFAULT_CONTACT_DISTANCE_M, "most": scene_data.MAX_CONTACT_SLIDER_M}
    colours = {"object": RESULT_COLOUR, "hand": HAND_LINE_COLOUR, "true": TRUTH_COLOUR}
    return {
        "clip": view.clip.name,
        "times": result_times(view),
        "frames": [{"n": n, "name": names[n], "kind": kinds[n]} for n in shown.tolist()],
        "segments": [
            {"words": view.called(s)[0], "colour": STATE_COLOURS[s.state], "first": s.first, "last": s.last}
            for s in segments
        ],
        "size": FRAME_PICTURE_PX,
        "sizeOfViews": VIEW_PICTURE_PX,
        "near": near | {"reach": scene_data.MAX_EXACT_DISTANCE_M, "fades": CONTACT_BORDER_M},
        "colours": colours | {"observed": INK_COLOUR, "axis": AXIS_COLOUR},
    }


def describe_result(view: View, label: str, evaluation: Evaluation, record: Json) -> Json:
    """Return the page's fields of a result."""
    result, clip = view.result, view.clip
    main = _main_probability(result)
    if not np.isnan(result.mean_iou):
        main.append({"name": "IOU", "value": f"{100 * result.mean_iou:.1f} %"})
    main += _iou_of_views(evaluation.iou_of_views)
    main += _main_metric_rows(evaluation.headline, bool(evaluation.metrics_of_grasps))
    main += _main_metric_rows({REPLAY_STABILITY.name: record.get("metrics", {}).get(REPLAY_STABILITY.name)}, False)
    hand = f"a {clip.side} hand" if clip.other_hand is None else "both hands"
    away = result.distance_interval_mm
    return {
        "label": label,
        "facts": [
            f"{clip.category} in {hand}",
            view.frames_in_words,
            *view.size_in_words,
            *([] if away is None else [f"{away[0]:.0f} to {away[1]:.0f} mm from the camera, with 90 %"]),
        ],
        "status": "; ".join(filter(None, (result.message, result.looks))),
        "ambiguous": result.ambiguous,
        "findings": [{"serious": f.serious, "check": f.check, "message": f.message} for f in result.findings],
        "notes": [
            *_describe_segments(result),
            *map(str, result.notes),
        ],
        "views": [camera.name for camera in view.cameras],
        "candidates": [{"energy": energy} for energy in result.candidates.energy.tolist()],
        "version": str(record.get("software", {}).get("getagrip", "")),
        "main": main,
        "plots": _metric_plots(view, evaluation.per_frame),
        "tables": result_tables(view, evaluation, record),
    }


def _describe_segments(result: Reconstruction) -> list[str]:
    out = []
    for segment in result.segments:
        met = "" if segment.iou is None else f", IOU {segment.iou:.2f}"
        side = f" ({segment.side} hand)" if segment.side else ""
        how = ", tracked by the masks only" if segment.by_masks else ""
        if segment.state == "grasp":
            how += f", probability right {segment.probability_right or 'unknown'}"
        out.append(f"{segment.state}{side}: frames {segment.first} to {segment.last}{met}{how}")
    return out


def _main_probability(result: Reconstruction) -> list[dict[str, str]]:
    """Return one number for both reference frames; what else is known of them is folded."""
    known = result.probabilities
    if not known:
        return []
    value = ", ".join(f"{format_probability(right.value)}{'*' if right.beyond else ''}" for right in known.values())
    frames = ", ".join(where.split()[-1] for where in known)
    name = f"probability right: {frames}{' (* extrapolated)' if '*' in value else ''}"
    return [{"name": name, "value": value, "meaning": "\n".join(map(": ".join, probability_meanings(result).items()))}]


def _iou_of_views(found: Mapping[str, float]) -> list[dict[str, str]]:
    """Return one number for the IOU in all further views where known, with each of them folded."""
    known = {name: value for name, value in found.items() if not np.isnan(value)}
    if not known:
        return []
    low, high = (f"{100 * end(known.values()):.1f}" for end in (min, max))
    name = f"IOU in {len(known)} further views" if len(known) > 1 else f"IOU in {next(iter(known))}"
    each = "\n".join(f"{name}: {100 * value:.1f} %" for name, value in known.items())
    return [{"name": name, "value": f"{low} to {high} %" if low != high else f"{low} %", "meaning": each}]


def _main_metric_rows(metrics: Mapping[str, float | None], of_grasps: bool) -> list[dict[str, str]]:
    out = []
    for name, metric in MAIN_METRICS.items():
        if (value := metrics.get(metric.key(PAGE_SCA_CONTACT))) is not None and not np.isnan(value):
            where = ", in grasps" if of_grasps and metric is SCA else ""
            out.append({"name": f"{name}{where}", "value": f"{metric.text(value)}{unit_of(metric)}"})
    return out


def _metric_plots(view: View, per_frame: Mapping[str, Sequence[float]]) -> list[dict[str, object]]:
    """Return the curves that are quick to compute; ``gap_plot`` is not."""
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
    """Return the curve of the gap of hand and object [m]."""
    line = _plot_line("gap", 1e3 * values, HAND_LINE_COLOUR)
    return {"title": "gap of hand and object", "unit": "mm", "lines": [line], "upTo": (0, 0)}


def _plot_line(name: str, values: Float[ndarray, "T"], colour: str) -> Json:
    return {"name": name, "values": np.round(values, 3), "colour": colour}


def result_tables(view: View, evaluation: Evaluation, record: Json) -> list[dict[str, object]]:
    """Return the folded tables as ``parts/report.js`` reads them: title, column names if any, and rows of texts."""
    result = view.result
    known = {metric.key(contact): metric for metric in METRICS.working().values() for contact in CONTACT_DEFINITIONS}
    values = [
        [f"{METRIC_LABELS.get(key, key)}{where}", f"{known[key].text(value)}{unit_of(known[key])}"]
        for metrics, where in ((evaluation.metrics, ""), (evaluation.metrics_of_grasps, ", in grasps"))
        for key, value in metrics.items()
        if key in known
    ]
    values += [[f"{IOU_FULL.name}, in {name}", IOU_FULL.text(met)] for name, met in evaluation.iou_of_views.items()]
    content = {
        "What the probabilities mean": _key_value_rows(probability_meanings(result)),
        "Metrics (docs/metrics.md)": values,
        "Checks (docs/checks.md)": _check_rows(result.checks, result.findings),
        "Energy [px²]": _key_value_rows(result.energy),
        "Time [s]": _key_value_rows(result.seconds),
        "Options": [*_key_value_rows(result.options), ["seed", str(result.seed)]] if result.options else [],
        "Sources of the clip": _key_value_rows(view.clip.provenance),
        "Software": _key_value_rows(record.get("software", {})),
    }
    heads = {"Checks (docs/checks.md)": ("check", "value", "usual", "verdict")}
    return [{"title": title, "head": heads.get(title, ()), "rows": rows} for title, rows in content.items() if rows]


def probability_meanings(result: Reconstruction) -> dict[str, str]:
    """Explain the probabilities of a result, or of a timeline's first grasp, by "right in the hand" and the like."""
    of_grasps = (segment.probability_right for segment in result.segments if segment.probability_right is not None)
    meanings = {f"right {where}": f"{it}{it.keeping}; {it.meaning}" for where, it in result.probabilities.items()}
    if (first := next(of_grasps, None)) is not None:
        meanings["right in the hand"] = first.meaning
    return meanings


def unit_of(metric: Metric) -> str:
    """Return a metric's unit, with the space that separates it from a number."""
    return "°" if metric.unit == "deg" else f" {metric.unit}"


def _check_rows(checks: Mapping[str, float], findings: Sequence[Finding]) -> list[list[str]]:
    """Return the value, the limits and the verdict of each check; of an unknown one the value alone."""
    found = {finding.check: "serious" if finding.serious else "note" for finding in findings}
    known = {check.name: check for check in (*input_checks(), *result_checks(), JUMP_CHECK)}
    return [
        [name, "" if np.isnan(value) else check.shown(value), check.usual, found.get(name) or check.verdict(value)]
        if (check := known.get(name)) is not None
        else [name, f"{value:.3g}", "", ""]
        for name, value in checks.items()
    ]


def _key_value_rows(content: Mapping[str, object]) -> list[list[str]]:
    return [[str(key), f"{value:.4g}" if isinstance(value, float) else str(value)] for key, value in content.items()]
