"""Stable grasps: intervals in which a hand touches an object at constant places (paper, Eq. 2).

A stable grasp is an interval of frames in which every pair of frames i, j has IOU(S_i, S_j) > tau, S_i the object's
points in contact with the hand in frame i. A sequence's grasps are found greedily: the longest interval, then the
longest one that does not overlap it, and so on.

Every part of a stable interval is stable. Hence the earliest start of the stable intervals that end in a frame never
decreases from frame to frame, and testing each frame back to the previous frame's start tests all pairs.

The object's points are a choice (``Points``):

- ``vertices``: its vertices, as in the paper;
- ``area``: points sampled evenly over its surface, as in the metric of this name: fractions of points are fractions of
  the area, whatever the triangulation;
- ``fragments``: patches of vertices, in contact where any of their vertices is, as in the authors' ARCTIC grasps.

``CutRules`` cut sequences by this definition, or by a list, for ``import``, ``segment`` and ``study``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io.options import check_word
from getagrip.metrics.contact import N_AREA_SAMPLES, close_holes, moving_distance
from getagrip.metrics.symmetry import points_at_samples, surface_samples
from getagrip.stable_grasps.definition import GRASP_RULES, MIN_GRASP_FRAMES, Definition, Points, Rule
from getagrip.stable_grasps.grasp_lists import GraspList, ListedGrasp

IOU_BLOCK_FRAMES = 128
"""Number of frames whose contact or IOU is computed at once."""
FRAGMENT_VERTEX_FRACTION = 0.01
"""Number of an object's fragments, as a fraction of its number of vertices."""
ARTICULATION_THRESHOLD_RAD = np.radians(5.0)
"""Rotation of an object's joint above which the object is being opened or closed [rad]."""
FIRST_FRAME_KEY = "first_frame"
"""Key of a clip's provenance: the number in the name of the sequence's first frame, from which lists count."""


def segment(
    clip: Clip, definition: Definition | None = None, progress: Callable[[float], None] = lambda _: None
) -> tuple[PairwiseIou, list[tuple[int, int]]]:
    """Find the stable grasps of a clip with ground truth: first and last frame; also return its frames' contact IOU.

    Frames between which an object's joint rotates by more than ``ARTICULATION_THRESHOLD_RAD`` have IOU 0: opening or
    closing ends a grasp. ``progress`` is called with the fraction of frames done. Raises ``InputError`` for a clip
    without ground truth.
    """
    wanted = definition or Definition()
    contact = contact_sets(clip, wanted.contact, wanted.points, progress)
    iou = PairwiseIou.of(contact, articulation=None if clip.truth is None else clip.truth.articulation)
    return iou, stable_grasps(iou, wanted.tau, wanted.shortest, wanted.rule)


def contact_sets(
    clip: Clip, threshold: float = 0.0, points: Points = "vertices", progress: Callable[[float], None] = lambda _: None
) -> Bool[ndarray, "T P"]:
    """Find the object's points in contact with the true hand in each frame: signed distance up to ``threshold`` [m].

    Objects with a joint have its true angle (``Truth.joint``). Holes of the hand (MANO's wrist) are closed. Raises
    ``InputError`` for a clip without ground truth, ``UsageError`` for unknown ``points``.
    """
    check_word("points", points, Points)
    truth = clip.truth
    if truth is None:
        raise InputError(clip.origin / "truth.npz", "", "no such file", "the true poses, from which grasps are found")
    mesh = clip.mesh
    on_faces = surface_samples(mesh, N_AREA_SAMPLES) if points == "area" else None
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    hands, faces = close_holes(truth.hand_vertices, clip.hand.faces)
    contact = np.zeros((len(clip), N_AREA_SAMPLES if on_faces else len(mesh.vertices)), dtype=bool)
    for rows in _blocks(len(clip)):
        local = truth.object_vertices(mesh.vertices, rows)
        if on_faces:
            local = np.stack([points_at_samples(Mesh(vertices, mesh.faces), *on_faces) for vertices in local])
        in_hand = se3.transform(T_hand_obj[rows], local)
        contact[rows] = moving_distance(in_hand, hands[rows], faces, threshold) <= threshold
        progress(rows.stop / len(clip))
    if points == "fragments":
        patch = assign_fragments(mesh.vertices)
        return np.stack([contact[:, patch == k].any(axis=1) for k in range(patch.max() + 1)], axis=1)
    return contact


