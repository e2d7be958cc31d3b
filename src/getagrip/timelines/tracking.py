"""Poses followed from frame to frame by the masks, along several paths each.

From one frame to the next an object stays, moves on as before, goes with the hand, or turns: each is a proposal, fitted
to the mask. Where the masks cannot tell, as while the hand covers a mug's handle, a single pose gets lost; so the
distinct paths of least energy go on, and later masks choose. Depth and what a silhouette does not show stay as they
were proposed: deviations are under a ridge.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.fitting.energy.homan_terms import vertex_moments
from getagrip.fitting.motion import Fixed, Frozen, PosesInHand, Soft
from getagrip.fitting.objective import object_evidence_energy
from getagrip.fitting.problem import Problem
from getagrip.fitting.solver.solve import minimise
from getagrip.geometry import se3
from getagrip.timelines.observations import Hypotheses, TimelineInputs

PROPOSAL_RIDGE = (5e4, 300.0)
"""Stiffness of a frame's motion from where it was proposed [px^2 per m^2, per rad^2]."""
PROPOSAL_TURN_RAD = np.radians(15.0)
"""Angles of proposals that turn about the object's principal axes [rad]."""
N_PATHS = 4
"""Kept of each pose."""
TRACKING_STAGES = ((2, ((64, 2),)), (1, ((64, 4), (128, 5))))
"""In each frame: how many times as many paths are kept afterwards; resolutions [px] and iterations."""
DUPLICATE_PATH_DISTANCE = 0.03
"""Paths whose poses are nearer than this, in diameters, go on as one."""
UNRENDERABLE_ENERGY = 1e9
"""Energy of a pose that cannot be rendered [px^2]."""


@dataclass(frozen=True)
class Paths:
    """The paths of poses, least energy first; a path's energy is its pose's, that of its masks and its steps."""

    found: Hypotheses
    start: Int[ndarray, "P"]
    """Which pose each path began with."""

    def at(self, frames: Int[ndarray, "m"]) -> Paths:
        """Return the paths at some of the frames."""
        return Paths(self.found.at(frames), self.start)


def track_hypotheses(footage: TimelineInputs, begin: int, rows: Int[ndarray, "n"], start: Hypotheses) -> Paths:
    """Follow hypotheses of the frame ``begin`` into later frames, or earlier ones, in the order of the frames.

    Frames between are passed as well. In frames that do not show the object it stays where it was.
    """
    step = 1 if rows[-1] > begin else -1
    through = np.arange(begin + step, rows[-1] + step, step)
    shown = footage.shown[through]
    seen = through[shown]
    if not len(seen):
        return Paths(start.at(np.zeros(len(rows), int)), np.arange(len(start.R)))
    carried = [hand_motions(footage.clip, int(last), int(row)) for last, row in itertools.pairwise([begin, *seen])]
    return _track_frames(footage.problem(seen), shown, carried, start).at((rows - through[0]) * step)


def hand_motions(clip: Clip, before: int, after: int) -> list[Float[ndarray, "4 4"]]:
    """Return how something that goes with a hand moves in the world from one frame to another.

    One motion for the clip's own hand, and one for the other hand if it is known in both frames.
    """
    assert clip.world is not None
    ends, hands, other = [before, after], [clip.hand], clip.other_hand
    if other is not None and other.known[before] and other.known[after]:
        hands.append(other.track)
    T_world_hands = [clip.world.T_world_cam[ends] @ hand.T_cam_hand[ends] for hand in hands]
    return [end @ se3.inverse(start) for start, end in T_world_hands]


