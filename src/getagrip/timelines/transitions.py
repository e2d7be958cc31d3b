"""The object's motion over a timeline, filled in segment by segment: the frames between segments, the depth of grasps.

Between two segments the object is tracked from both. Both motions, and a blend of the best of each, are fitted to the
masks, and the one of least energy is taken; a blend of motions that disagree (a box turned over unseen) is implausible.

A hand's depth jitters by about a centimetre from frame to frame, and with it a grasped object. The mask's size and a
smooth motion determine depth better. The hand is moved along the camera's ray as far as the object, so that contact
remains.
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

WORLD_SMOOTHNESS_WEIGHT = 2e5
"""Energy of a surface's motion between frames, in the world [px^2 / m^2]: 20 px^2 for a centimetre."""
GAP_FIT_STAGES = ((128, 6), (256, 4))
"""Resolution [px] and iterations of each stage."""
REFERENCE_DEPTH_JITTER_M, MIN_DEPTH_JITTER_M = 0.01, 0.001
"""Depth jitter at which ``HINGE_DEVIATION_RIDGE`` holds, and minimum jitter that is corrected [m]."""
MAX_MOTION_CHANGE_M = 0.01
"""Change of motion between frames above which jitter cannot be estimated [m]."""
HINGE_DEVIATION_RIDGE = (1e5, 1e4)
"""Stiffness of a frame's deviation from the hinge in the hand [px^2 per m^2, per rad^2]: it keeps hidden parts fixed.

Its multiple is the inverse square of the relative jitter: a steady hand knows depth better than half-hidden masks. It
grows, too, where masks are met worse than by the object's own mesh (``relative_contour_error``).
"""
DEPTH_CORRECTION_STAGES = ((128, 6), (256, 4), (256, 4))
"""Resolution [px] and iterations of each stage; the contour error is known before the last."""


@dataclass
class TimelineMotion:
    """The motion of an object over a clip; poses are NaN until their frame is filled.

    Attributes:
        side: side of the clip's own hand.
        centre: (3,) centre of the mesh, in its own frame [m].
        T_world_cam: (T, 4, 4) poses of the camera.
        shown: (T,) frames whose masks show the object.
        T_cam_obj: (T, 4, 4) poses of the mesh's own frame in the camera frame.
        T_cam_hands: (T, 4, 4) poses of each known hand, by side, corrected in its grasps.
        kind: origin of each frame's pose.
        grasps: the solved grasps, by the first frame of their segment.
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
        """Make a motion without any known pose."""
        assert clip.world is not None
        T = len(clip)
        hands = {clip.side: clip.hand.T_cam_hand.copy()}
        if clip.other_hand is not None:
            hands[clip.other_side] = clip.other_hand.track.T_cam_hand.copy()
        where = clip.side, clip.mesh.centre, clip.world.T_world_cam, shown
        return TimelineMotion(*where, np.full((T, 4, 4), np.nan), hands, ["interpolated"] * T)

    @property
    def T_cam_hand(self) -> Float[ndarray, "T 4 4"]:
        """Poses of the clip's own hand."""
        return self.T_cam_hands[self.side]

    @property
    def T_cam_other_hand(self) -> Float[ndarray, "T 4 4"] | None:
        """Poses of the other hand; None where it is unknown."""
        return next((T for side, T in self.T_cam_hands.items() if side != self.side), None)

    def put(self, rows: Int[ndarray, "n"], found: Hypotheses, kind: FrameKind) -> None:
        """Put the first hypothesis into ``rows``; frames that show the object get this ``kind``."""
        self.T_cam_obj[rows] = se3.inverse(self.T_world_cam[rows]) @ found.T_world_obj(self.centre)[0]
        for row in rows[self.shown[rows]]:
            self.kind[row] = kind

    def put_grasp(self, found: GraspTrack) -> None:
        """Put a grasp and its hand into the grasp's frames."""
        grasp, track = found.solutions.grasp, found.track
        self.T_cam_obj[grasp.rows] = track.T_cam_hand @ track.T_hand_obj[0]
        self.T_cam_hands[grasp.clip.side][grasp.rows] = track.T_cam_hand
        for row, kind in zip(grasp.rows, track.kind, strict=True):
            self.kind[row] = kind
        self.grasps[grasp.segment.first] = found

    def places(self, rows: Int[ndarray, "n"]) -> Float[ndarray, "n 3"]:
        """Return the mesh's centre in the camera frame, at ``rows`` [m]."""
        return np.asarray(se3.transform(self.T_cam_obj[rows], self.centre[None])[:, 0])

    def at(self, row: int) -> Hypotheses:
        """Return the hypothesis of one frame's pose."""
        return Hypotheses.of_pose(self.T_world_cam[row] @ self.T_cam_obj[row], self.centre)