def assign_fragments(vertices: Float[ndarray, "V 3"]) -> Int[ndarray, "V"]:
    """Assign each vertex to a fragment: that of the nearest of some vertices spread over the object.

    These are chosen one by one, farthest from all before and from the mean (Hodan et al., "EPOS", CVPR 2020).
    """
    nearest = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)
    distances = []
    for _ in range(max(1, int(FRAGMENT_VERTEX_FRACTION * len(vertices)))):
        distances.append(np.linalg.norm(vertices - vertices[np.argmax(nearest)], axis=1))
        nearest = np.minimum(nearest, distances[-1])
    return np.argmin(distances, axis=0)


@dataclass(frozen=True)
class PairwiseIou:
    """Contact IOU of pairs of frames, computed on access: ``iou[rows, columns]`` with two slices.

    Sums of counts, and of weights rounded as in ``of``, are exact in any order: a pair's IOU is equal in all slices.

    Attributes:
        sets: (T, Q) 1 where a point is in contact; points that never touch are left out.
        weighted: (T, Q) the sets times the points' weights.
        size: (T,) weight of each frame's set.
        articulation: (T,) angle of the object's joint [rad]; frames that differ by more than
            ``ARTICULATION_THRESHOLD_RAD`` have IOU 0.
    """

    sets: Float[ndarray, "T Q"]
    weighted: Float[ndarray, "T Q"]
    size: Float[ndarray, "T"]
    articulation: Float[ndarray, "T"]

    @staticmethod
    def of(
        contact: Bool[ndarray, "T P"],
        weights: Float[ndarray, "P"] | None = None,
        articulation: Float[ndarray, "T"] | None = None,
    ) -> PairwiseIou:
        """Convert contact sets (frame, point) to pairs; the points' ``weights`` are not negative (default: equal)."""
        angle = np.zeros(len(contact)) if articulation is None else articulation
        touched = contact.any(axis=0)
        if weights is None:
            sets = contact[:, touched].astype(np.float32)
            return PairwiseIou(sets, sets, sets.sum(axis=1, dtype=float), angle)
        total = weights.sum()
        whole = np.round(weights * (2.0**50 / total)) if total > 0.0 else weights
        sets = contact[:, touched].astype(float)
        weighted = sets * whole[touched]
        return PairwiseIou(sets, weighted, weighted.sum(axis=1), angle)

    def __len__(self) -> int:
        return len(self.sets)

    def __getitem__(self, at: tuple[slice, slice]) -> Float[ndarray, "R C"]:
        rows, columns = at
        both = (self.weighted[rows] @ self.sets[columns].T).astype(float)
        either = self.size[rows, None] + self.size[None, columns] - both
        alike = np.abs(self.articulation[rows, None] - self.articulation[None, columns]) <= ARTICULATION_THRESHOLD_RAD
        return np.divide(both, either, out=np.zeros_like(both), where=alike & (either > 0))


def contact_iou(contact: Bool[ndarray, "T P"], weights: Float[ndarray, "P"] | None = None) -> Float[ndarray, "T T"]:
    """Compute the contact IOU of every pair of frames; 0 for empty sets, also of an empty set with itself.

    The points' ``weights``, such as areas, are not negative. For thousands of frames ``PairwiseIou`` saves memory.
    """
    return PairwiseIou.of(contact, weights)[:, :]


