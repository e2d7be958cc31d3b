"""Multi-start, coarse-to-fine search: many rotations at low resolution and few frames, fewer and fewer at higher.

The energy of a static fit often ranks the right hypothesis low: so the first hypotheses are dropped after a relaxed
fit, most after the motion model has been fitted. Then the best are rotated and fitted again, in a few rounds: local
minima lie side by side, and in pairs. The middle stage rotates once more by less: a mug whose handle is in the hand has
minima all around the right one. At the end the best is compared with its half turn, where half a turn leaves the
surface nearly unchanged, and always where an unmeasured object differs from its half turn by a handle only.

The axis of a hinge comes from the data: after a static fit, a relaxed fit with a small deviation per frame, whose
rotation vectors' principal direction is the axis. (Angle zero about any axis is a dead start: the energy does not
depend on the axis.)

A method (``methods.all_frames``) calls ``relax``, chooses the motion model, and calls ``run``, which is ``coarse``,
``at_all_frames`` and ``fine``. A ``Schedule`` gives each stage's frames, pixels, hypotheses and iterations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip.clip import frame_indices
from getagrip.errors import GetagripError
from getagrip.fitting.energy import Energy, Term
from getagrip.fitting.motion import Fixed, Motion, PosesInHand, Soft
from getagrip.fitting.problem import ObjectSurface
from getagrip.fitting.solver.solve import Solution, minimise
from getagrip.geometry import se3
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

DEVIATION_STIFFNESS = (2e5 / 16, 1.2e3 / 16)
"""Stiffness of the deviations in the relaxed fit [px^2 per m^2, px^2 per rad^2]."""
DUPLICATE_DISTANCE_DIAMETERS = 0.03
"""Distance of the posed surfaces up to which hypotheses are duplicates."""
MEETING_DISTANCE_DIAMETERS, MEETING_LEAD, N_MEETING_STARTS = 0.05, 1.5, 2
"""Rounds end once this number of independent starts is within the distance of the best pose, and all other poses have
at least ``MEETING_LEAD`` times its energy."""
AMBIGUOUS_SIDE_RATIO = 1.02
"""Ratio of energies up to which an object and its half turn are ambiguous. On 94 training clips of DexYCB and ARCTIC
the ratio was 1.005 where the best was wrong, and 1.007 or more where the best was right."""
HANDLE_FLIP_TOLERANCE_RAD = np.radians(60.0)
"""Maximum deviation from half a turn between solutions with the handle on opposite sides."""
ALL_FRAMES = 10**9
"""Number that stands for all frames."""


@dataclass(frozen=True)
class Rotations:
    """Ranges of rotations of the object from one local minimum to another.

    Attributes:
        random: smallest and largest rotation about a random axis [degrees].
        principal: the same about each of the three principal axes, either way [degrees].
    """

    random: tuple[float, float]
    principal: tuple[float, float]


GLOBAL_ROTATIONS = Rotations(random=(10.0, 40.0), principal=(180.0, 180.0))
"""Rotations to distant minima; half a turn about a principal axis gives nearly the same silhouette."""
LOCAL_ROTATIONS = Rotations(random=(5.0, 20.0), principal=(8.0, 25.0))
"""Rotations out of a minimum beside the best."""


@dataclass(frozen=True)
class Stage:
    """One stage of the search.

    Attributes:
        name: name, as in progress reports.
        level: side of the masks [px]: 64, 128 or 256.
        frames: maximum number of frames.
        iterations: maximum number of iterations of the solver.
        keep: number of hypotheses kept for the next stage.
        within: maximum energy of these, in the least energy. After the coarse stage the right hypothesis may still have
            many times the least energy (docs/method-details.md).
        rounds: number of times that the best hypotheses of the stage are rotated and fitted again.
        parents: number of hypotheses that are rotated.
        rotations: ranges of their rotations.
        until_met: whether rounds end once ``starts_have_met``.
        half_turns: whether the best hypothesis is also fitted from its half turns, where these leave the surface nearly
            unchanged (``ObjectSurface.half_turns``); both are kept where their energies are ambiguous. Coarser stages
            do not tell the two apart.
    """

    name: str
    level: int
    frames: int
    iterations: int
    keep: int
    rounds: int = 0
    parents: int = 8
    rotations: Rotations = GLOBAL_ROTATIONS
    until_met: bool = False
    within: float = np.inf
    half_turns: bool = False


@dataclass(frozen=True)
class Schedule:
    """The whole search.

    Attributes:
        static_iterations: iterations of the first fit, with one pose for all frames.
        relaxed_iterations: iterations of the second fit, in which each frame may deviate from that pose.
        relaxed: number of hypotheses kept after the second fit.
        coarse: stages on some of the frames. The first two fits are made at the first stage's frames and level.
        fine: stages on all frames.
    """

    static_iterations: int = 6
    relaxed_iterations: int = 3
    relaxed: int = 30
    coarse: tuple[Stage, ...] = (
        Stage("coarse", level=64, frames=8, iterations=5, keep=16, rounds=3, parents=12, until_met=True),
        Stage(
            "middle", 64, frames=15, iterations=6, keep=6, rounds=1, parents=8, rotations=LOCAL_ROTATIONS, within=4.0
        ),
    )
    fine: tuple[Stage, ...] = (
        Stage("fine", level=128, frames=ALL_FRAMES, iterations=8, keep=3, within=2.5),
        Stage("finest", level=256, frames=ALL_FRAMES, iterations=12, keep=4, half_turns=True),
    )


DEFAULT_SCHEDULE = Schedule()
THOROUGH_SCHEDULE = Schedule(
    relaxed=ALL_FRAMES,
    coarse=(
        Stage("coarse", level=64, frames=8, iterations=5, keep=32, rounds=8, parents=12),
        Stage("middle", level=64, frames=15, iterations=8, keep=12, rounds=2, parents=8, rotations=LOCAL_ROTATIONS),
    ),
    fine=(
        Stage("fine", level=128, frames=ALL_FRAMES, iterations=12, keep=6, rounds=2, parents=3),
        Stage("finest", level=256, frames=ALL_FRAMES, iterations=16, keep=4, half_turns=True),
    ),
)
"""A longer search: more hypotheses are kept, for more stages, and are rotated once more on all frames."""


@dataclass(frozen=True)
class Search:
    """The steps of a search on one clip of N frames. Each raises ``GetagripError`` where no pose can be rendered."""

    T_cam_hand: Float[ndarray, "N 4 4"]
    surface: ObjectSurface
    schedule: Schedule
    on_stage: Callable[[str], None]
    """Called with the name of each stage when it ends."""
    threads: int = 1
    opposite: Float[ndarray, "k 3 3"] = field(default_factory=lambda: np.zeros((0, 3, 3)))
    """Turns of the object that take a handle to its other side: the best solution with such a turn is always kept."""

    def relax(self, initial: Fixed, energy: Energy) -> Soft[Fixed]:
        """Fit a static pose from each initial one, then let each frame deviate a little."""
        stage = self.schedule.coarse[0]
        index = self.frames(stage)
        terms, T = energy(stage.level, index), self.T_cam_hand[index]
        fixed, schedule, threads = replace(initial, frames=len(index)), self.schedule, self.threads
        static = minimise(fixed, terms, T, schedule.static_iterations, threads=threads).motion
        relaxed = Soft(static, np.zeros((len(static.R), len(index), 6)), DEVIATION_STIFFNESS)
        found = minimise(relaxed, terms, T, schedule.relaxed_iterations, threads=threads)
        return found.motion.take(np.sort(np.argsort(found.energy, kind="stable")[: schedule.relaxed]))

    def run(self, motion: M, energy: Energy) -> Solution[M]:
        """Run all stages, by one motion model and one energy, from a motion at the frames of the first."""
        return self.fine(self.at_all_frames(self.coarse(motion, energy).motion), energy)

    def coarse(self, motion: M, energy: Energy) -> Solution[M]:
        """Run the stages on some of the frames, from a motion at the first stage's."""
        return self._stages(motion, self.schedule.coarse, energy)

    def at_all_frames(self, motion: M, coarse: int = -1) -> M:
        """Resample a motion from the frames of a coarse stage, by default the last, to those of the fine stages."""
        return motion.resampled(self.frames(self.schedule.coarse[coarse]), self.frames(self.schedule.fine[0]))

    def at_first_frames(self, motion: M) -> M:
        """Resample a motion at all frames to those of the first stage."""
        return motion.resampled(np.arange(len(self.T_cam_hand)), self.frames(self.schedule.coarse[0]))

    def fine(self, motion: M, energy: Energy, stages: slice = slice(None)) -> Solution[M]:
        """Run the stages on all frames, or a slice of these stages; return distinct solutions, best first."""
        return self._stages(motion, self.schedule.fine[stages], energy)

    @property
    def coarse_frames(self) -> Int[ndarray, "n"]:
        """The frames of the last coarse stage."""
        return self.frames(self.schedule.coarse[-1])

    def frames(self, stage: Stage) -> Int[ndarray, "n"]:
        """Return the frames of a stage (indices into the clip)."""
        return frame_indices(len(self.T_cam_hand), stage.frames)

    def _stages(self, motion: M, stages: Sequence[Stage], energy: Energy) -> Solution[M]:
        """Fit, rotate, fit again and prune, stage after stage."""
        index = self.frames(stages[0])
        for k, stage in enumerate(stages):
            if k:
                before, index = index, self.frames(stage)
                motion = motion.resampled(before, index)
            turns = self.opposite if stage in self.schedule.fine else self.opposite[:0]
            if stage.half_turns:
                turns = np.concatenate([turns, self.surface.half_turns])
            if len(turns):
                motion = motion.concatenate(motion.take(np.zeros(len(turns), int)).rotated(turns))
            terms, T = energy(stage.level, index), self.T_cam_hand[index]
            solution = minimise(motion, terms, T, stage.iterations, threads=self.threads)
            solution = explore_rotations(solution, terms, T, self.surface, stage, self.threads)
            poses, energies = solution.motion.poses(), solution.energy
            best = suppress_duplicates(poses, energies, self.surface, stage.keep, stage.half_turns)
            if not len(best):
                raise GetagripError(Status.INVISIBLE.sentence)
            kept = best[within_factor(solution.energy[best], stage.within)]
            if stage in self.schedule.fine:
                kept = self._with_opposite(kept, poses, energies, stage.keep)
            solution = solution.take(kept)
            motion = solution.motion
            self.on_stage(stage.name)
        return solution

    def _with_opposite(
        self, kept: Int[ndarray, "k"], poses: PosesInHand, energy: Float[ndarray, "B"], most: int
    ) -> Int[ndarray, "n"]:
        """Add the best solution with the handle opposite to the first one's, in the place of the last of ``most``."""
        few = frame_indices(poses.R.shape[1], 3)
        between = np.swapaxes(poses.R[kept[0], few], -1, -2) @ poses.R[:, few]
        for turn in self.opposite:
            off = se3.angle_between(between, turn).mean(axis=-1)
            flipped = np.flatnonzero((off < HANDLE_FLIP_TOLERANCE_RAD) & np.isfinite(energy))
            if len(flipped) and not np.isin(flipped, kept).any():
                kept = np.append(kept[: most - 1], flipped[energy[flipped].argmin()])
        return kept


