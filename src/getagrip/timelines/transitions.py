"""The object between two segments: followed from both of them, and fitted to each frame's mask.

The motions from the one, from the other and a blend of both are fitted; that of the least energy is taken. A blend of
two that disagree, as where a box was turned over unseen, is no motion.

An object's motion over a timeline, as it is filled in.

A grasp's object as far away as its masks say, and the hand with it.

One image hardly tells how far away a hand is: from frame to frame its depth errs by a centimetre, and so does an object
that goes with it. The size of the object's masks, and a motion that does not jump, know better. The hand goes along the
camera's ray as far as the object does, so that contact stays.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Segment
from getagrip.clip.timeline import Side
from getagrip.fitting.energy.homan_terms import SmoothnessTerm, TermInFrame, vertex_moments
from getagrip.fitting.motion import Fixed, Free, Frozen, Soft
from getagrip.fitting.objective import object_evidence_energy
from getagrip.fitting.problem import Problem
from getagrip.fitting.solver.solve import minimise, poses_in_camera
from getagrip.fitting.stages.mesh_deformation import relative_contour_error, stiffen_ridge
from getagrip.geometry import se3
from getagrip.result import FrameKind
from getagrip.timelines.observations import Hypotheses, TimelineInputs
from getagrip.timelines.segments import GraspTrack
from getagrip.timelines.tracking import track_hypotheses


@dataclass
class TimelineMotion:
    """An object's motion over a clip, as it is filled in; frames that are not yet known are NaN.

    Attributes:
        side: of the clip's own hand.
        centre: (3,) of the mesh, in its own frame.
        T_world_cam: (T, 4, 4) poses of the camera.
        shown: (T,) the frames whose masks show the object.
        T_cam_obj: (T, 4, 4) poses of the mesh's own frame in the camera frame.
        T_cam_hands: (T, 4, 4) poses of each known hand, by its side, corrected in its grasps.
        kind: how each frame's pose was found.
        grasps: the grasps that were solved as such, by their segment's first frame.
    """

    side: Side
    centre: Float[ndarray, "3"]
    T_world_cam: Float[ndarray, "T 4 4"]
    shown: Bool[ndarray, "T"]
    T_cam_obj: Float[ndarray, "T 4 4"]
    T_cam_hands: dict[Side, Float[ndarray, "T 4 4"]]
    kind: list[FrameKind]
    grasps: dict[int, GraspTrack] = field(default_factory=dict)

    @staticmethod
    def of(clip: Clip, shown: Bool[ndarray, "T"]) -> TimelineMotion:
        """Make a motion of which nothing is known yet."""
        assert clip.world is not None
        T = len(clip)
        hands = {clip.side: clip.hand.T_cam_hand.copy()}
        if clip.other_hand is not None:
            hands[clip.other_side] = clip.other_hand.track.T_cam_hand.copy()
        unknown: list[FrameKind] = ["interpolated"] * T
        where = clip.side, clip.mesh.centre, clip.world.T_world_cam, shown
        return TimelineMotion(*where, np.full((T, 4, 4), np.nan), hands, unknown)

    @property
    def T_cam_hand(self) -> Float[ndarray, "T 4 4"]:
        """Poses of the clip's own hand."""
        return self.T_cam_hands[self.side]

    @property
    def T_cam_other_hand(self) -> Float[ndarray, "T 4 4"] | None:
        """Poses of the other hand; None where it is not known."""
        return next((T for side, T in self.T_cam_hands.items() if side != self.side), None)

    def put(self, rows: Int[ndarray, "n"], found: Hypotheses, kind: FrameKind) -> None:
        """Put the first hypothesis into some frames; of ``kind`` where the object is visible."""
        self.T_cam_obj[rows] = se3.inverse(self.T_world_cam[rows]) @ found.T_world_obj(self.centre)[0]
        for row in rows[self.shown[rows]]:
            self.kind[row] = kind

    def put_grasp(self, found: GraspTrack) -> None:
        """Put a grasp into its frames, with its hand."""
        grasp, track = found.solutions.grasp, found.track
        self.T_cam_obj[grasp.rows] = track.T_cam_hand @ track.T_hand_obj[0]
        self.T_cam_hands[grasp.clip.side][grasp.rows] = track.T_cam_hand
        for row, kind in zip(grasp.rows, track.kind, strict=True):
            self.kind[row] = kind
        self.grasps[grasp.segment.first] = found

    def places(self, rows: Int[ndarray, "n"]) -> Float[ndarray, "n 3"]:
        """Return the positions of the mesh's centre before the camera, in some frames [m]."""
        return np.asarray(se3.transform(self.T_cam_obj[rows], self.centre[None])[:, 0])

    def at(self, row: int) -> Hypotheses:
        """Return the pose of one frame, in the world."""
        return Hypotheses.of_pose(self.T_world_cam[row] @ self.T_cam_obj[row], self.centre)


