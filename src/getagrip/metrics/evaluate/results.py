"""Evaluation of results by all metrics of docs/metrics.md, means over clips, and printed tables."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote_to_bytes

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks, check_masks, find_masks, input_sha256, read_clip
from getagrip.clip.views import find_cameras
from getagrip.errors import InputError, NamedFields, check_arguments, escape_unprintable
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io import files
from getagrip.io.array_data import Brief
from getagrip.io.files import Json
from getagrip.io.terminal import Progressed, make_table, progress_callback
from getagrip.metrics.contact import (
    CONTACT_DEFINITIONS,
    ContactDefinition,
    ContactDistances,
    contact_distances,
    stable_contact,
)
from getagrip.metrics.evaluate.comparison import Comparison, with_result_hands
from getagrip.metrics.evaluate.metric import (
    IOU_FULL,
    IOU_OF_VIEW,
    METRICS,
    SCA,
    TRUE_SCA,
    Metric,
    compute_metrics,
    nan_mean,
)
from getagrip.metrics.mask import MaskIou, iou_in_views, iou_of_poses
from getagrip.metrics.pose import ObjectTrack
from getagrip.result import Reconstruction, read_result

if TYPE_CHECKING:
    from rich.table import Table

TIMELINE_METRICS_NOTE = (
    "a timeline: poses are compared in the frame of the clip's own hand, and contact is with that hand, in all frames, "
    "also in those in which it does not hold the object; metrics_of_grasps has the stable contact area of its grasps"
)
"""Note on the metrics of a timeline."""
_OBJECT_CONTACT_DEFINITION, _HAND_CONTACT_DEFINITION = (ContactDefinition(side, 0.010) for side in ("object", "hand"))
"""Definitions of contact in the table of results: that of reports and benchmarks, and that of a mesh per frame."""


@dataclass(frozen=True, kw_only=True)
class Evaluation(NamedFields, Brief):
    """The metrics of a reconstruction (docs/metrics.md). The names of metrics end in their units.

    Attributes:
        clip: name of the clip.
        category: category of the object, such as "mug".
        method: name of the method.
        frames: names of the T frames.
        symmetry: the object's symmetries, in words; None without ground truth.
        metrics: one number for each metric.
        per_frame: T numbers for each metric that is measured in each frame.
        metrics_of_fitted: the same metrics over the frames that are not interpolated; empty if none is interpolated.
        metrics_of_grasps: for a timeline, the stable contact area within its grasps; otherwise empty.
        frame_kind: origin of each frame's pose: ``sampled``, ``fitted`` or ``interpolated``; empty for meshes.
        findings: findings about the inputs and the result, as sentences.
        notes: remarks on the measurement, as sentences.
        result: folder of the result; None for results in memory.
    """

    clip: str
    category: str
    method: str
    frames: list[str]
    symmetry: str | None
    metrics: dict[str, float]
    per_frame: dict[str, list[float]]
    metrics_of_fitted: dict[str, float] = field(default_factory=dict)
    metrics_of_grasps: dict[str, float] = field(default_factory=dict)
    frame_kind: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    result: str | None = None

    @staticmethod
    def recorded(clip: Clip, method: str, metrics: dict[str, float]) -> Evaluation:
        """Make the evaluation of a result from its recorded metrics."""
        return Evaluation(
            clip=clip.name, category=clip.category, method=method, frames=list(clip.frames), symmetry=None,
            metrics=metrics, per_frame={},
        )  # fmt: skip

    @property
    def headline(self) -> dict[str, float]:
        """The metrics of the clip; those of a timeline's stable contact are of its grasps."""
        return self.metrics | self.metrics_of_grasps

    @property
    def iou_of_views(self) -> dict[str, float]:
        """The mean IOU in the whole images of each further view, by its name."""
        known = {key: value for key, value in self.metrics.items() if key.startswith(IOU_OF_VIEW)}
        return {key.removeprefix(IOU_OF_VIEW): value for key, value in known.items()}

    def fields(self) -> dict[str, object]:
        """Return the fields as ``evaluate --json`` writes them, without empty ones."""
        entry = {key: value for key, value in asdict(self).items() if value or key in ("symmetry", "metrics")}
        return {"result": entry.pop("result"), **entry} if "result" in entry else entry


def evaluate_result(folder: str | Path, clips: str | Path | None = None) -> Evaluation:
    """Compute all metrics of one result folder against its clip.

    ``clips`` is the clip's folder or one that contains it under its name; by default the clip is searched at the path
    in ``result.json`` and beside the result. Raises ``InputError`` without such a clip, if it has changed since the
    reconstruction, and for frames of the result that it lacks.
    """
    result, clip, masks = read_result_clip_masks(Path(folder), clips)
    return replace(evaluate(result, clip, masks), result=str(folder))