def explore_rotations(
    solution: Solution[M],
    terms: Sequence[Term],
    T_cam_hand: Float[ndarray, "N 4 4"],
    surface: ObjectSurface,
    stage: Stage,
    threads: int = 1,
) -> Solution[M]:
    """Rotate the best solutions of a stage and fit them again, in several rounds; return old and new solutions."""
    rng, independent = np.random.default_rng(0), len(solution.energy)
    for _ in range(stage.rounds):
        if stage.until_met and starts_have_met(solution, independent, surface):
            break
        parents = suppress_duplicates(solution.motion.poses(), solution.energy, surface, stage.parents)
        if not len(parents):
            break
        children = solution.motion.take(np.tile(parents, 2))
        children = children.rotated(drawn_rotations(surface.axes, stage.rotations, len(parents), rng))
        solution = solution.concatenate(minimise(children, terms, T_cam_hand, stage.iterations, threads=threads))
    return solution


def starts_have_met(solution: Solution[M], independent: int, surface: ObjectSurface) -> bool:
    """Return whether two of the first ``independent`` solutions are the best pose, far ahead of all other poses."""
    energy, poses = solution.energy, solution.motion.poses()
    best = int(np.argmin(np.where(np.isfinite(energy), energy, np.inf)))
    if not np.isfinite(energy[best]):
        return False
    few = frame_indices(poses.R.shape[1], 3)
    R, centre = poses.R[:, few], poses.centre[:, few]
    apart = surface.rms_distance(
        R[best], centre[best], float(poses.scale[best]), R, centre, poses.scale, MEETING_DISTANCE_DIAMETERS
    )
    same = apart <= MEETING_DISTANCE_DIAMETERS
    others = energy[~same & np.isfinite(energy)]
    ahead = not within_factor(np.array([energy[best], others.min(initial=np.inf)]), MEETING_LEAD)[1]
    return bool(ahead and np.count_nonzero(same[:independent]) >= N_MEETING_STARTS)