def split_at_gaps(segment: Segment, rows: Int[ndarray, "n"]) -> list[Segment]:
    """Split a segment into the parts that have no gaps: some of its frames, which rise."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return [replace(segment, first=int(part[0]), last=int(part[-1])) for part in parts]


WORLD_SMOOTHNESS_WEIGHT = 2e5
"""Energy of a surface that moves from one frame to the next [px^2 / m^2]: 20 for a centimetre."""
GAP_FIT_STAGES = ((128, 6), (256, 4))
"""Resolution [px] and iterations."""


def world_smoothness_term(problem: Problem) -> TermInFrame:
    """Make the term by which the object's surface moves little in the world from each of the frames to the next."""
    mesh, world = problem.clip.mesh, problem.clip.world
    assert world is not None
    return TermInFrame(
        SmoothnessTerm(vertex_moments(mesh.vertices - mesh.centre), WORLD_SMOOTHNESS_WEIGHT), world.T_world_cam
    )


def fill_gaps(motion: TimelineMotion, footage: TimelineInputs, known: list[Segment]) -> None:
    """Fill the frames between segments that are known, and before and after them."""
    edges = [(None, known[0]), *itertools.pairwise(known), (known[-1], None)]
    for one, other in edges:
        rows = np.arange(0 if one is None else one.last + 1, len(footage) if other is None else other.first)
        if not len(rows):
            continue
        ahead = None if one is None else track_hypotheses(footage, one.last, rows, motion.at(one.last)).found
        behind = (
            None if other is None else track_hypotheses(footage, other.first, rows[::-1], motion.at(other.first)).found
        )
        behind = behind and behind.at(np.arange(len(rows))[::-1])
        found, shown = _candidate_motions(ahead, behind), footage.shown[rows]
        if shown.sum() > 1:
            found = _fit_smooth_motion(footage.problem(rows[shown]), np.flatnonzero(shown), found)
        else:
            found = found.take(np.array([-1]))
        motion.put(rows, found, "fitted")


def _candidate_motions(ahead: Hypotheses | None, behind: Hypotheses | None) -> Hypotheses:
    """Return the motions that are known; of two, the blend of the best as well."""
    if ahead is None or behind is None:
        start = ahead or behind
        assert start is not None
        return start
    best = np.zeros(1, int)
    return ahead.concatenate(behind).concatenate(_blend_motions(ahead.take(best), behind.take(best)))


def _blend_motions(ahead: Hypotheses, behind: Hypotheses) -> Hypotheses:
    """From the one to the other, evenly in time: rotations along the shortest path, centres on a line."""
    n = ahead.R.shape[1]
    share = (np.arange(n) + 1.0)[:, None] / (n + 1)
    turn = se3.log_so3(behind.R @ np.swapaxes(ahead.R, -1, -2))
    R = se3.exp_so3(share * turn) @ ahead.R
    return Hypotheses(R, ahead.centre + share * (behind.centre - ahead.centre), ahead.scale, ahead.energy)


def _fit_smooth_motion(problem: Problem, at: Int[ndarray, "m"], start: Hypotheses) -> Hypotheses:
    """Fit the best smooth motion near these that meets the masks; the problem is at the frames ``at`` of theirs."""
    world = problem.clip.world
    assert world is not None
    motion = Free(start.R[:, at], start.centre[:, at], np.log(start.scale))
    energy, smooth = object_evidence_energy(problem), world_smoothness_term(problem)
    everywhere, T_cam_world = np.arange(len(at)), se3.inverse(world.T_world_cam)
    for level, iterations in GAP_FIT_STAGES:
        found = minimise(motion, [*energy(level, everywhere), smooth], T_cam_world, iterations)
        motion = found.motion
    poses = motion.poses()
    R, centre = start.R.copy(), start.centre.copy()
    R[:, at], centre[:, at] = poses.R, poses.centre
    return Hypotheses(R, centre, start.scale, found.energy).take(np.array([np.argmin(found.energy)]))