def read_result_clip_masks(folder: Path, clips: str | Path | None = None) -> tuple[Reconstruction, Clip, Masks | None]:
    """Read a result, and its clip and masks at the result's frames.

    Raises ``InputError`` as ``evaluate_result`` does.
    """
    result, clip = read_result_and_clip(folder, clips)
    return result, clip, find_masks(clip)


def read_result_and_clip(folder: Path, clips: str | Path | None = None) -> tuple[Reconstruction, Clip]:
    """Read a result, and its clip at the result's frames. Raises ``InputError`` as ``evaluate_result`` does."""
    result, record = read_result(folder)
    clip = clip_of(folder, result, record, clips)
    return result, clip.take(clip.index_of(result.frames))


@check_arguments
def evaluate(
    result: Reconstruction,
    clip: Clip,
    masks: Masks | None = None,
    contacts: Sequence[ContactDefinition] | None = None,
    wanted: Sequence[Metric] | None = None,
    progress: Progressed = None,
) -> Evaluation:
    """Compute the metrics of a reconstruction (docs/metrics.md).

    Args:
        result: the reconstruction, from ``reconstruct`` or ``read_result``. Only its frames are measured.
        clip: the clip that was reconstructed. Without ground truth (``clip.clip``) only IOU, contact and penetration
            are measured; with it also the errors of the poses, such as ADD.
        masks: masks of all frames of the clip. If None, IOU is measured in further views only.
        contacts: definitions of contact (distance and points) for the metrics of stable contact; None for all nine.
        wanted: the metrics to compute; None for all.
        progress: True for a bar on a terminal or in a notebook; or a function of a metric's name and of the fraction
            of the work that is done, 0 to 1.

    Returns:
        Numbers for the whole clip (``metrics``) and for each frame (``per_frame``), under names that end in their
        units, or in a colon and the name of a further view. A very large mesh is measured with fewer faces; ``notes``
        then gives their number.

    Raises:
        InputError: the clip lacks a frame of the result.
        UsageError: the masks have another number or size of frames than the clip.
    """
    contacts = CONTACT_DEFINITIONS if contacts is None else contacts
    wanted = tuple(METRICS.working().values()) if wanted is None else wanted
    if masks is not None:
        check_masks(clip, masks)
    views = iou_of_views(result, clip) if IOU_FULL in wanted else {}
    index, whole_mesh, clip = clip.index_of(result.frames), clip.mesh, clip.light()
    clip = clip.take(index).with_hand_at(result.T_cam_hand, scale=result.hand_scale)
    masks = None if masks is None else masks.take(index)
    found, track = clip.warped(result.warp).mesh, ObjectTrack(result.T_hand_obj, result.scale)
    it = _ResultComparison(clip, masks, track, found, contacts=tuple(contacts))
    symmetry = None if clip.truth is None else it.symmetries.describe()
    with progress_callback(progress, clip.name) as on_metric:
        made = evaluate_comparison(it, result.method, symmetry, wanted, on_metric)
    hands, fitted = clip.with_hand_at(None, result.T_cam_other_hand), result.frames_of("sampled", "fitted")
    return replace(
        made,
        metrics=made.metrics | {key: nan_mean(values) for key, values in views.items()},
        per_frame=made.per_frame | {key: values.tolist() for key, values in views.items()},
        metrics_of_grasps=sca_in_grasps(hands, found, track, it.contacts, it.reach) if SCA in wanted else {},
        metrics_of_fitted=compute_metrics(it.take(fitted), wanted)[0] if 0 < len(fitted) < len(clip) else {},
        frame_kind=result.frame_kind,
        findings=tuple(map(str, result.findings)),
        notes=(*clip.mesh.stands_for(whole_mesh, "measured"), *([TIMELINE_METRICS_NOTE] if result.segments else [])),
    )


def iou_of_views(result: Reconstruction, clip: Clip) -> dict[str, Float[ndarray, "T"]]:
    """Compute a result's IOU in each frame of the clip's further views, by the metrics' keys; empty without views.

    Raises ``InputError``.
    """
    views, index = find_cameras(clip), clip.index_of(result.frames)
    if not views:
        return {}
    light, views = clip.take(index).light().warped(result.warp), tuple(view.take(index) for view in views)
    at = light.with_hand_at(result.T_cam_hand, result.T_cam_other_hand, result.hand_scale)
    found = iou_in_views(at, views, at.mesh, result.scale, at.hand.T_cam_hand @ result.T_hand_obj)
    return {f"{IOU_OF_VIEW}{name}": values for name, values in found.items()}