def _track_frames(
    problem: Problem, shown: Bool[ndarray, "n"], carried: Sequence[Sequence[Float[ndarray, "4 4"]]], start: Hypotheses
) -> Paths:
    """Hypotheses from frame to frame; the problem is at those of n frames that show the object.

    ``carried`` is what hands do to an object that goes with them, from each of these frames to the next.
    """
    energy, mesh, world = object_evidence_energy(problem), problem.clip.mesh, problem.clip.world
    assert world is not None
    T_cam_world, about = se3.inverse(world.T_world_cam), vertex_moments(mesh.vertices - mesh.centre)
    here, before, frame = start, start, 0
    K, N = len(start.R), len(shown)
    room = np.empty((K, N, 3, 3)), np.empty((K, N, 3))
    paths = Paths(Hypotheses(*room, start.scale, start.energy), np.arange(K))
    for n in range(N):
        if shown[n]:
            motion, parent = _propose_steps(here, before, carried[frame], problem.surface.axes)
            for times, steps in TRACKING_STAGES:
                for level, iterations in steps:
                    terms = energy(level, np.array([frame]))
                    fitted = minimise(motion, terms, T_cam_world[[frame]], iterations)
                    motion = fitted.motion
                cost = here.energy[parent] + np.nan_to_num(
                    fitted.energy, nan=UNRENDERABLE_ENERGY, posinf=UNRENDERABLE_ENERGY
                )
                spots = _pose_embedding(about, motion.poses())
                best = _select_distinct_paths(
                    spots, cost, paths.start[parent], times * N_PATHS, DUPLICATE_PATH_DISTANCE * mesh.diameter
                )
                motion, parent, cost = motion.take(best), parent[best], cost[best]
            poses = motion.poses()
            before, here = here.take(parent), Hypotheses(poses.R, poses.centre, poses.scale, cost)
            paths = Paths(replace(paths.found.take(parent), energy=cost), paths.start[parent])
            frame += 1
        paths.found.R[:, n], paths.found.centre[:, n] = here.R[:, 0], here.centre[:, 0]
    return paths


def _propose_steps(
    here: Hypotheses, before: Hypotheses, carried: Sequence[Float[ndarray, "4 4"]], axes: Float[ndarray, "3 3"]
) -> tuple[Frozen[Soft[Fixed]], Int[ndarray, "M"]]:
    """Propose how paths may go on, one frame each, and the path that each proposal is of.

    Half a step on, a whole one with its turn, with a hand (``carried``), or turned about one of the axes.
    """
    R, centre, n = here.R[:, 0], here.centre[:, 0], len(here.R)
    step, turn = centre - before.centre[:, 0], R @ np.swapaxes(before.R[:, 0], -1, -2)
    turned = R @ se3.exp_so3(PROPOSAL_TURN_RAD * np.concatenate([axes, -axes]))[:, None]
    places = [
        (R, centre + 0.5 * step),
        (turn @ R, centre + step),
        *((T[:3, :3] @ R, se3.transform(T, centre)) for T in carried),
        *((r, centre) for r in turned),
    ]
    every = Fixed(
        np.concatenate([r for r, _ in places]), np.concatenate([c for _, c in places]),
        np.tile(np.log(here.scale), len(places)), 1,
    )  # fmt: skip
    return Frozen(Soft(every, np.zeros((len(every.R), 1, 6)), PROPOSAL_RIDGE)), np.tile(np.arange(n), len(places))


def _pose_embedding(about: Float[ndarray, "4 4"], poses: PosesInHand) -> Float[ndarray, "M 12"]:
    """Poses as points, as far apart as surfaces are, root mean square [m]; ``about``: ``vertex_moments`` of the vertices."""
    arm = poses.scale[:, None, None] * about[:, :3] @ np.swapaxes(poses.R[:, 0], -1, -2)
    return np.asarray((arm + about[:, 3:] * poses.centre[:, :1]).reshape(-1, 12))


def _select_distinct_paths(
    spots: Float[ndarray, "M 12"], cost: Float[ndarray, "M"], start: Int[ndarray, "M"], keep: int, same: float
) -> Int[ndarray, "P"]:
    """Return the ``keep`` cheapest of each start, near-copies of a cheaper one left out, cheapest first."""
    chosen: dict[int, list[int]] = {}
    order: list[int] = []
    for m in np.argsort(cost, kind="stable"):
        mine = chosen.setdefault(int(start[m]), [])
        if len(mine) < keep and (not mine or np.linalg.norm(spots[mine] - spots[m], axis=1).min() > same):
            mine.append(int(m))
            order.append(int(m))
    return np.array(order, dtype=int)