def split_at_gaps(segment: Segment, rows: Int[ndarray, "n"]) -> list[Segment]:
    """Split a segment into one segment per run of ``rows``: ascending indices of some of its frames."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return [replace(segment, first=int(part[0]), last=int(part[-1])) for part in parts]


def world_smoothness_term(problem: Problem) -> TermInFrame:
    """Make the term that penalises motion of the object's surface in the world between consecutive frames."""
    mesh, world = problem.clip.mesh, problem.clip.world
    assert world is not None
    smoothness = SmoothnessTerm(vertex_moments(mesh.vertices - mesh.centre), WORLD_SMOOTHNESS_WEIGHT)
    return TermInFrame(smoothness, world.T_world_cam)


def fill_gaps(motion: TimelineMotion, footage: TimelineInputs, known: list[Segment]) -> None:
    """Fill the frames before, between and after the ``known`` segments."""
    edges = [(None, known[0]), *itertools.pairwise(known), (known[-1], None)]
    for one, other in edges:
        rows = np.arange(0 if one is None else one.last + 1, len(footage) if other is None else other.first)
        if not len(rows):
            continue
        ahead = behind = None
        if one is not None:
            ahead = track_hypotheses(footage, one.last, rows, motion.at(one.last)).found
        if other is not None:
            behind = track_hypotheses(footage, other.first, rows[::-1], motion.at(other.first)).found
            behind = behind.at(np.arange(len(rows))[::-1])
        found, shown = _candidate_motions(ahead, behind), footage.shown[rows]
        if shown.sum() > 1:
            found = _fit_smooth_motion(footage.problem(rows[shown]), np.flatnonzero(shown), found)
        else:
            found = found.take(np.array([-1]))
        motion.put(rows, found, "fitted")


def _candidate_motions(ahead: Hypotheses | None, behind: Hypotheses | None) -> Hypotheses:
    """Return all tracked motions; of two, also the blend of the best of each."""
    if ahead is None or behind is None:
        start = ahead or behind
        assert start is not None
        return start
    best = np.zeros(1, int)
    return ahead.concatenate(behind).concatenate(_blend_motions(ahead.take(best), behind.take(best)))


def _blend_motions(ahead: Hypotheses, behind: Hypotheses) -> Hypotheses:
    """Blend two motions linearly in time: rotations along the shortest path, centres along a line."""
    n = ahead.R.shape[1]
    share = (np.arange(n) + 1.0)[:, None] / (n + 1)
    turn = se3.log_so3(behind.R @ np.swapaxes(ahead.R, -1, -2))
    R = se3.exp_so3(share * turn) @ ahead.R
    return Hypotheses(R, ahead.centre + share * (behind.centre - ahead.centre), ahead.scale, ahead.energy)


def _fit_smooth_motion(problem: Problem, at: Int[ndarray, "m"], start: Hypotheses) -> Hypotheses:
    """Fit smooth motions to the masks, from ``start``; return the best. The problem holds the frames ``at``."""
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


def correct_depth(motion: TimelineMotion, problem: Problem, seen: Int[ndarray, "n"], side: Side, jitter: float) -> None:
    """Move the object, and the hand of ``side``, to the masks' depth, in the problem's frames ``seen``.

    ``jitter`` is the estimated depth jitter [m].
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
    """Estimate the standard deviation of frame-to-frame errors in depth [m]; 0 for fewer than 3 frames.

    ``places`` are positions in the camera frame. Second differences show errors with a memory of a tenth of a second
    nearly in full. They contain the motion, too, which is as large across the ray: the excess along the ray is jitter.
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
