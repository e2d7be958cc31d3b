"""The index page of many results: a table or a gallery, sorted by any metric, filtered by findings."""

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
from getagrip.report.pictures.stored_results import draw_overlay, draw_side_view
from getagrip.result import Reconstruction
from getagrip.result.findings import MIN_SHOWN_PROBABILITY

RESULT_THUMBNAIL_PX, THUMBNAIL_JPEG_QUALITY = 220, 72
"""Side of each of the two pictures of a result [px], and their JPEG quality."""
PENETRATION_METRIC = METRICS["penetration_object_mm"]
INDEX_COLUMNS: Mapping[str, Metric] = {**MAIN_METRICS, "penetration": PENETRATION_METRIC}
"""Metrics of the index beside the IOU, each under a short name."""


@dataclass(frozen=True)
class IndexRow:
    """A result in the index; of an unreadable one only the folder and the problem."""

    folder: str
    """Path relative to the index."""
    problem: str = ""
    page: bool = False
    """True if the result has a page."""
    clip: str = ""
    method: str = ""
    status: str = ""
    flags: tuple[str, ...] = ()
    """Any of failed, left (not done yet), misfit, serious, note, ambiguous, guess and dropped."""
    warnings: tuple[str, ...] = ()
    """Findings, in words."""
    values: dict[str, float] = field(default_factory=dict)
    """Values by column name."""
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
    """Make the row of a result whose clip is not read, from the metrics of its ``result.json``.

    Results of a batch, and of inputs that a benchmark has perturbed, are listed so; ``problem`` says why.
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
    """Write the index page and return its path.

    ``tables`` are names of files beside the page to link; ``all_rows`` counts all results by ``IndexRow.kind`` where
    ``rows`` are only some of them.
    """
    units: dict[str, tuple[str, int]] = {"IOU": ("%", 1)}
    units |= {name: (metric.unit, metric.decimals) for name, metric in INDEX_COLUMNS.items()}
    units |= {f"probability right {where}": ("%", 0) for where in ("in the hand", "in the camera")}
    units |= {"worst frame": ("%", 1), "time": ("s", 2)}
    known = [name for name in units if any(np.isfinite(one.values.get(name, np.nan)) for one in rows)] or ["IOU"]
    counts, title = all_rows or Counter(one.kind for one in rows), replace_surrogates(title)
    sets = _result_sets([one.folder for one in rows])
    least = {name: MIN_SHOWN_PROBABILITY if name.startswith("probability") else 0.0 for name in known}
    columns = [
        {"name": name, "unit": unit, "decimals": decimals, "more": unit == "%", "least": least[name]}
        for name, (unit, decimals) in ((name, units[name]) for name in known)
    ]
    data = {
        "title": title,
        "rows": [_row_data(one, name) for one, name in zip(rows, sets, strict=True)],
        "columns": columns,
        "first": "ADD sym." if "ADD sym." in known else "IOU",
        "tables": [{"name": replace_surrogates(name), "link": f"./{quote(os.fsencode(name))}"} for name in tables],
        "counts": {kind: counts[kind] for kind in ("results", "failed", "left")},
        "version": __version__,
    }
    files.write_text(path, build_document(title, "index.html", ("page.js", "histograms.js", "index.js"), data))
    return path


def _row_data(row: IndexRow, shared_folder: str) -> dict[str, object]:
    link = f"./{quote(os.fsencode(row.folder))}/report.html" if row.page else ""
    printable = {"folder": row.folder, "problem": row.problem, "set": shared_folder}
    return asdict(row) | {"link": link} | {key: replace_surrogates(text) for key, text in printable.items()}


def _result_sets(folders: Sequence[str]) -> list[str]:
    """Return the parent folder of each result relative to the deepest common one, such as a benchmark's method."""
    parents = [PurePosixPath(folder).parent for folder in folders]
    shared = PurePosixPath(commonpath(parents)) if parents else PurePosixPath()
    names = [parent.relative_to(shared).as_posix() for parent in parents]
    return ["" if name == "." else name for name in names]
