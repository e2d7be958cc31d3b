"""A reconstruction: the object in the hand in every frame, and the segments of a timeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self, get_args

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.errors import InputError, UsageError, check_arguments
from getagrip.geometry import se3
from getagrip.geometry.warp import Warp
from getagrip.io.array_data import ArrayData, view
from getagrip.io.files import shorten_value
from getagrip.result.findings import (
    RIGHT_PROBABILITY,
    WRONG_PROBABILITY,
    Finding,
    Probability,
    Verdict,
    describe_looks,
    read_checks,
    read_probability,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from getagrip.clip import Clip, Masks
    from getagrip.report.notebook import HtmlPage

MAX_RESULT_DISTANCE_M = 1e4
"""Maximum distance of an object from its hand, and of a hand from the camera [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SegmentResult(ArrayData):
    """One segment of a timeline.

    Attributes:
        state: the object's state: ``static``, ``contact``, ``grasp`` or ``free``.
        first: name of the first frame.
        last: name of the last frame.
        side: the hand that grasps or touches the object; None without one.
        iou: mean IOU of the frames with a mask of the object; None without any.
        by_masks: True for a grasp that was tracked by its masks only, without an axis.
        T_world_obj: (4, 4) for a static segment, the object's pose in the world frame [m].
        axis_point: (3,) a point on the latent axis of a grasp, in the hand frame [m].
        axis_direction: (3,) the axis' direction in the hand frame, of length 1.
        signs: the measures from which the probability of a grasp is computed, by name (``checks.features``).
        checks: the measured value of each check, by name; NaN if unknown.
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
        """Return the segment's entry in ``result.json``."""
        known: dict[str, object] = {
            "side": self.side, "T_world_obj": self.T_world_obj, "followed": self.by_masks or None,
            "axis_point": self.axis_point, "axis_direction": self.axis_direction,
        }  # fmt: skip
        out: dict[str, object] = {"state": self.state, "first": self.first, "last": self.last, "iou": self.iou}
        out |= {key: value for key, value in known.items() if value is not None}
        if self.state == "grasp":
            out |= {"signs": self.signs, "probability_right": self.probability_right}
        return out | {"checks": self.checks}


def describe_grasp_probabilities(segments: Sequence[SegmentResult]) -> str:
    """List the probabilities of a timeline's grasps in words; empty without a grasp."""
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
        T_world_obj=None if "T_world_obj" not in value else _read_segment_pose(path, key, value["T_world_obj"]),
        axis_point=_read_vector(path, f"{key}.axis_point", value.get("axis_point")),
        axis_direction=_read_vector(path, f"{key}.axis_direction", value.get("axis_direction")),
        signs=_read_segment_numbers(path, f"{key}.signs", value.get("signs")),
        checks=_read_segment_numbers(path, f"{key}.checks", value.get("checks")),
        probability_right=read_probability(path, value.get("probability_right"), f"{key}.probability_right"),
    )


def _read_segment_numbers(path: Path, key: str, value: object) -> dict[str, float]:
    """Read numbers by name; empty for a missing entry."""
    if value is not None and not isinstance(value, dict):
        raise InputError(path, key, shorten_value(value), "a JSON object")
    return read_checks(path, value or {}, key)


def _parse_segment_floats(value: object) -> list[float]:
    """Return the plausible numbers in a list; empty for other values."""
    values = value if isinstance(value, list) else []
    numbers = [x for x in values if isinstance(x, int | float) and not isinstance(x, bool)]
    return [float(x) for x in numbers if abs(x) <= MAX_RESULT_DISTANCE_M]


def _read_vector(path: Path, key: str, value: object) -> Float[ndarray, "3"] | None:
    """Read three numbers; None for null."""
    numbers = _parse_segment_floats(value)
    if value is not None and (len(numbers) != 3 or numbers != value):
        raise InputError(path, key, shorten_value(value), f"3 numbers, at most {MAX_RESULT_DISTANCE_M:g} [m]")
    return None if value is None else np.array(numbers)


def _read_segment_pose(path: Path, key: str, value: object) -> Float[ndarray, "4 4"]:
    """Read the ``T_world_obj`` of a segment: a rigid motion of plausible numbers."""
    key = f"{key}.T_world_obj"
    expected = "4 rows of 4 numbers: a rotation and a translation [m]"
    rows = [_parse_segment_floats(row) for row in value] if isinstance(value, list) else []
    if [len(row) for row in rows] != [4] * 4:
        raise InputError(path, key, shorten_value(value), expected)
    if not se3.is_rigid(np.array(rows)).all():
        raise InputError(path, key, "a matrix that is no rigid motion", expected)
    return np.array(rows)


