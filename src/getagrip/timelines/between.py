"""The object between two segments: followed from both of them, and fitted to each frame's mask.

The motions from the one, from the other and a blend of both are fitted; that of the least energy is taken. A blend of
two that disagree, as where a box was turned over unseen, is no motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic, Term
from getagrip.fitting.energy.smoothness import SmoothnessTerm, moments
from getagrip.fitting.motion import Free
from getagrip.fitting.objective import evidence_of
from getagrip.fitting.solve import minimise
from getagrip.geometry import se3
from getagrip.timelines.following import follow
from getagrip.timelines.footage import Footage
from getagrip.timelines.hypotheses import Hypotheses

SMOOTH = 2e5
"""Energy of a surface that moves from one frame to the next [px^2 / m^2]: 20 for a centimetre."""
STAGES = ((128, 6), (256, 4))
"""Resolution [px] and iterations."""


@dataclass(frozen=True)
class WorldTerm:
    """Another term, at poses in the world. Its derivatives are taken back to the camera's frame."""

    term: Term
    T_world_cam: Float[ndarray, "N 4 4"]

    @property
    def name(self) -> str:
        return self.term.name

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        R = self.T_world_cam[:, :3, :3]
        centre = se3.transform(self.T_world_cam, poses.centre[:, :, None])[:, :, 0]
        found = self.term(PosesInCamera(R @ poses.R, np.asarray(centre), poses.scale), bound)
        turn = np.zeros((len(R), 7, 7))
        turn[:, :3, :3] = turn[:, 3:6, 3:6] = R
        turn[:, 6, 6] = 1.0
        back = np.swapaxes(turn, -1, -2)
        cross = found.cross
        if cross is not None:
            cross = np.einsum("nji,bnjmk,mkl->bniml", turn, cross, turn, optimize=True)
        return Quadratic(found.value, (back @ found.g[..., None])[..., 0], back @ found.H @ turn, cross)


def smooth_in_world(footage: Footage, rows: Int[ndarray, "n"]) -> WorldTerm:
    """The term by which the object's surface moves little in the world from each of some frames to the next."""
    about = moments(footage.clip.mesh.vertices - footage.clip.mesh.centre)
    return WorldTerm(SmoothnessTerm(about, SMOOTH), footage.T_world_cam[rows])


def between(
    footage: Footage, rows: Int[ndarray, "n"], before: Hypotheses | None, after: Hypotheses | None
) -> Hypotheses:
    """The object in frames that lie between two known poses, or beyond one: each of one hypothesis in one frame."""
    ahead = None if before is None else follow(footage, rows[0] - 1, rows, before).found
    behind = None if after is None else follow(footage, rows[-1] + 1, rows[::-1], after).found
    behind = behind and behind.at(np.arange(len(rows))[::-1])
    if ahead is None or behind is None:
        start = ahead or behind
        assert start is not None
    else:
        best = np.zeros(1, int)
        start = ahead.concatenate(behind).concatenate(_blended(ahead.take(best), behind.take(best)))
    return _fitted(footage, rows, start)


def _blended(ahead: Hypotheses, behind: Hypotheses) -> Hypotheses:
    """From the one to the other, evenly in time: rotations along the shortest path, centres on a line."""
    n = ahead.R.shape[1]
    share = (np.arange(n) + 1.0)[:, None] / (n + 1)
    turn = se3.log_so3(behind.R @ np.swapaxes(ahead.R, -1, -2))
    R = se3.exp_so3(share * turn) @ ahead.R
    return Hypotheses(R, ahead.centre + share * (behind.centre - ahead.centre), ahead.scale, ahead.energy)


def _fitted(footage: Footage, rows: Int[ndarray, "n"], start: Hypotheses) -> Hypotheses:
    """The best smooth motion near the given ones that meets the masks of the frames that show the object."""
    seen = footage.observed(rows)
    if len(seen) < 2:
        return start.take(np.array([-1]))
    at = np.searchsorted(rows, seen)
    problem = footage.problem(seen)
    motion = Free(start.R[:, at], start.centre[:, at], np.log(start.scale))
    energy, smooth = evidence_of(problem), smooth_in_world(footage, seen)
    everywhere, T_cam_world = np.arange(len(at)), footage.T_cam_world[seen]
    for level, iterations in STAGES:
        found = minimise(motion, [*energy(level, everywhere), smooth], T_cam_world, iterations)
        motion = found.motion
    poses = motion.poses()
    R, centre = start.R.copy(), start.centre.copy()
    R[:, at], centre[:, at] = poses.R, poses.centre
    return Hypotheses(R, centre, start.scale, found.energy).take(np.array([np.argmin(found.energy)]))