REFERENCE_DEPTH_JITTER_M, MIN_DEPTH_JITTER_M = 0.01, 0.001
"""Jitter of depth at which deviations are as stiff as ``HINGE_DEVIATION_RIDGE`` says, and below which nothing moves [m]."""
MAX_MOTION_CHANGE_M = 0.01
"""Motion that changes by more between frames: they are too far apart to tell it from jitter [m]."""
HINGE_DEVIATION_RIDGE = (1e5, 1e4)
"""Stiffness of a frame's deviation from the hinge in the hand [px^2 per m^2, per rad^2]: what is hidden stays there.

It is more where the hand jitters less, by the square: such a hand is right about depth, which masks that are half
hidden may not tell. Where the masks are met worse than the object's own mesh would, it is stiffer (``relative_contour_error``).
"""
DEPTH_CORRECTION_STAGES = ((128, 6), (256, 4), (256, 4))
"""Resolution [px] and iterations; before the last, it is known how well masks are met."""


def correct_depth(motion: TimelineMotion, problem: Problem, seen: Int[ndarray, "n"], side: Side, jitter: float) -> None:
    """Move object and hand of ``side`` in the frames of a grasp that show the object, which the problem is at.

    ``jitter`` is that of their depth [m].
    """
    before, centre, everywhere = motion.places(seen), motion.centre, np.arange(len(seen))
    times = max(1.0, REFERENCE_DEPTH_JITTER_M / jitter) ** 2
    ridge = HINGE_DEVIATION_RIDGE[0] * times, HINGE_DEVIATION_RIDGE[1] * times
    T_cam = se3.rigid(motion.T_cam_obj[seen, :3, :3], before)
    still = Fixed(np.eye(3)[None], np.zeros((1, 3)), np.zeros(1), len(seen))
    frozen, misfits = Frozen(Soft(still, np.zeros((1, len(seen), 6)), ridge)), 1.0
    energy, smooth = object_evidence_energy(problem), world_smoothness_term(problem)
    for level, iterations in DEPTH_CORRECTION_STAGES:
        frozen = Frozen(replace(frozen.core, ridge=stiffen_ridge(ridge, misfits)))
        found = minimise(frozen, [*energy(level, everywhere), smooth], T_cam, iterations)
        frozen = found.motion
        if level == DEPTH_CORRECTION_STAGES[-1][0]:
            misfits = relative_contour_error(problem.observation, float(found.terms["mask"][0]) / len(seen))
    poses = poses_in_camera(frozen, T_cam)
    moved = np.sum((poses.centre[0] - before) * before, axis=1) / np.sum(before**2, axis=1)
    motion.T_cam_obj[seen] = se3.rigid(poses.R[0], poses.centre[0] - poses.R[0] @ centre)
    hand = motion.T_cam_hands[side]
    hand[seen] = se3.rigid(None, moved[:, None] * before) @ hand[seen]


def depth_jitter(places: Float[ndarray, "n 3"]) -> float:
    """Estimate the standard deviation of errors of depth that differ between frames [m].

    Places are in the camera frame.

    Second differences show errors that remember a tenth of a second nearly in full. Motion has its share in them, which
    is as large across the ray: what they have along the ray beyond that is jitter. 0 for fewer than 3 frames.
    """
    if len(places) < 3:
        return 0.0
    ray = places[1:-1] / np.linalg.norm(places[1:-1], axis=1, keepdims=True)
    second = np.diff(places, 2, axis=0)
    along = np.sum(second * ray, axis=1)
    across = np.linalg.norm(second - along[:, None] * ray, axis=1) / np.sqrt(2.0)
    if np.median(across) > MAX_MOTION_CHANGE_M:
        return 0.0
    excess = np.median(np.abs(along)) ** 2 - np.median(across) ** 2
    return 1.48 * float(np.sqrt(max(excess, 0.0)))
