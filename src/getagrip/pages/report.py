"""The page of one result: it plays in 3D and over its images, with metrics, assumptions and findings.

Tables that are folded at first hold everything that is known but not shown above.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks import input_checks, result_checks
from getagrip.checks.of_timeline import JUMP
from getagrip.evaluation.metric import ADD_MM, ADD_SYM_CAM_MM, ADD_SYM_MM, METRICS, REPLAY, ROTATION_SYM, SCA, Metric
from getagrip.evaluation.results import Evaluation
from getagrip.fitting.methods import label_of
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition
from getagrip.pages import motion
from getagrip.pages.document import document, pack
from getagrip.pages.frames import PICTURE, drawn, outline
from getagrip.pictures.shown import View, angle_curve, candidate, seconds
from getagrip.pictures.stills import steady_windows
from getagrip.pictures.style import AXIS, FOUND, HAND_LINE, INK, STATE, TRUE
from getagrip.pictures.touched import BORDER, coarse, finer, gap
from getagrip.probability import RIGHT
from getagrip.result import Reconstruction

FRAMES = 120
"""Frames that a page plays, at most; of longer clips as many, evenly sampled, and the worst."""
SCRIPTS = ("page.js", "scene.js", "viewer.js", "plots.js", "sources.js", "columns.js", "report.js")
CONTACT = ContactDefinition("object", 0.010)
"""Definition of contact of SCA among the main metrics."""
MAIN: Mapping[str, Metric] = {
    "ADD": ADD_MM, "ADD sym.": ADD_SYM_MM, "in the camera": ADD_SYM_CAM_MM, "rotation sym.": ROTATION_SYM,
    f"SCA {CONTACT.distance}": SCA, "stays in the simulated hand": REPLAY,
}  # fmt: skip
"""Metrics at the top of the page beside the IOU, each under a short name."""
PLOTTED: Mapping[str, Metric] = {"ADD, symmetries allowed": ADD_SYM_MM}
"""Metrics of each frame that are plotted where they are known."""
SAID = {"iou": "iou, in the crop", "iou_soft": "iou_soft, in the crop"}
"""Metrics whose keys could be taken for the IOU at the top of the page."""


def write_page(view: View, evaluation: Evaluation, record: Json, path: Path) -> Path:
    """Write the page of a result and return its path.

    ``evaluation`` is what ``evaluate`` gives for it, ``record`` the content of its ``result.json``. Raises
    ``InputError`` for an image that cannot be read, ``UsageError`` for an unknown method.
    """
    view, label = coarse(view), label_of(view.result.method)
    shown = _shown(view)
    some = view.at([view.result.frames[n] for n in shown])
    surface, crops = finer(some), steady_windows(some, PICTURE)
    where, packed = pack(motion.fixed(some, surface) | motion.moving(some, surface))
    pictures = [drawn(some, n, crops, n) for n in range(len(shown))]
    others = [candidate(some, rank) for rank in range(1, len(view.result.candidates.scale))]
    for n, picture in enumerate(pictures):
        picture["others"] = [outline(one, n, crops, n) for one in others]
    column = described(view, label, evaluation, record) | {"masked": view.masks is not None}
    column |= {
        "arrays": where,
        "packed": packed,
        "pictures": pictures,
        "plots": [*column["plots"], gap_plot(gap(view))],
    }
    page = document(
        f"{view.clip.name}, {label}", "viewer.html", SCRIPTS, {"shown": {**over_time(view, shown), "columns": [column]}}
    )
    files.write_text(path, page)
    return path


def _shown(view: View) -> Int[ndarray, "n"]:
    """Return the frames that are played."""
    T, iou = len(view.result.frames), view.result.iou
    chosen = {int(n) for n in np.linspace(0, T - 1, min(T, FRAMES)).round()}
    if not np.isnan(iou).all():
        chosen.add(int(np.nanargmin(iou)))
    return np.array(sorted(chosen))


def over_time(view: View, shown: Int[ndarray, "n"]) -> Json:
    """Return what all results of a page share: the times of all frames, which of them are shown, and the segments."""
    names, kinds = view.result.frames, view.result.frame_kind
    return {
        "clip": view.clip.name,
        "times": seconds(view),
        "frames": [{"n": n, "name": names[n], "kind": kinds[n]} for n in shown.tolist()],
        "segments": [
            {"words": view.called(s)[0], "colour": STATE[s.state], "first": s.first, "last": s.last}
            for s in view.clip.segments
        ],
        "size": PICTURE,
        "near": {"reach": motion.REACH, "fades": BORDER, "at": motion.CONTACT, "most": motion.MOST},
        "colours": {"object": FOUND, "hand": HAND_LINE, "true": TRUE, "observed": INK, "axis": AXIS},
    }


def described(view: View, label: str, evaluation: Evaluation, record: Json) -> Json:
    """Return the page's fields of a result."""
    return {
        **_summary(view, label, record),
        "main": [
            *_probably(view.result),
            *_met(view.result),
            *_main(evaluation.headline, bool(evaluation.metrics_of_grasps)),
            *_main({REPLAY.name: record.get("metrics", {}).get(REPLAY.name)}, False),
        ],
        "plots": _plots(view, evaluation.per_frame),
        "tables": tables(view, evaluation, record),
    }