def evaluate_comparison(
    it: Comparison,
    method: str,
    symmetry: str | None,
    wanted: Sequence[Metric] | None = None,
    on_metric: Callable[[str, float], None] | None = None,
) -> Evaluation:
    """Compute the metrics of a comparison."""
    metrics, per_frame = compute_metrics(it, wanted, on_metric)
    return Evaluation(
        clip=it.clip.name,
        category=it.clip.category,
        method=method,
        frames=list(it.clip.frames),
        symmetry=symmetry,
        metrics=metrics,
        per_frame=per_frame,
    )


@dataclass(frozen=True, eq=False)
class _ResultComparison(Comparison):
    """A comparison of poses of the clip's mesh, or of the deformed one.

    Poses are compared with the clip's mesh, which the ground truth poses; masks and contact with the found mesh.
    """

    track: ObjectTrack
    found: Mesh
    part_of: tuple[_ResultComparison, Int[ndarray, "n"]] | None = None
    """The comparison from which this one was taken, and the indices of its frames there."""

    def take(self, index: Int[ndarray, "n"]) -> _ResultComparison:
        """Return the comparison in some of the frames."""
        masks = None if self.masks is None else self.masks.take(index)
        track = ObjectTrack(self.track.T_ref_obj[index], self.track.scale)
        return replace(self, clip=self.clip.take(index), masks=masks, track=track, part_of=(self, index))

    @property
    def predicted(self) -> ObjectTrack:
        return self.track

    @cached_property
    def iou(self) -> MaskIou:
        track = self.predicted_in_camera
        return iou_of_poses(self.found, track.scale, track.T_ref_obj, self.clip.K, self.judged_masks)

    @cached_property
    def distances(self) -> ContactDistances:
        if self.part_of is not None:
            whole, index = self.part_of
            return whole.distances.take(index)
        hand = self.clip.hand
        return contact_distances(self.found, [self.track], hand.vertices, hand.faces, self.reach)[0]


def clip_of(folder: Path, result: Reconstruction, record: Json, clips: str | Path | None) -> Clip:
    """Find and read the clip of a result."""
    found = clip_folder(folder, record, clips)
    clip = read_clip(found)
    if clip.name != result.clip:
        raise InputError(
            found / "clip.json", "name", files.shorten_value(clip.name), f"{result.clip!r}, as {folder} says"
        )
    if (own := with_result_hands(clip, folder)) is not None:
        return own
    if record.get("input_sha256") != input_sha256(found):
        got = "another: its masks, hands or mesh have changed"
        raise InputError(folder / "result.json", "input_sha256", got, f"that of {found}; reconstruct it again")
    return clip


def clip_folder(folder: Path, record: Json, clips: str | Path | None) -> Path:
    """Find the folder of a result's clip. Raises ``InputError`` where it does not exist."""
    name = record["clip"]
    if clips is not None:
        places = [Path(clips) / name, Path(clips)]
    else:
        recorded = record.get("clip_folder")
        places = [_decode_recorded_path(recorded)] if isinstance(recorded, str) and recorded else []
        places += [folder.parent / name, folder.parent.parent / name]
    found = next((place for place in places if _is_file(place / "clip.json")), None)
    if found is None:
        where = " or ".join(str(place) for place in places)
        expected = f"its folder at {where}; say where with --clips"
        raise InputError(folder / "result.json", "clip", f"the clip {files.shorten_value(name)}", expected)
    return found


def _decode_recorded_path(folder: str) -> Path:
    """Path of the clip as ``result.write`` recorded it."""
    address = folder.removeprefix("file://")
    return Path(folder if address == folder else os.fsdecode(unquote_to_bytes(address)))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a recorded path may exceed the system's limits
        return False


def sca_in_grasps(
    clip: Clip, found: Mesh, track: ObjectTrack, contacts: Sequence[ContactDefinition], reach: float
) -> dict[str, float]:
    """Compute SCA by key of the metric, mean over the grasps of a timeline, each with the grasping hand.

    ``clip`` has the found hands, ``track`` poses the mesh ``found`` in the clip's own hand. Distances are exact up to
    ``reach`` [m]. Empty where no grasp has two frames in which its hand is known.
    """
    each = []
    for segment in clip.segments:
        by, rows = clip.with_side(segment.side), segment.rows[clip.hand_known(segment.side)[segment.rows]]
        if segment.state != "grasp" or by is None or len(rows) < 2:
            continue
        hand = by.hand.take(rows)
        T_hand_obj = se3.inverse(hand.T_cam_hand) @ clip.hand.T_cam_hand[rows] @ track.T_ref_obj[rows]
        track_in_hand = ObjectTrack(T_hand_obj, track.scale)
        (distances,) = contact_distances(found, [track_in_hand], hand.vertices, hand.faces, reach)
        each.append([stable_contact(distances, contact).sca for contact in contacts])
    if not each:
        return {}
    return dict(zip((SCA.key(contact) for contact in contacts), np.mean(each, axis=0).tolist(), strict=True))


