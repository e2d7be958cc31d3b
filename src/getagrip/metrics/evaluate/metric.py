"""The table of metrics (docs/metrics.md), from which JSON, printed tables and benchmarks are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.io import plugins
from getagrip.io.plugins import PluginTable
from getagrip.metrics import motion, pose
from getagrip.metrics.contact import ContactDefinition
from getagrip.metrics.evaluate.comparison import Comparison, MissingPartError

Value = float | Float[ndarray, "T"]
Group = Literal["paper", "motion", "recall"]
"""Groups of columns: the paper's; ARCTIC's of motion; areas and average recalls of RGB-D systems."""
IOU_THRESHOLDS = (0.8, 0.6)
"""Mean IOU above which SCA-IOU counts a clip (paper, Sec. 5.2)."""


@dataclass(frozen=True)
class Metric:
    """A number about a reconstruction. Fractions are between 0 and 1 and shown in per cent."""

    name: str
    """Key in JSON, followed by that of the definition of contact, if any."""
    of: Callable[[Comparison, ContactDefinition], Value]
    """One number for the clip; or one per frame (NaN: unknown), whose mean is the clip's."""
    unit: Literal["%", "mm", "deg", "frames", "m/s^2"] = "%"
    heading: str = ""
    """Column in the tables of ``evaluate``; empty: none."""
    _: KW_ONLY
    meaning: str = ""
    """Explanation of the column below the table of ``evaluate``."""
    label: str = ""
    """Column in the tables of ``bench``, of means for fractions, else of medians; empty: none."""
    group: Group = "paper"
    """Tables of ``bench`` that have this column."""
    folded: bool = False
    """True if ``bench`` shows it in the folded part of its pages."""
    decimals: int = 1
    by_contact: bool = False
    """True if the value depends on the definition of contact."""
    needs_truth: bool = False
    """True if it needs ground truth."""
    ranked: bool = True
    """True if larger is better; else methods are not compared by it."""
    averaged: bool = True
    """True if the mean over frames is a metric, too."""

    def key(self, contact: ContactDefinition) -> str:
        """Return the metric's key in JSON, by a definition of contact."""
        return f"{self.name}_{contact.key}" if self.by_contact else self.name

    def text(self, value: float) -> str:
        """Write a value as text."""
        factor = 100 if self.unit == "%" else 1
        return "-" if np.isnan(value) else f"{factor * value:.{self.decimals}f}"


def nan_mean(values: Float[ndarray, "n"]) -> float:
    """Compute the mean of the known values (not NaN); NaN without any."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else float("nan")


def _penetration_metrics(
    name: str, depth: Callable[[Comparison], ndarray], heading: str = "", meaning: str = "", needs_truth: bool = False
) -> tuple[Metric, ...]:
    """Metrics of the depth of points (T, P) inside the other body: each frame's maximum, the overall one, the mean."""

    def mean_inside(it: Comparison) -> float:
        millimetres = 1e3 * depth(it)
        inside = millimetres[millimetres > 0.0]
        return nan_mean(inside) if inside.size else 0.0

    return (
        Metric(
            f"{name}_mm",
            lambda it, _: 1e3 * depth(it).max(axis=1),
            "mm",
            heading,
            meaning=meaning,
            needs_truth=needs_truth,
        ),
        Metric(f"{name}_max_mm", lambda it, _: float(np.nanmax(1e3 * depth(it))), "mm", needs_truth=needs_truth),
        Metric(f"{name}_inside_mm", lambda it, _: mean_inside(it), "mm", needs_truth=needs_truth),
    )


def _sca_iou_metric(least: float) -> Metric:
    """SCA where the mean IOU is above a threshold, else 0."""
    return Metric(
        f"sca_iou_{100 * least:.0f}",
        lambda it, contact: it.contact(contact).sca * (nan_mean(it.iou.crop) > least),
        heading=f"SCA-IOU\n> {least:g}",
        label=f"SCA-IOU {least:g}",
        by_contact=True,
    )


def _closed_mesh_fraction(it: Comparison) -> float:
    closed = [mesh.is_closed for mesh in it.meshes if mesh is not None]
    if not closed:
        raise MissingPartError
    return float(np.mean(closed))


def _nan_mean_or_missing(values: Float[ndarray, "n"]) -> float:
    """Mean of the known values; missing without any."""
    if np.isnan(values).all():
        raise MissingPartError
    return nan_mean(values)


def _motion_deviation(it: Comparison) -> float:
    """Motion deviation of hand and object in stable contact; missing without such contact."""
    hand, object_ = it.hand_in_camera[0], it.object_in_camera[0]
    vertices = it.true.scale * it.clip.mesh.vertices
    return _nan_mean_or_missing(
        np.array([motion.motion_deviation(it.contact_pairs, vertices, hand, object_, it.clip.time)])
    )


