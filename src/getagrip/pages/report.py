"""The page of one result: it plays in 3D and over its images, with its metrics, its guesses and what is doubted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.evaluation.metric import ADD_MM, ADD_SYM_CAM_MM, ADD_SYM_MM, ROTATION_SYM, SCA, Metric
from getagrip.evaluation.results import Evaluation
from getagrip.fitting.methods import method_of
from getagrip.geometry.camera import Crops
from getagrip.io import files
from getagrip.metrics.contact import ContactDefinition
from getagrip.pages import motion
from getagrip.pages.document import document, pack
from getagrip.pages.pictures import jpeg, mask_path, paths
from getagrip.pages.tables import meanings, tables, unit_of
from getagrip.probability import RIGHT
from getagrip.result import Reconstruction
from getagrip.view.curves import angle_curve, seconds
from getagrip.view.gap import coarse, gap
from getagrip.view.shown import View
from getagrip.view.stills import steady_windows
from getagrip.view.style import AXIS, FOUND, HAND_LINE, INK, STATE, TRUE
from getagrip.view.tiles import image_in, intrinsics_of, silhouette_lines
from getagrip.view.world import called

FRAMES = 120
"""Frames that a page plays, at most; of longer clips as many, evenly sampled, and the worst."""
PICTURE, QUALITY = 480, 78
"""Side [px] and JPEG quality of the images."""
CONTACT = ContactDefinition("object", 0.010)
"""Of stable contact among the main metrics."""
MAIN: Mapping[str, Metric] = {
    "ADD": ADD_MM, "ADD sym.": ADD_SYM_MM, "in the camera": ADD_SYM_CAM_MM, "rotation sym.": ROTATION_SYM,
    f"SCA {CONTACT.distance}": SCA,
}  # fmt: skip
"""Metrics at the top of the page beside the IOU, each under a short name."""
PLOTTED: Mapping[str, Metric] = {"ADD, symmetries allowed": ADD_SYM_MM}
"""Metrics of each frame that are plotted where they are known."""


def write_page(view: View, evaluation: Evaluation, record: Mapping[str, Any], path: Path) -> Path:
    """Write the page of a result and return its path.

    ``evaluation`` is what ``evaluate`` gives for it, ``record`` the content of its ``result.json``. Raises
    ``InputError`` for an image that cannot be read, ``UsageError`` for an unknown method.
    """
    view = coarse(view)
    shown = _shown(view)
    some = view.at([view.result.frames[n] for n in shown])
    where, packed = pack(motion.arrays(some))
    crops = steady_windows(some, PICTURE)
    data = {
        **_summary(view, record),
        "main": [
            *_probably(view.result),
            *_met(view.result),
            *_main(evaluation.headline, bool(evaluation.metrics_of_grasps)),
        ],
        "segments": _bar(view),
        "plots": _plots(view, evaluation.per_frame),
        "times": seconds(view),
        "shown": shown,
        "frames": [{"name": some.result.frames[k], "kind": some.result.frame_kind[k]} for k in range(len(shown))],
        "candidates": [{"energy": e, "scale": s} for e, s in _pairs(view)],
        "pictures": [jpeg(image_in(some, k, crops, k), QUALITY) for k in range(len(shown))],
        "size": PICTURE,
        "outlines": _outlines(some, crops),
        "tables": tables(view, evaluation, record),
        "arrays": where,
        "colours": {"object": FOUND, "hand": HAND_LINE, "true": TRUE, "observed": INK, "axis": AXIS},
        "contact": f"within {1e3 * motion.CONTACT:g} mm",
    }
    page = document(
        f"{view.clip.name}, {method_of(view.result.method).label}",
        "report.html",
        ("page.js", "scene.js", "viewer.js", "plots.js", "report.js"),
        data,
        packed,
    )
    files.write_text(path, page)
    return path


def _shown(view: View) -> Int[ndarray, "n"]:
    """The frames that are played."""
    T, iou = len(view.result.frames), view.result.iou
    chosen = {int(n) for n in np.linspace(0, T - 1, min(T, FRAMES)).round()}
    if not np.isnan(iou).all():
        chosen.add(int(np.nanargmin(iou)))
    return np.array(sorted(chosen))


def _summary(view: View, record: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says in words."""
    result, clip = view.result, view.clip
    hand = f"a {clip.side} hand" if clip.other_hand is None else "both hands"
    facts = [method_of(result.method).label, f"{clip.category} in {hand}", view.frames_in_words]
    facts += view.size_in_words
    return {
        "name": clip.name,
        "facts": facts,
        "status": result.message,
        "ambiguous": result.ambiguous,
        "findings": [{"serious": f.serious, "check": f.check, "message": f.message} for f in result.findings],
        "notes": [*_segments(result), *(str(note) for note in result.notes), *_in_short(result)],
        "truth": clip.truth is not None,
        "version": str(record.get("software", {}).get("getagrip", "")),
    }


