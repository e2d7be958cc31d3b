"""The page of many results: as a table or a gallery, worst first by any metric, filtered by findings."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from posixpath import commonpath
from urllib.parse import quote

import numpy as np

from getagrip import __version__
from getagrip.errors import replace_surrogates
from getagrip.fitting.methods import label_of
from getagrip.io import files
from getagrip.metrics.evaluate.metric import METRICS, Metric
from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages.result_page import MAIN_METRICS, PAGE_SCA_CONTACT, build_document
from getagrip.report.pages.scene_data import jpeg_base64
from getagrip.report.pictures.panels import input_windows
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stills import draw_overlay, draw_side_view
from getagrip.result import Reconstruction
from getagrip.result.findings import MIN_SHOWN_PROBABILITY

RESULT_THUMBNAIL_PX, THUMBNAIL_JPEG_QUALITY = 220, 72
"""Side of each of the two pictures of a result [px], and their JPEG quality."""
PENETRATION_METRIC = METRICS["penetration_object_mm"]
INDEX_COLUMNS: Mapping[str, Metric] = {**MAIN_METRICS, "penetration": PENETRATION_METRIC}
"""Metrics of the index beside the IOU, each under a short name."""


@dataclass(frozen=True)
class IndexRow:
    """A result in the index; where it could not be read, only where it is and why."""

    folder: str
    """Path below the index."""
    problem: str = ""
    page: bool = False
    """True if it has a page."""
    clip: str = ""
    method: str = ""
    status: str = ""
    flags: tuple[str, ...] = ()
    """Flags against it: failed, left (not done yet), misfit, serious, note, ambiguous, guess, dropped."""
    warnings: tuple[str, ...] = ()
    """Its findings, in words."""
    values: dict[str, float] = field(default_factory=dict)
    """By the names of the columns."""
    thumbnail: str = ""
    """JPEG, in base64."""

    @property
    def kind(self) -> str:
        """Kind of the row: a result, or a clip that has failed or is left to be done."""
        return next((kind for kind in ("failed", "left") if kind in self.flags), "results")


def index_row(folder: str, view: View, evaluation: Evaluation, page: bool) -> IndexRow:
    """Make a result's row; its thumbnail shows the frame of the lowest IOU."""
    result = view.result
    known = not np.isnan(result.iou).all()
    worst = int(np.nanargmin(result.iou)) if known else 0
    crops = input_windows([view], np.array([worst]), RESULT_THUMBNAIL_PX)
    pair = np.concatenate([draw_overlay(view, worst, crops, 0), draw_side_view(view, worst, crops, 0)], axis=1)
    plain = _base_index_row(folder, result, evaluation.headline)
    values = plain.values | {"worst frame": float(result.iou[worst]) if known else np.nan}
    return replace(plain, page=page, values=values, thumbnail=jpeg_base64(pair, THUMBNAIL_JPEG_QUALITY))


def index_row_without_clip(
    folder: str, result: Reconstruction, metrics: Mapping[str, object], problem: str, page: bool = False
) -> IndexRow:
    """Make the row of a result whose clip is not read: the metrics of its ``result.json``, and why there are no more.

    So it is with results of inputs that a benchmark has changed on purpose, and of batches.
    """
    known = {key: float(value) for key, value in metrics.items() if isinstance(value, int | float)}
    plain = _base_index_row(folder, result, known)
    worst = np.nan if np.isnan(result.iou).all() else float(np.nanmin(result.iou))
    return replace(plain, problem=problem, page=page, values=plain.values | {"worst frame": worst})


def _base_index_row(folder: str, result: Reconstruction, metrics: Mapping[str, float]) -> IndexRow:
    flags = {
        "misfit": result.status.failed,
        "serious": any(finding.serious for finding in result.findings),
        "note": any(not finding.serious for finding in result.findings),
        "ambiguous": result.ambiguous,
        "guess": bool(result.assumptions),
    }
    values = {name: metrics.get(metric.key(PAGE_SCA_CONTACT), np.nan) for name, metric in INDEX_COLUMNS.items()}
    probable = {f"probability right {where}": right.value for where, right in result.probabilities.items()}
    return IndexRow(
        folder=folder,
        clip=result.clip,
        method=label_of(result.method),
        status=result.message,
        flags=tuple(name for name, holds in flags.items() if holds),
        warnings=tuple(str(finding) for finding in result.findings),
        values={"IOU": result.mean_iou} | values | probable | {"time": float(result.seconds.get("total", np.nan))},
    )


def write_index(
    rows: Sequence[IndexRow], title: str, tables: Sequence[str], path: Path, all_rows: Counter[str] | None = None
) -> Path:
    """Write the page and return its path.

    ``tables`` are files beside it that it links to; ``all_rows`` counts by ``IndexRow.kind`` where these are not all.
    """
    units: dict[str, tuple[str, int]] = {"IOU": ("%", 1)}
    units |= {name: (metric.unit, metric.decimals) for name, metric in INDEX_COLUMNS.items()}
    units |= {f"probability right {where}": ("%", 0) for where in ("in the hand", "in the camera")}
    units |= {"worst frame": ("%", 1), "time": ("s", 2)}
    known = [name for name in units if any(np.isfinite(one.values.get(name, np.nan)) for one in rows)] or ["IOU"]
    counts, title = all_rows or Counter(one.kind for one in rows), replace_surrogates(title)
    data = {
        "title": title,
        "rows": [
            {
                **asdict(one),
                "folder": replace_surrogates(one.folder),
                "problem": replace_surrogates(one.problem),
                "link": f"./{quote(os.fsencode(one.folder))}/report.html" if one.page else "",
                "set": replace_surrogates(name),
            }
            for one, name in zip(rows, _result_sets([one.folder for one in rows]), strict=True)
        ],
        "columns": [
            {
                "name": name,
                "unit": units[name][0],
                "decimals": units[name][1],
                "more": units[name][0] == "%",
                "least": MIN_SHOWN_PROBABILITY if name.startswith("probability") else 0.0,
            }
            for name in known
        ],
        "first": "ADD sym." if "ADD sym." in known else "IOU",
        "tables": [{"name": replace_surrogates(name), "link": f"./{quote(os.fsencode(name))}"} for name in tables],
        "counts": {kind: counts[kind] for kind in ("results", "failed", "left")},
        "version": __version__,
    }
    page = build_document(title, "index.html", ("page.js", "index.js"), data)
    files.write_text(path, page)
    return path


def _result_sets(folders: Sequence[str]) -> list[str]:
    """Return the folder that each result shares with others, such as its method's in a benchmark.

    It is "" where all share one.
    """
    parents = [PurePosixPath(folder).parent for folder in folders]
    shared = PurePosixPath(commonpath(parents)) if parents else PurePosixPath()
    names = [parent.relative_to(shared).as_posix() for parent in parents]
    return ["" if name == "." else name for name in names]