def _summary(view: View, label: str, record: Json) -> Json:
    result, clip = view.result, view.clip
    hand = f"a {clip.side} hand" if clip.other_hand is None else "both hands"
    return {
        "label": label,
        "facts": [f"{clip.category} in {hand}", view.frames_in_words, *view.size_in_words],
        "status": "; ".join(filter(None, (result.message, result.looks))),
        "ambiguous": result.ambiguous,
        "findings": [{"serious": f.serious, "check": f.check, "message": f.message} for f in result.findings],
        "notes": [*_segments(result), *map(str, result.notes), *[f"probability: {RIGHT}"] * bool(meanings(result))],
        "candidates": [{"energy": energy} for energy in result.candidates.energy.tolist()],
        "version": str(record.get("software", {}).get("getagrip", "")),
    }


def _segments(result: Reconstruction) -> list[str]:
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


def _probably(result: Reconstruction) -> list[dict[str, str]]:
    """How probable it is that the result is right, where that is calibrated."""
    return [
        {"name": f"probability right {where}", "value": f"{right}{right.keeping}", "meaning": right.meaning}
        for where, right in result.probabilities.items()
    ]


def _met(result: Reconstruction) -> list[dict[str, str]]:
    """How well the masks are met, where they are known: the mean of the curve below."""
    return [] if np.isnan(result.mean_iou) else [{"name": "IOU", "value": f"{100 * result.mean_iou:.1f} %"}]


def _main(metrics: Mapping[str, float | None], of_grasps: bool) -> list[dict[str, str]]:
    out = []
    for name, metric in MAIN.items():
        if (value := metrics.get(metric.key(CONTACT))) is not None and not np.isnan(value):
            where = ", in grasps" if of_grasps and metric is SCA else ""
            out.append({"name": f"{name}{where}", "value": f"{metric.text(value)}{unit_of(metric)}"})
    return out


def _plots(view: View, per_frame: Mapping[str, Sequence[float]]) -> list[dict[str, object]]:
    """Curves over all frames of the result that take no time."""
    if not view.posed:
        return []
    curve = angle_curve(view)
    angles = [_line("reconstructed", np.degrees(curve.found), AXIS)]
    if curve.true is not None and not view.of_truth:
        angles.append(_line("ground truth", np.degrees(curve.true), TRUE))
    iou = _line("IOU", 100 * view.result.iou, FOUND)
    plots: list[dict[str, object]] = [{"title": curve.title, "unit": "°", "lines": angles}]
    if not np.isnan(view.result.iou).all():
        plots.append({"title": "overlap with the mask, IOU", "unit": "%", "lines": [iou], "upTo": (80, 100)})
    for title, metric in PLOTTED.items():
        if metric.name in per_frame:
            line = _line(metric.name, np.array(per_frame[metric.name], dtype=float), TRUE)
            plots.append({"title": title, "unit": metric.unit, "lines": [line], "upTo": (0, 0)})
    return plots


def gap_plot(values: Float[ndarray, "T"]) -> Json:
    """Compute the curve of distances [m], which is slow."""
    line = _line("gap", 1e3 * values, HAND_LINE)
    return {"title": "gap of hand and object", "unit": "mm", "lines": [line], "upTo": (0, 0)}


def _line(name: str, values: Float[ndarray, "T"], colour: str) -> Json:
    return {"name": name, "values": np.round(values, 3), "colour": colour}


def tables(view: View, evaluation: Evaluation, record: Json) -> list[dict[str, object]]:
    """Return tables as ``parts/report.js`` reads them: a title, names of columns or none, and rows of texts."""
    result = view.result
    known = {metric.key(contact): metric for metric in METRICS.working().values() for contact in CONTACT_DEFINITIONS}
    values = [
        [f"{SAID.get(key, key)}{where}", f"{known[key].text(value)}{unit_of(known[key])}"]
        for metrics, where in ((evaluation.metrics, ""), (evaluation.metrics_of_grasps, ", in grasps"))
        for key, value in metrics.items()
        if key in known
    ]
    content = {
        "What the probabilities mean": _rows(meanings(result)),
        "Metrics (docs/metrics.md)": values,
        "Checks (docs/checks.md)": _checked(result.checks),
        "Energy [px²]": _rows(result.energy),
        "Time [s]": _rows(result.seconds),
        "Options": [*_rows(result.options), ["seed", str(result.seed)]] if result.options else [],
        "Sources of the clip": _rows(view.clip.provenance),
        "Software": _rows(record.get("software", {})),
    }
    heads = {"Checks (docs/checks.md)": ("check", "value", "usual", "verdict")}
    return [{"title": title, "head": heads.get(title, ()), "rows": rows} for title, rows in content.items() if rows]


def meanings(result: Reconstruction) -> dict[str, str]:
    """Explain its probabilities at length, by where; of a timeline, that of its grasps."""
    of_grasps = [segment.probability_right for segment in result.segments if segment.probability_right is not None]
    known = [*result.probabilities.items(), *(("in the hand", right) for right in of_grasps[:1])]
    return {f"right {where}": right.meaning for where, right in known}


def unit_of(metric: Metric) -> str:
    """Return a metric's unit as it follows a number."""
    return "°" if metric.unit == "deg" else f" {metric.unit}"


def _checked(checks: Mapping[str, float]) -> list[list[str]]:
    """Return each check's value, its limits and its verdict; for an unknown one the value alone."""
    known = {check.name: check for check in (*input_checks(), *result_checks(), JUMP)}
    out = []
    for name, value in checks.items():
        check = known.get(name)
        if check is None:
            out.append([name, f"{value:.3g}", "", ""])
        else:
            out.append([name, "" if np.isnan(value) else check.shown(value), check.usual, check.verdict(value)])
    return out


def _rows(content: Mapping[str, object]) -> list[list[str]]:
    return [[str(key), f"{value:.4g}" if isinstance(value, float) else str(value)] for key, value in content.items()]