FrameKind = Literal["sampled", "fitted", "interpolated"]
"""Origin of a frame's pose: fitted together with the other sampled frames; fitted to its own mask, with the shared
parameters fixed; or interpolated between its neighbours."""


@dataclass(frozen=True, eq=False)
class Axis(ArrayData):
    """The latent axis of a 1-DoF motion, fixed in the hand frame (Eq. 3).

    Attributes:
        point: (3,) a point on the axis, in the hand frame [m].
        direction: (3,) the axis' direction in the hand frame, of length 1.
        angle: (T,) the object's angle about the axis in each frame, by the right-hand rule [rad].
    """

    point: Float[ndarray, "3"]
    direction: Float[ndarray, "3"]
    angle: Float[ndarray, "T"]


@dataclass(frozen=True, eq=False)
class Candidates(ArrayData):
    """The best distinct solutions, lowest energy first; the first is the result.

    Attributes:
        T_hand_obj: (K, T, 4, 4) poses, object frame to hand frame [m].
        scale: (K,) factors by which the mesh is scaled before it is posed.
        energy: (K,) energies [pixels squared of the 256-pixel crop].
    """

    T_hand_obj: Float[ndarray, "K T 4 4"]
    scale: Float[ndarray, "K"]
    energy: Float[ndarray, "K"]


