"""The part of a result about one segment of a timeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.finding import read_checks
from getagrip.geometry import se3
from getagrip.io.array_data import ArrayData
from getagrip.io.files import shorten_value
from getagrip.probability import Probability, read_probability

MAX_RESULT_DISTANCE_M = 1e4
"""No object is farther than this from its hand, and no hand from the camera [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SegmentResult(ArrayData):
    """One segment of a timeline.

    Attributes:
        state: what the object does: ``static``, ``contact``, ``grasp`` or ``free``.
        first: name of its first frame.
        last: name of its last frame.
        side: the hand that holds or touches the object; None where none does.
        iou: mean IOU of its frames whose mask shows the object; None where there is none.
        by_masks: True for a grasp that was tracked by its masks only, without an axis.
        T_world_obj: (4, 4) for a static segment, the object's pose in the world frame [m].
        axis_point: (3,) a point on the latent axis of a grasp, in the hand frame [m].
        axis_direction: (3,) the axis' direction in the hand frame, of length 1.
        signs: the measures from which the probability of a grasp is computed, by name (``checks.signs``).
        checks: the value that each check measured, by name; NaN if it could not be measured.
        probability_right: probability that a grasp is right relative to the hand; None if unknown.
    """

    state: str
    first: str
    last: str
    side: str | None = None
    iou: float | None = None
    by_masks: bool = False
    T_world_obj: Float[ndarray, "4 4"] | None = None
    axis_point: Float[ndarray, "3"] | None = None
    axis_direction: Float[ndarray, "3"] | None = None
    signs: dict[str, float] = field(default_factory=dict)
    checks: dict[str, float] = field(default_factory=dict)
    probability_right: Probability | None = None

    def fields(self) -> dict[str, object]:
        """Return the fields as ``result.json`` holds them."""
        known: dict[str, object] = {
            "side": self.side,
            "T_world_obj": self.T_world_obj,
            "followed": self.by_masks or None,
        }
        known |= {"axis_point": self.axis_point, "axis_direction": self.axis_direction}
        out: dict[str, object] = {"state": self.state, "first": self.first, "last": self.last, "iou": self.iou}
        out |= {key: value for key, value in known.items() if value is not None}
        if self.state == "grasp":
            out |= {"signs": self.signs, "probability_right": self.probability_right}
        return out | {"checks": self.checks}


def describe_grasp_probabilities(segments: Sequence[SegmentResult]) -> str:
    """Say how probable it is that each grasp of a timeline is right; empty where there is no grasp."""
    each = [str(segment.probability_right or "unknown") for segment in segments if segment.state == "grasp"]
    return f"probability that its grasps are right: {', '.join(each)}" if each else ""


def read_segments(path: Path, value: list[object]) -> tuple[SegmentResult, ...]:
    """Read the segments in a ``result.json``. Raises ``InputError``."""
    return tuple(_read_segment_result(path, f"segments[{n}]", segment) for n, segment in enumerate(value))


def _read_segment_result(path: Path, key: str, value: object) -> SegmentResult:
    if not isinstance(value, dict) or not all(isinstance(value.get(k), str) for k in ("state", "first", "last")):
        raise InputError(path, key, shorten_value(value), "a JSON object with state, first and last")
    if value.get("side") not in (None, "left", "right"):
        raise InputError(path, f"{key}.side", shorten_value(value["side"]), "left or right")
    iou = read_checks(path, {"iou": value.get("iou")}, key)["iou"]
    return SegmentResult(
        state=value["state"],
        first=value["first"],
        last=value["last"],
        side=value.get("side"),
        iou=None if np.isnan(iou) else iou,
        by_masks=value.get("followed") is True,
        T_world_obj=_read_segment_pose(path, f"{key}.T_world_obj", value["T_world_obj"])
        if "T_world_obj" in value
        else None,
        axis_point=_read_vector(path, f"{key}.axis_point", value.get("axis_point")),
        axis_direction=_read_vector(path, f"{key}.axis_direction", value.get("axis_direction")),
        signs=_read_segment_numbers(path, f"{key}.signs", value.get("signs")),
        checks=_read_segment_numbers(path, f"{key}.checks", value.get("checks")),
        probability_right=read_probability(path, value.get("probability_right"), f"{key}.probability_right"),
    )


def _read_segment_numbers(path: Path, key: str, value: object) -> dict[str, float]:
    """Read numbers by name; none where the entry is missing."""
    if value is not None and not isinstance(value, dict):
        raise InputError(path, key, shorten_value(value), "a JSON object")
    return read_checks(path, value or {}, key)


def _parse_segment_floats(value: object) -> list[float]:
    """Return the numbers in a list; none where it is no list."""
    values = value if isinstance(value, list) else []
    return [
        float(x)
        for x in values
        if isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= MAX_RESULT_DISTANCE_M
    ]


def _read_vector(path: Path, key: str, value: object) -> Float[ndarray, "3"] | None:
    """Three numbers; None for null."""
    numbers = _parse_segment_floats(value)
    if value is not None and (len(numbers) != 3 or numbers != value):
        raise InputError(path, key, shorten_value(value), f"3 numbers, at most {MAX_RESULT_DISTANCE_M:g} [m]")
    return None if value is None else np.array(numbers)


def _read_segment_pose(path: Path, key: str, value: object) -> Float[ndarray, "4 4"]:
    """Four rows of four numbers: a rigid motion that takes nothing too far."""
    expected = "4 rows of 4 numbers: a rotation and a translation [m]"
    rows = [_parse_segment_floats(row) for row in value] if isinstance(value, list) else []
    if [len(row) for row in rows] != [4] * 4:
        raise InputError(path, key, shorten_value(value), expected)
    if not se3.is_rigid(np.array(rows)).all():
        raise InputError(path, key, "a matrix that is no rigid motion", expected)
    return np.array(rows)