def summary(evaluations: Sequence[Evaluation]) -> Json:
    """Summarise evaluations, all together and by method.

    For each metric: its mean over the clips that have it, and their number.
    """
    return {
        "samples": [evaluation.fields() for evaluation in evaluations],
        **_mean_metrics(evaluations),
        "methods": {method: _mean_metrics(group) for method, group in group_by_method(evaluations).items()},
    }


def group_by_method(evaluations: Sequence[Evaluation]) -> dict[str, list[Evaluation]]:
    """Group the evaluations by method."""
    methods = dict.fromkeys(e.method for e in evaluations)
    return {method: [e for e in evaluations if e.method == method] for method in methods}


def _mean_metrics(evaluations: Sequence[Evaluation]) -> dict[str, Json]:
    keys = list(dict.fromkeys(key for evaluation in evaluations for key in evaluation.metrics))
    columns = {key: np.array([e.metrics.get(key, np.nan) for e in evaluations], dtype=float) for key in keys}
    return {
        "mean": {key: nan_mean(values) for key, values in columns.items()},
        "clips": {key: int(np.count_nonzero(~np.isnan(values))) for key, values in columns.items()},
    }


def results_table(evaluations: Sequence[Evaluation]) -> Table:
    """Make a table with one row per result, and the mean of each method.

    Columns without any value (no ground truth, known scale) are left out.
    """
    from rich.text import Text  # no markup: names may hold brackets

    groups = group_by_method(evaluations)
    means = {method: _mean_metrics(group)["mean"] for method, group in groups.items()}
    overall = _mean_metrics(evaluations)["mean"]
    columns = [
        (f"{m.heading}\n{m.unit}", m, m.key(_OBJECT_CONTACT_DEFINITION))
        for m in METRICS.working().values()
        if m.heading and not m.by_contact
    ]
    columns += [
        (f"SCA\n{_OBJECT_CONTACT_DEFINITION.distance}\n%", SCA, SCA.key(_OBJECT_CONTACT_DEFINITION)),
        ("true\nSCA\n%", TRUE_SCA, TRUE_SCA.key(_OBJECT_CONTACT_DEFINITION)),
    ]
    columns = [column for column in columns if not np.isnan(overall.get(column[2], np.nan))]
    if any(SCA.key(_OBJECT_CONTACT_DEFINITION) not in e.metrics for e in evaluations):  # new meshes in each frame
        columns.append(("hand\nSCA\n%", SCA, SCA.key(_HAND_CONTACT_DEFINITION)))

    def cells(metrics: Mapping[str, float]) -> list[str]:
        return [metric.text(metrics.get(key, np.nan)) for _, metric, key in columns]

    results = _empty_metrics_table("clip", [heading for heading, _, _ in columns])
    results.caption = "; ".join(dict.fromkeys(metric.meaning for _, metric, _ in columns if metric.meaning))
    results.caption_justify = "left"
    for e in evaluations:
        name = f"{e.clip}\n{e.method}" if len(groups) > 1 else e.clip
        results.add_row(Text(escape_unprintable(name, "\n")), *cells(e.metrics))
    if len(evaluations) > len(groups):
        results.add_section()
        for method, group in groups.items():
            of = f" ({method})" if len(groups) > 1 else ""
            results.add_row(Text(escape_unprintable(f"mean of {len(group)}{of}")), *cells(means[method]))
    return results


def contact_tables(evaluations: Sequence[Evaluation]) -> list[Table]:
    """Make a table per method of the metrics of stable contact by definition of contact."""
    groups = group_by_method(evaluations)
    return [
        _contact_table(method if len(groups) > 1 else "", _mean_metrics(group)["mean"])
        for method, group in groups.items()
    ]


def _contact_table(method: str, mean: Mapping[str, float]) -> Table:
    known = {key for key, value in mean.items() if not np.isnan(value)}
    shown = [
        metric
        for metric in METRICS.working().values()
        if metric.by_contact and metric.heading and any(metric.key(d) in known for d in CONTACT_DEFINITIONS)
    ]
    table = _empty_metrics_table(f"contact\n{method}".strip(), [metric.heading for metric in shown])
    for side, definitions in groupby(CONTACT_DEFINITIONS, lambda d: d.side):
        for d in definitions:
            table.add_row(f"{side} {d.distance}", *(m.text(mean.get(m.key(d), np.nan)) for m in shown))
        table.add_section()
    return table


def _empty_metrics_table(first: str, headings: list[str]) -> Table:
    from rich.text import Text

    table = make_table()
    table.add_column(Text(escape_unprintable(first, "\n")), overflow="fold", vertical="bottom")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
