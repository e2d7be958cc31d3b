"""Tracking of hypotheses from frame to frame by the masks, along several paths each.

From one frame to the next an object stays, continues its motion, moves with a hand, or turns: each is a proposal that
is fitted to the mask. Masks can be ambiguous, as while the hand covers a mug's handle, and a single pose would get
lost; so the distinct paths of least energy continue, and later masks choose. A ridge keeps depth, and whatever a
silhouette does not show, as proposed.
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
"""Stiffness of a pose's deviation from its proposal [px^2 per m^2, per rad^2]."""
PROPOSAL_TURN_RAD = np.radians(15.0)
"""Angle of the proposals that turn about the object's principal axes [rad]."""
N_PATHS = 4
"""Number of paths that are kept per start pose."""
TRACKING_STAGES = ((2, ((64, 2),)), (1, ((64, 4), (128, 5))))
"""Stages in each frame: the multiple of ``N_PATHS`` that is kept after it; its resolutions [px] and iterations."""
DUPLICATE_PATH_DISTANCE = 0.03
"""Surface distance below which two paths are one [diameters]."""
UNRENDERABLE_ENERGY = 1e9
"""Energy of a pose that cannot be rendered [px^2]."""


@dataclass(frozen=True)
class Paths:
    """Paths of tracked poses, least energy first: the energies of the start pose, of the masks and of all steps."""

    found: Hypotheses
    start: Int[ndarray, "P"]
    """Index of each path's start pose."""

    def at(self, frames: Int[ndarray, "m"]) -> Paths:
        """Return the paths at ``frames``."""
        return Paths(self.found.at(frames), self.start)


def track_hypotheses(footage: TimelineInputs, begin: int, rows: Int[ndarray, "n"], start: Hypotheses) -> Paths:
    """Track hypotheses from the frame ``begin`` to ``rows``, later or earlier frames in the order of tracking.

    Frames in between are tracked, too. In frames whose masks do not show the object it stays at rest.
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
    """Return the motion in the world, from one frame to another, of an object that moves with a hand.

    The first is of the clip's own hand, the second of the other hand where both frames know it.
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
    """Track hypotheses through n frames, of which ``shown`` are the problem's: those that show the object.

    ``carried`` holds the ``hand_motions`` from each of the problem's frames to the next.
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
                energies = np.nan_to_num(fitted.energy, nan=UNRENDERABLE_ENERGY, posinf=UNRENDERABLE_ENERGY)
                cost = here.energy[parent] + energies
                spots, apart = _pose_embedding(about, motion.poses()), DUPLICATE_PATH_DISTANCE * mesh.diameter
                best = _select_distinct_paths(spots, cost, paths.start[parent], times * N_PATHS, apart)
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
    """Propose poses in the next frame, and the path that each proposal continues.

    Proposals: half of the last step, all of it with its turn, motion with a hand (``carried``), turns about ``axes``.
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
    R, centre = (np.concatenate(part) for part in zip(*places, strict=True))
    every = Fixed(R, centre, np.tile(np.log(here.scale), len(places)), 1)
    return Frozen(Soft(every, np.zeros((len(every.R), 1, 6)), PROPOSAL_RIDGE)), np.tile(np.arange(n), len(places))


def _pose_embedding(about: Float[ndarray, "4 4"], poses: PosesInHand) -> Float[ndarray, "M 12"]:
    """Embed poses as points whose distances are those of the surfaces, root mean square [m].

    ``about``: ``vertex_moments`` of the vertices.
    """
    arm = poses.scale[:, None, None] * about[:, :3] @ np.swapaxes(poses.R[:, 0], -1, -2)
    return np.asarray((arm + about[:, 3:] * poses.centre[:, :1]).reshape(-1, 12))


def _select_distinct_paths(
    spots: Float[ndarray, "M 12"], cost: Float[ndarray, "M"], start: Int[ndarray, "M"], keep: int, same: float
) -> Int[ndarray, "P"]:
    """Choose the ``keep`` cheapest paths of each start, cheapest first, without near-duplicates of a cheaper one."""
    chosen: dict[int, list[int]] = {}
    order: list[int] = []
    for m in np.argsort(cost, kind="stable"):
        mine = chosen.setdefault(int(start[m]), [])
        if len(mine) < keep and (not mine or np.linalg.norm(spots[mine] - spots[m], axis=1).min() > same):
            mine.append(int(m))
            order.append(int(m))
    return np.array(order, dtype=int)