def stable_grasps(
    iou: Float[ndarray, "T T"] | PairwiseIou, tau: float = 0.5, shortest: int = 20, rule: Rule = "all-pairs"
) -> list[tuple[int, int]]:
    """Find the stable grasps of at least ``shortest`` frames: first and last frame, both included, in order of start.

    - ``all-pairs``: Eq. 2. Of equally long intervals the earlier one is taken.
    - ``first``: every frame is compared with the interval's first frame only, and IOU = tau suffices, as in the code
      that found the authors' ARCTIC grasps. From each start there is one interval, of maximum length: if it overlaps a
      longer one it is dropped, not cut.
    - ``consecutive``: frames t with IOU(t-2, t-1) > tau and IOU(t-1, t) > tau, as in the authors' HOT3D timelines:
      an interval starts two frames after its first good pair, and contacts may drift without limit.
    - ``touch``: uninterrupted contact at any points.

    Raises ``UsageError`` for tau outside [0, 1), ``shortest`` below 1, and an unknown rule.
    """
    if not 0.0 <= tau < 1.0:
        raise UsageError(f"tau must be at least 0 and below 1 (got {tau:g})")
    if shortest < 1:
        raise UsageError(f"shortest must be 1 frame or more (got {shortest})")
    if rule == "all-pairs":
        return _longest_first(_earliest_starts(iou, tau), shortest)
    if rule == "first":
        return _longest_whole(_ends_by_first(iou, tau), shortest)
    if rule == "consecutive":
        return _runs(_resembling_frames(iou, tau), shortest)
    if rule == "touch":
        touched = [iou[rows, rows].diagonal() > 0.0 for rows in _blocks(len(iou))]
        return _runs(np.concatenate(touched or [np.zeros(0, dtype=bool)]), shortest)
    raise UsageError(f"unknown rule {rule!r}; choose from {', '.join(GRASP_RULES)}")


def _blocks(frames: int) -> Iterator[slice]:
    return (slice(begin, min(begin + IOU_BLOCK_FRAMES, frames)) for begin in range(0, frames, IOU_BLOCK_FRAMES))


def _earliest_starts(iou: Float[ndarray, "T T"] | PairwiseIou, tau: float) -> Int[ndarray, "T"]:
    """For each frame the earliest start of a stable interval that ends in it; without any, the next frame."""
    starts = np.zeros(len(iou), dtype=np.int64)
    earliest = 0
    for rows in _blocks(len(iou)):
        columns = np.arange(earliest, rows.stop)
        unlike = iou[rows, earliest : rows.stop] <= tau
        unlike &= columns <= np.arange(rows.start, rows.stop)[:, None]
        after_last = np.where(unlike, columns + 1, earliest).max(axis=1)
        starts[rows] = np.maximum.accumulate(after_last)
        earliest = int(starts[rows][-1])
    return starts


def _longest_first(starts: Int[ndarray, "T"], shortest: int) -> list[tuple[int, int]]:
    """Choose the longest interval, then recursively the longest before and after it."""
    taken = []
    free = [(0, len(starts) - 1)]
    while free:
        low, high = free.pop()
        ends = np.arange(low, high + 1)
        lengths = ends + 1 - np.maximum(starts[low : high + 1], low)
        if lengths.max(initial=0) < shortest:
            continue
        last = int(ends[np.argmax(lengths)])
        first = max(int(starts[last]), low)
        taken.append((first, last))
        free += [(low, first - 1), (last + 1, high)]
    return sorted(taken)


def _ends_by_first(iou: Float[ndarray, "T T"] | PairwiseIou, tau: float) -> Int[ndarray, "T"]:
    """For each frame the first frame, from itself on, whose IOU with it is below tau; T without any."""
    ends = np.full(len(iou), len(iou))
    for rows in _blocks(len(iou)):
        for columns in _blocks(len(iou)):
            if columns.stop <= rows.start:
                continue
            open_ = ends[rows] == len(iou)
            if not open_.any():
                break
            value = iou[rows, columns]
            unlike = (value < tau) | (value == 0.0)  # an empty set differs from itself, for any tau
            unlike &= np.arange(columns.start, columns.stop) >= np.arange(rows.start, rows.stop)[:, None]
            found = open_ & unlike.any(axis=1)
            ends[rows] = np.where(found, columns.start + unlike.argmax(axis=1), ends[rows])
    return ends


