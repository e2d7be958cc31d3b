"""Our result, with the per-frame meshes of systems without a CAD model, such as iHOI, below it (the appendix)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from tyro.conf import arg

from getagrip.bench.figures.kind import Fail, describe_view, read_readable_results
from getagrip.bench.figures.rows import FigureRow, RowsFigure, draw_rows, row_metrics
from getagrip.errors import UsageError
from getagrip.fitting.methods import label_of
from getagrip.io.terminal import format_count
from getagrip.metrics.contact import ContactDefinition
from getagrip.metrics.evaluate.external import evaluate_meshes, read_meshes
from getagrip.metrics.evaluate.metric import IOU, SCA
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import StoredResult, at_common_frames
from getagrip.result import Reconstruction

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Ihoi(RowsFigure):
    """Our result, and under it the meshes that systems without a CAD model, as iHOI, reconstructed for each frame.

    Frames of which every system has a mesh are drawn, if any; else frames spread evenly over the clip. SCA is that of
    the hand's vertices: new meshes have no points in common.
    """

    meshes: Annotated[tuple[str, ...], arg(metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Folders with a mesh for each frame, named like it or by its number (as for evaluate --meshes)."""
    mesh_frame: Literal["camera", "hand"] = "camera"
    """The frame of their vertices [m]: the clip's camera frame or its hand frame."""

    def check(self) -> None:
        super().check()
        if not self.meshes:
            raise UsageError("missing --meshes: the meshes of another system")
        for text in self.meshes:
            name, _, folder = text.partition("=")
            if not (name and folder and Path(folder).is_dir()):
                raise UsageError(f"--meshes must be NAME=DIR, DIR a folder of meshes (got {text})")

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        contact = ContactDefinition("hand", self.contact / 1e3)
        views = at_common_frames(read_readable_results(results, fail))
        rows = [FigureRow(label_of(view.result.method), row_metrics(view, contact)[:2], view) for view in views]
        for text in self.meshes:
            name, _, folder = text.partition("=")
            rows.append(self._row(name, Path(folder), views[0], contact, fail))
        under = "  ·  ".join([*describe_view(views[0]), f"SCA: {contact.description}"])
        meshes = zip(*(row.view.frame_meshes for row in rows if row.view.frame_meshes is not None), strict=True)
        everywhere = np.array([None not in of_frame for of_frame in meshes])
        among = np.flatnonzero(everywhere) if everywhere.any() else None
        return draw_rows(rows, views[0].clip.name, under, self.frames, self.dpi, with_hand=False, among=among)

    def _row(self, name: str, folder: Path, ours: View, contact: ContactDefinition, fail: Fail) -> FigureRow:
        """Make the row of a folder of meshes, in the frames of our result."""
        clip = ours.clip
        found, errors = read_meshes(folder, clip, self.mesh_frame)
        for error in errors:
            fail(error)
        known = evaluate_meshes(found, clip, ours.masks, name).metrics
        texts = [
            f"{word} {metric.text(known[key])} {metric.unit}"
            for word, metric in (("crop IOU", IOU), ("SCA", SCA))
            if (key := metric.key(contact)) in known
        ]
        missing = sum(mesh is None for mesh in found)
        nothing = Reconstruction.external(clip.name, name, clip.frames, np.tile(np.eye(4), (len(clip), 1, 1)))
        view = replace(ours, result=nothing, frame_meshes=tuple(found))
        return FigureRow(name, texts + [f"{format_count(missing, 'frame')} without"] * (missing > 0), view)