IOU = Metric(
    "iou", lambda it, _: it.iou.crop, heading="crop\nIOU", meaning="crop IOU: in crops around the masks",
    label="IOU",
)  # fmt: skip
"""IOU in a crop around each mask; results store the IOU in the whole image."""
IOU_FULL = Metric("iou_full", lambda it, _: it.iou.full, heading="full\nIOU", meaning="full IOU: in the whole image")
IOU_OF_VIEW = f"{IOU_FULL.name}:"
"""Key of the same in a further view, before its name."""
ADD_MM = Metric(
    "add_mm",
    lambda it, _: 1e3 * it.errors.add,
    "mm",
    "ADD",
    meaning="ADD: mean distance to the truth, right if below 10 % of the diameter",
    needs_truth=True,
)
ADD_SYM_MM = Metric(
    "add_sym_mm", lambda it, _: 1e3 * it.errors_sym.add, "mm", "sym",
    meaning="sym, rot: errors up to symmetries", label="ADD sym., mm", needs_truth=True,
)  # fmt: skip
ADD_SYM = Metric(
    "add_sym_success", lambda it, _: float(it.errors_sym.success), "%", "sym", label="ADD sym.", decimals=0,
    needs_truth=True,
)  # fmt: skip
ADD_SYM_CAM_MM = Metric(
    "add_sym_cam_mm", lambda it, _: 1e3 * it.errors_sym_cam.add, "mm", needs_truth=True,
)  # fmt: skip
ADD_SYM_CAM = Metric(
    "add_sym_cam_success", lambda it, _: float(it.errors_sym_cam.success), "%", "cam", label="right in the camera",
    meaning="cam: sym in the camera", folded=True, decimals=0, needs_truth=True,
)  # fmt: skip
ROTATION_SYM = Metric(
    "rotation_sym_deg", lambda it, _: np.degrees(it.errors_sym.rotation), "deg", "rot", label="rotation sym., °",
    needs_truth=True,
)  # fmt: skip
SCA = Metric(
    "sca", lambda it, contact: it.contact(contact).sca, heading="SCA", meaning="SCA: stable contact area",
    label="SCA", by_contact=True,
)  # fmt: skip
TRUE_SCA = Metric(
    "truth_sca", lambda it, contact: it.true_contact(contact).sca, heading="truth's", label="truth's SCA",
    by_contact=True, needs_truth=True, ranked=False,
)  # fmt: skip
REPLAY_STABILITY = Metric(
    "replay_stays", lambda _, __: _nan_mean_or_missing(np.full(1, np.nan)), label="stays", decimals=0
)
"""Fraction of the frames in which the object stays in the simulated hand, where ``export.replay`` measured it."""