def _longest_whole(ends: Int[ndarray, "T"], shortest: int) -> list[tuple[int, int]]:
    """Choose intervals from each frame to before its end: the longest first, none overlapping a chosen one."""
    starts = np.arange(len(ends))
    lengths = ends - starts
    free = np.ones(len(ends), dtype=bool)
    taken = []
    for first in np.argsort(-lengths, kind="stable"):
        if lengths[first] < shortest:
            break
        if free[first] and free[ends[first] - 1]:  # chosen intervals are longer: none lies between
            free[first : ends[first]] = False
            taken.append((int(first), int(ends[first]) - 1))
    return sorted(taken)


def _resembling_frames(iou: Float[ndarray, "T T"] | PairwiseIou, tau: float) -> Bool[ndarray, "T"]:
    """Frames whose IOU with the previous frame, and its with the one before, exceed tau."""
    alike = np.zeros(len(iou), dtype=bool)
    for rows in _blocks(len(iou) - 1):
        alike[rows.start + 1 : rows.stop + 1] = iou[rows, rows.start + 1 : rows.stop + 1].diagonal() > tau
    steady = np.zeros_like(alike)
    steady[2:] = alike[1:-1] & alike[2:]
    return steady


def _runs(wanted: Bool[ndarray, "T"], shortest: int) -> list[tuple[int, int]]:
    """First and last frame of each run of wanted frames, of at least ``shortest``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]])))
    return [(int(first), int(last) - 1) for first, last in edges.reshape(-1, 2) if last - first >= shortest]


@dataclass(frozen=True)
class CutRules:
    """Rules for cutting sequences into stable grasps."""

    definition: Definition = field(default_factory=Definition)
    """Definition of a stable grasp; with a list, only its definition of contact counts."""
    listed: GraspList | None = None
    """List of the grasps; None: they are found by the definition."""

    @property
    def shortest(self) -> int:
        """Minimum number of frames of a grasp."""
        return self.definition.shortest if self.listed is None else MIN_GRASP_FRAMES

    @property
    def description(self) -> str:
        """The rules in words."""
        return self.definition.description if self.listed is None else f"the grasps of {self.listed.file}"

    def record(self) -> dict[str, object]:
        """Return the identity of the rules as JSON values; for a list, with the definition of contact in its grasps."""
        if self.listed is None:
            return asdict(self.definition)
        contact: dict[str, object] = {"contact": self.definition.contact, "points": self.definition.points}
        return {"list": self.listed.file, "sha256": self.listed.sha256} | contact

    def of(
        self, clip: Clip, progress: Callable[[float], None] = lambda _: None
    ) -> tuple[PairwiseIou, list[tuple[int, int]]]:
        """Return the contact IOU of a clip's frames, and its grasps: first and last frame, both included.

        Raises ``InputError`` for a clip without ground truth.
        """
        iou, found = segment(clip, self.definition, progress)
        if self.listed is not None:
            origin = clip.provenance.get(FIRST_FRAME_KEY)
            origin = origin if type(origin) is int else None
            grasps = self.listed.of(clip.name, clip.side, clip.category)
            spans = [grasp.positions(clip.frames, origin) for grasp in grasps]
            found = sorted({(int(span[0]), int(span[-1])) for span in spans if len(span) >= MIN_GRASP_FRAMES})
        return iou, found


def as_listed(clip: Clip, first: int, last: int) -> ListedGrasp:
    """Return frames ``first`` to ``last`` of a clip as a listed grasp."""
    duration = (last + 1 - first) / clip.fps
    return ListedGrasp(clip.name, clip.side, clip.category, clip.frames[first], clip.frames[last], duration)