def within_factor(energy: Float[ndarray, "n"], within: float) -> Bool[ndarray, "n"]:
    """Mark the energies at most ``within`` times the first, which is the least; energies may be below zero."""
    return np.asarray(energy - energy[0] <= (within - 1.0) * max(abs(energy[0]), 1e-9))


def drawn_rotations(
    axes: Float[ndarray, "3 3"], by: Rotations, count: int, rng: np.random.Generator
) -> Float[ndarray, "n 3 3"]:
    """Draw ``count`` rotations about random axes, then ``count`` about the principal ones, the rows of ``axes``."""
    random = rng.normal(size=(count, 3))
    random *= np.radians(rng.uniform(*by.random, (count, 1))) / np.linalg.norm(random, axis=1, keepdims=True)
    angle = np.radians(rng.uniform(*by.principal, (count, 1))) * rng.choice([-1.0, 1.0], (count, 1))
    return se3.exp_so3(np.concatenate([random, angle * axes[rng.integers(3, size=count)]]))


def suppress_duplicates(
    poses: PosesInHand, energy: Float[ndarray, "B"], surface: ObjectSurface, keep: int, half_turns: bool = False
) -> Int[ndarray, "n"]:
    """Choose the ``keep`` lowest finite energies without duplicates of a better one; return their indices.

    Two hypotheses are duplicates if their surfaces are at most ``DUPLICATE_DISTANCE_DIAMETERS`` apart; with
    ``half_turns``, not if they differ by a visible half turn and have nearly the least energy.
    """
    few = frame_indices(poses.R.shape[1], 3)
    R, centre, scale = poses.R[:, few], poses.centre[:, few], poses.scale
    chosen: list[int] = []
    for b in np.argsort(energy, kind="stable"):
        if len(chosen) == keep or not np.isfinite(energy[b]):
            break
        here, others = (R[b], centre[b], float(scale[b])), (R[chosen], centre[chosen], scale[chosen])
        copies = np.zeros(0, dtype=bool)
        if chosen:
            apart = surface.rms_distance(*here, *others, DUPLICATE_DISTANCE_DIAMETERS)
            copies = apart <= DUPLICATE_DISTANCE_DIAMETERS
        if half_turns and copies.any() and within_factor(energy[[chosen[0], b]], AMBIGUOUS_SIDE_RATIO)[1]:
            copies &= ~surface.half_turned(R[b], R[chosen])
        if not copies.any():
            chosen.append(int(b))
    return np.array(chosen, dtype=int)