@dataclass(frozen=True, eq=False)
class Reconstruction(ArrayData):
    """The result of a method for one clip: ``X_cam = T_cam_hand @ T_hand_obj @ (scale * X_obj)``.

    Attributes:
        clip: name of the clip.
        method: name of the method.
        frames: names of the T frames, in the clip's order.
        T_hand_obj: (T, 4, 4) pose of the object in each frame, object frame to hand frame [m].
        scale: factor by which the mesh is scaled before it is posed; 1 if the clip's scale is known.
        iou: (T,) intersection over union of rendered and observed mask on the full image, outside ignored pixels;
            NaN in frames without the object in their mask.
        axis: the object's latent axis of rotation in the hand; None for methods without one.
        candidates: the best distinct solutions.
        energy: ``total`` and one entry per term, weighted [pixels squared of the 256-pixel crop].
        status: how the fit ended.
        ambiguous: True if another, distinct candidate explains the masks almost as well.
        seconds: time spent [s], ``total`` and one entry per stage.
        message: the status as a sentence, with details of this result.
        options: the options of the method.
        seed: seed of the initial poses.
        notes: left-out frames and assumed values, as sentences.
        assumptions: the source of each assumed input (scale, shape, or a topic of the clip's provenance).
        findings: findings of the checks, first about the inputs, then about the result.
        checks: the measured value of each check, by name; NaN if unknown.
        signs: the measures from which the probabilities are computed, by name (``checks.features``).
        probability_right: probability that the poses are right relative to the hand (ADD, up to symmetries, below 10 %
            of the diameter); None if it is not calibrated for this kind of fit.
        probability_right_in_camera: probability that the poses are right relative to the camera.
        probability_looks_right: probability that they are right but for distance and size; of drafts only.
        distance_interval_mm: interval that contains the distance from the camera to the object's centre, median over
            frames, with 90 % [mm] (``fitting.stages.distance``); None if unknown.
        T_cam_hand: (T, 4, 4) pose of the hand, possibly repaired and refined, hand frame to camera frame [m];
            ``T_hand_obj`` and the axis are relative to it. None: the clip's pose, for external poses and for results of
            older versions.
        hand_scale: factor on the size of the clip's hand, about the origin of its frame; 1 except for a hand lifted
            from 2D points whose size follows from a sensor's depth or from the object's size.
        hand_covariance: (6, 6) covariance of the error shared by all frames of ``T_cam_hand``, in the hand frame: shift
            of the hand's centre [m], rotation about it [rad]; None if hand and object were not solved together.
        hand_alternatives: (M, 4, 4) alternative poses of the hand, in the hand frame, in pairs along its most uncertain
            directions; None if ``hand_covariance`` is None.
        hand_energy: energy of each kind of evidence on the hand, before and after it was solved with the object
            [pixels squared of the 256-pixel crop].
        T_cam_other_hand: (T, 4, 4) for a timeline, pose of the other hand, refined in its grasps; None if the clip has
            no such hand.
        warp: fitted deformation of the clip's mesh, before it is scaled and posed; None if the mesh is unchanged.
        frame_kind: kind of each frame's pose; by default, all frames were sampled.
        segments: the result for each segment of a timeline; empty for a stable grasp.
    """

    clip: str
    method: str
    frames: tuple[str, ...]
    T_hand_obj: Float[ndarray, "T 4 4"]
    scale: float
    iou: Float[ndarray, "T"]
    axis: Axis | None
    candidates: Candidates
    energy: dict[str, float]
    status: Status
    ambiguous: bool
    seconds: dict[str, float]
    message: str = ""
    options: dict[str, object] = field(default_factory=dict)
    seed: int = 0
    notes: tuple[str, ...] = ()
    assumptions: dict[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    checks: dict[str, float] = field(default_factory=dict)
    signs: dict[str, float] = field(default_factory=dict)
    probability_right: Probability | None = None
    probability_right_in_camera: Probability | None = None
    probability_looks_right: Probability | None = None
    distance_interval_mm: tuple[float, float] | None = None
    T_cam_hand: Float[ndarray, "T 4 4"] | None = None
    hand_scale: float = 1.0
    hand_covariance: Float[ndarray, "6 6"] | None = None
    hand_alternatives: Float[ndarray, "M 4 4"] | None = None
    hand_energy: dict[str, tuple[float, float]] = field(default_factory=dict)
    T_cam_other_hand: Float[ndarray, "T 4 4"] | None = None
    warp: Warp | None = None
    frame_kind: tuple[FrameKind, ...] = ()
    segments: tuple[SegmentResult, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.message:
            object.__setattr__(self, "message", self.status.sentence)
        if len(self.frames) != len(self.T_hand_obj):
            frames = f"{len(self.T_hand_obj)} names, as many as T_hand_obj"
            raise UsageError(f"Reconstruction.frames must be {frames} (got {len(self.frames)})")
        if not self.frame_kind:
            object.__setattr__(self, "frame_kind", ("sampled",) * len(self.frames))
        if len(self.frame_kind) != len(self.frames) or not {*self.frame_kind} <= {*get_args(FrameKind)}:
            expected = f"one of {', '.join(get_args(FrameKind))} for each frame"
            raise UsageError(f"Reconstruction.frame_kind must be {expected} (got {self.frame_kind})")

    @staticmethod
    def external(
        clip: str, method: str, frames: tuple[str, ...], T_hand_obj: Float[ndarray, "T 4 4"], scale: float = 1.0
    ) -> Reconstruction:
        """Make a result of external poses: another system's, or the ground truth."""
        return Reconstruction(
            clip, method, frames, T_hand_obj, scale, iou=np.full(len(frames), np.nan), axis=None,
            candidates=Candidates(T_hand_obj[None], np.array([scale]), np.zeros(1)), energy={}, status=Status.EXTERNAL,
            ambiguous=False, seconds={},
        )  # fmt: skip

    def made_of(self, clip: Clip, masks: Masks | None) -> Self:
        """Keep the inputs in this result, for ``plot`` and ``show``, and return it; copies and files lack them."""
        self.__dict__["_inputs"] = clip, masks
        return self

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "_inputs"}

    @property
    def inputs(self) -> tuple[Clip, Masks | None] | None:
        """The clip and masks that ``reconstruct`` used; None for a result that was read, or changed since."""
        return self.__dict__.get("_inputs")

    @check_arguments
    def plot(self, clip: Clip | None = None, masks: Masks | None = None) -> Figure:
        """Draw the result: silhouettes, the axis in two views, angle and IOU over time; a notebook shows the figure.

        By default with the clip and the masks used by ``reconstruct``. Raises ``UsageError`` for a result read from a
        folder without the ``clip`` argument.
        """
        return view("plot_result")(self, clip, masks)

    @check_arguments
    def show(self, clip: Clip | None = None, masks: Masks | None = None, height: int = 820) -> HtmlPage:
        """Make the result's page with a 3D animation; a notebook shows it, ``height`` pixels high.

        Arguments and errors are those of ``plot``.
        """
        return view("make_result_page")(self, clip, masks, height)

    @property
    def probabilities(self) -> dict[str, Probability]:
        """The known probabilities that the poses are right, by reference frame."""
        each = {"in the hand": self.probability_right, "in the camera": self.probability_right_in_camera}
        return {where: right for where, right in each.items() if right is not None}

    @property
    def looks(self) -> str:
        """Probable visual quality, for drafts and results with an assumed mesh; else, and without one, empty."""
        return describe_looks(self.probability_right, self.probability_looks_right)

    @property
    def verdict(self) -> Verdict:
        """The judgement in a word: wrong with a serious finding, uncertain where nothing vouches for it."""
        probability = self.probability_looks_right or self.probability_right
        if any(finding.serious for finding in self.findings) or "wrong" in self.looks:
            return "wrong"
        if probability is None:
            return "uncertain"
        if probability.by_eye:  # of an assumed mesh, whose probability is low even where it looks right
            return "right"
        if probability.value >= RIGHT_PROBABILITY:
            return "right"
        return "wrong" if probability.value <= WRONG_PROBABILITY else "uncertain"

    @property
    def in_hand(self) -> Float[ndarray, "n T 4 4"]:
        """Possible poses in the hand; the first ``probability_right.candidates`` contain the right ones with 90 %.

        If the hand was solved with the object, they are the result's, relative to the hand and to each of
        ``hand_alternatives``; else those of ``candidates``.
        """
        if self.hand_alternatives is None:
            return self.candidates.T_hand_obj
        here = np.concatenate([np.eye(4)[None], se3.inverse(self.hand_alternatives)])
        return np.asarray(here[:, None] @ self.T_hand_obj)

    @property
    def T_cam_obj(self) -> Float[ndarray, "T 4 4"]:
        """(T, 4, 4) pose of the object in each frame, object frame to camera frame [m].

        Raises ``UsageError`` if ``T_cam_hand`` is None.
        """
        if self.T_cam_hand is None:
            hand = "clip.hand.T_cam_hand[clip.index_of(result.frames)] @ result.T_hand_obj"
            raise UsageError(f"missing T_cam_hand: this result does not say where its hand is; compute {hand}")
        return np.asarray(self.T_cam_hand @ self.T_hand_obj)

    def frames_of(self, *kinds: FrameKind) -> Int[ndarray, "n"]:
        """Return the indices of the frames of some kinds."""
        return np.flatnonzero([kind in kinds for kind in self.frame_kind])

    def take(self, index: Int[ndarray, "n"]) -> Reconstruction:
        """Return the result at some frames, in the given order."""
        found = self.candidates
        return replace(
            self,
            frames=tuple(self.frames[n] for n in index),
            frame_kind=tuple(self.frame_kind[n] for n in index),
            T_hand_obj=self.T_hand_obj[index],
            iou=self.iou[index],
            axis=None if self.axis is None else replace(self.axis, angle=self.axis.angle[index]),
            candidates=replace(found, T_hand_obj=found.T_hand_obj[:, index]),
            T_cam_hand=None if self.T_cam_hand is None else self.T_cam_hand[index],
            T_cam_other_hand=None if self.T_cam_other_hand is None else self.T_cam_other_hand[index],
        )

    @property
    def mean_iou(self) -> float:
        """Mean of ``iou`` over the frames with a known one; NaN without any."""
        known = self.iou[~np.isnan(self.iou)]
        return float(known.mean()) if len(known) else float("nan")


class Status(Enum):
    """Status of a fit: a word for programs, and a sentence with advice for people."""

    CONVERGED = "converged", "converged: further steps gain less than 0.1 % of the energy"
    STUCK = "stuck", "converged: no step lowers the energy any more"
    LIMIT = (
        "iteration-limit",
        "stopped at the iteration limit while the energy was still falling a little; --thorough goes on longer",
    )
    FINISHED = "finished", "stopped: all iterations of the fixed number were made"
    JOINT = "joint", "all segments were fitted together"
    EXTERNAL = "given", "another system's poses, or the ground truth"
    PARTLY_FAILED = "partly-failed", "partly failed: low mask IOU in some segments"
    MISFIT = "misfit", "failed: even the best pose has a low mask IOU; the object's pose is unknown"
    INVISIBLE = "invisible", "failed: the object is behind the camera or too near to it in every hypothesis tried"

    sentence: str

    def __new__(cls, word: str, sentence: str = "") -> Self:
        """Make a member from its word; each member has its own sentence."""
        member = object.__new__(cls)
        member._value_, member.sentence = word, sentence
        return member

    @property
    def failed(self) -> bool:
        """True if the result, or a part of it, is unusable."""
        return self in (Status.PARTLY_FAILED, Status.MISFIT, Status.INVISIBLE)

    @staticmethod
    def of_sentence(sentence: str) -> Status:
        """Return the status of a result of version 1 by its sentence; ``given`` for external poses."""
        known = next((status for status in Status if status.sentence == sentence), None)
        if known is not None:
            return known
        if sentence == "stopped: no step lowers the energy any more":
            return Status.STUCK
        if sentence.startswith(("failed in part", "partly failed")):
            return Status.PARTLY_FAILED
        return Status.MISFIT if sentence.startswith("failed") else Status.EXTERNAL