_bop_metric = partial(Metric, group="recall", needs_truth=True)
_METRICS: tuple[Metric, ...] = (
    IOU,
    Metric("iou_soft", lambda it, _: it.iou.soft),
    IOU_FULL,
    ADD_MM,
    Metric(
        "add_success", lambda it, _: float(it.errors.success), "%", "ADD", label="ADD", decimals=0, needs_truth=True,
    ),
    Metric("add_frame_success", lambda it, _: nan_mean(it.errors.frame_success), needs_truth=True),
    Metric("rotation_deg", lambda it, _: np.degrees(it.errors.rotation), "deg", needs_truth=True),
    Metric("translation_mm", lambda it, _: 1e3 * it.errors.translation, "mm", needs_truth=True),
    ADD_SYM_MM,
    ADD_SYM,
    Metric("add_sym_frame_success", lambda it, _: nan_mean(it.errors_sym.frame_success), needs_truth=True),
    Metric("add_cam_success", lambda it, _: float(it.errors_cam.success), needs_truth=True),
    ADD_SYM_CAM_MM,
    ADD_SYM_CAM,
    ROTATION_SYM,
    Metric("translation_sym_mm", lambda it, _: 1e3 * it.errors_sym.translation, "mm", needs_truth=True),
    Metric(
        "scale_error", lambda it, _: it.scale_error, "%", "scale", meaning="scale: error of the size", needs_truth=True,
    ),
    Metric("diameter_mm", lambda it, _: 1e3 * it.errors.diameter, "mm", needs_truth=True),
    *_penetration_metrics(
        "penetration_object", lambda it: it.depth("object"), "penetr.", "penetr.: deepest point in the hand",
    ),
    *_penetration_metrics("penetration_hand", lambda it: it.depth("hand")),
    *_penetration_metrics("truth_penetration_object", lambda it: it.true_depth("object"), needs_truth=True),
    *_penetration_metrics("truth_penetration_hand", lambda it: it.true_depth("hand"), needs_truth=True),
    SCA,
    TRUE_SCA,
    Metric(
        "sca_add", lambda it, contact: it.contact(contact).sca * it.errors.success, heading="SCA-ADD",
        meaning="SCA-ADD: SCA where ADD is right, else 0", label="SCA-ADD", by_contact=True, needs_truth=True,
    ),
    Metric(
        "sca_add_sym", lambda it, contact: it.contact(contact).sca * it.errors_sym.success,
        heading="SCA-ADD\nsymmetric", label="SCA-ADD sym.", by_contact=True, needs_truth=True,
    ),
    *(_sca_iou_metric(least) for least in IOU_THRESHOLDS),
    Metric("sca_diagonal", lambda it, contact: it.contact(contact).diagonal, by_contact=True),
    Metric("contact_share", lambda it, contact: it.contact(contact).share, by_contact=True, averaged=False),
    Metric(
        "truth_sca_diagonal", lambda it, contact: it.true_contact(contact).diagonal, by_contact=True, needs_truth=True,
    ),
    Metric(
        "truth_contact_share", lambda it, contact: it.true_contact(contact).share, by_contact=True, needs_truth=True,
        averaged=False,
    ),
    Metric(
        "cdev_mm",
        lambda it, _: 1e3 * motion.contact_deviation(it.contact_pairs, it.hand_in_camera[0], it.object_in_camera[0]),
        "mm", label="CDev, mm", group="motion", needs_truth=True, ranked=False,
    ),
    Metric(
        "mdev_mm", lambda it, _: 1e3 * _motion_deviation(it), "mm", label="MDev, mm", group="motion", needs_truth=True,
        ranked=False,
    ),
    Metric(
        "acc_hand", lambda it, _: _nan_mean_or_missing(motion.acceleration_error(*it.hand_in_camera, it.clip.time)),
        "m/s^2", label="ACC of the hand, m/s²", group="motion", needs_truth=True, ranked=False,
    ),
    Metric(
        "acc_object", lambda it, _: _nan_mean_or_missing(motion.acceleration_error(*it.object_in_camera, it.clip.time)),
        "m/s^2", label="ACC of the object, m/s²", group="motion", needs_truth=True, ranked=False,
    ),
    Metric(
        "mrrpe_mm",
        lambda it, _: 1e3 * motion.root_error(*zip(it.hand_in_camera, it.object_in_camera, strict=True)),
        "mm", label="MRRPE, mm", group="motion", needs_truth=True, ranked=False,
    ),
    Metric(
        "vertex_success_5", lambda it, _: motion.vertex_success(
            *it.object_in_camera, it.clip.mesh.diameter * it.true.scale
        ), label="within 5 %", group="motion", needs_truth=True,
    ),
    Metric(
        "add_cam_auc", lambda it, _: pose.area_under_curve(it.errors_cam.add), label="ADD AUC", group="recall",
        needs_truth=True,
    ),
    Metric(
        "adds_cam_auc", lambda it, _: pose.area_under_curve(pose.nearest_add(*it.object_in_camera)),
        label="ADD-S AUC", group="recall", needs_truth=True,
    ),
    REPLAY_STABILITY,
    _bop_metric("ar_cam", lambda it, _: np.mean([it.mssd_recall, it.mspd_recall, it.vsd_recall], axis=0), label="AR"),
    _bop_metric(
        "ar_of_two_cam", lambda it, _: np.mean([it.mssd_recall, it.mspd_recall], axis=0), label="AR without VSD",
    ),
    _bop_metric("mssd_cam_recall", lambda it, _: it.mssd_recall, label="MSSD"),
    _bop_metric("mspd_cam_recall", lambda it, _: it.mspd_recall, label="MSPD"),
    _bop_metric("vsd_cam_recall", lambda it, _: it.vsd_recall, label="VSD"),
    Metric("frames_without_mesh", lambda it, _: float(sum(mesh is None for mesh in it.meshes)), "frames"),
    Metric("closed", lambda it, _: _closed_mesh_fraction(it)),
)  # fmt: skip
METRICS = PluginTable(
    "metrics", {metric.name: metric for metric in _METRICS}, "a Metric of the same name",
    lambda name, it: isinstance(it, Metric) and it.name == name,
)  # fmt: skip
"""All metrics by name, in the order of tables."""


def compute_metrics(
    it: Comparison, wanted: Sequence[Metric] | None = None, on_metric: Callable[[str, float], None] | None = None
) -> tuple[dict[str, float], dict[str, list[float]]]:
    """Compute the known ones of the wanted metrics, or of all: the clip's numbers, and those per frame.

    A metric of a plug-in that raises is left out, with a warning. ``on_metric`` is called before each metric with its
    name and the fraction of metrics done.
    """
    metrics: dict[str, float] = {}
    per_frame: dict[str, list[float]] = {}
    wanted = tuple(METRICS.working().values()) if wanted is None else wanted
    for done, metric in enumerate(wanted):
        if on_metric:
            on_metric(metric.name, done / len(wanted))
        for contact in it.contacts if metric.by_contact else it.contacts[:1]:
            try:
                with plugins.convert_base_exceptions():
                    value = metric.of(it, contact)
            except MissingPartError:
                continue
            except Exception as error:
                if (plugin := plugins.plugin_of(metric)) is None:
                    raise
                plugins.warn_once(f"left out: {plugin} failed: {type(error).__name__}: {error}")
                continue
            key = metric.key(contact)
            if isinstance(value, ndarray):
                per_frame[key] = value.tolist()
                if not metric.averaged:
                    continue
                value = nan_mean(value)
            metrics[key] = float(value)
    return metrics, per_frame