def _segments(result: Reconstruction) -> list[str]:
    """What the object of a timeline does, and how well each segment meets its masks."""
    out = []
    for segment in result.segments:
        met = "" if segment.iou is None else f", IOU {segment.iou:.2f}"
        side = f" ({segment.side} hand)" if segment.side else ""
        how = ", followed by the masks only" if segment.by_masks else ""
        if segment.state == "grasp":
            how += f", probability right {segment.probability_right or 'unknown'}"
        out.append(f"{segment.state}{side}: frames {segment.first} to {segment.last}{met}{how}")
    return out


def _bar(view: View) -> list[dict[str, Any]]:
    """The segments of a timeline for the bar under the slider; none of a clip without."""
    return [
        {"words": called(view, s)[0], "colour": STATE[s.state], "first": s.first, "last": s.last}
        for s in view.clip.segments
    ]


def _probably(result: Reconstruction) -> list[dict[str, str]]:
    """How probable it is that the result is right, where that is calibrated."""
    return [
        {"name": f"probability right {where}", "value": str(right), "meaning": right.meaning}
        for where, right in result.probabilities.items()
    ]


def _in_short(result: Reconstruction) -> list[str]:
    """What that means, as a note."""
    return [f"probability: {RIGHT}"] * bool(meanings(result))


def _met(result: Reconstruction) -> list[dict[str, str]]:
    """How well the masks are met, where they are known: the mean of the curve below."""
    return [] if np.isnan(result.mean_iou) else [{"name": "IOU", "value": f"{100 * result.mean_iou:.1f} %"}]


def _main(metrics: Mapping[str, float], of_grasps: bool) -> list[dict[str, str]]:
    """The main metrics that are known."""
    out = []
    for name, metric in MAIN.items():
        if (value := metrics.get(metric.key(CONTACT))) is not None and not np.isnan(value):
            where = ", in grasps" if of_grasps and metric is SCA else ""
            out.append({"name": f"{name}{where}", "value": f"{metric.text(value)}{unit_of(metric)}"})
    return out


def _plots(view: View, per_frame: Mapping[str, Sequence[float]]) -> list[dict[str, Any]]:
    """Curves over all frames of the result."""
    curve = angle_curve(view)
    angles = [_line("reconstructed", np.degrees(curve.found), AXIS)]
    if curve.true is not None:
        angles.append(_line("ground truth", np.degrees(curve.true), TRUE))
    plots: list[dict[str, Any]] = [
        {"title": curve.title, "unit": "°", "lines": angles},
        {
            "title": "overlap with the mask, IOU",
            "unit": "%",
            "lines": [_line("IOU", 100 * view.result.iou, FOUND)],
            "upTo": (80, 100),
        },
        {
            "title": "gap of hand and object",
            "unit": "mm",
            "lines": [_line("gap", 1e3 * gap(view), HAND_LINE)],
            "upTo": (0, 0),
        },
    ]
    for title, metric in PLOTTED.items():
        if metric.name in per_frame:
            line = _line(metric.name, np.array(per_frame[metric.name], dtype=float), TRUE)
            plots.append({"title": title, "unit": metric.unit, "lines": [line], "upTo": (0, 0)})
    return plots


def _line(name: str, values: Float[ndarray, "T"], colour: str) -> dict[str, Any]:
    return {"name": name, "values": np.round(values, 3), "colour": colour}


def _pairs(view: View) -> list[tuple[float, float]]:
    """Energy and scale of each candidate."""
    candidates = view.result.candidates
    return [(float(e), float(s)) for e, s in zip(candidates.energy, candidates.scale, strict=True)]


def _outlines(view: View, crops: Crops) -> dict[str, Any]:
    """Contours over each image: of each candidate, the hands, the ground truth and the observed mask."""
    frames = range(len(view.clip))
    result, true = view.result, view.true()
    candidates = [
        replace(view, result=replace(result, T_hand_obj=T, scale=float(scale)))
        for T, scale in zip(result.candidates.T_hand_obj, result.candidates.scale, strict=True)
    ]
    out = {
        "object": [[_contour(one, n, crops, "object") for n in frames] for one in candidates],
        "hand": [_contour(view, n, crops, "hand") for n in frames],
    }
    if true is not None:
        out["true"] = [_contour(true, n, crops, "object") for n in frames]
    if view.masks is not None:
        out["observed"] = [mask_path(view.masks.object[n], crops, n) for n in frames]
    return out


def _contour(view: View, n: int, crops: Crops, what: str) -> str:
    K = intrinsics_of(view, n, crops, n)
    surfaces = view.hands(n) if what == "hand" else [(view.object(n), view.clip.mesh.faces)]
    return "".join(paths(silhouette_lines(*surface, K, crops.size)) for surface in surfaces)
