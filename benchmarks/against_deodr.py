"""Our reconstruction against Adam on the same energy, with DEODR's silhouettes and ours, side by side in one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import mean, median

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import adam
from benchmarks.page import table
from benchmarks.problem import CLIPS, Problem, make, reconstruction
from benchmarks.timing import Timing, timed
from getagrip import se3
from getagrip.energy import Term
from getagrip.motion import Hinge
from getagrip.reconstruct import Options, _starts
from getagrip.solve import in_camera

STARTS = 50
NEAR = np.radians(30.0)
RATES = (1.0, 2.0, 4.0, 8.0)
REPEATS = 5
MASK_ONLY = Options(inits=STARTS, push=0.0, pull=0.0)
ALL_TERMS = Options(inits=STARTS)


@dataclass(frozen=True)
class Run:
    """One way to solve a problem: what it cost and what it found."""

    method: str
    cpu: float
    wall: float
    T_hand_obj: Float[ndarray, "T 4 4"]

    @staticmethod
    def of(method: str, timing: Timing, T_hand_obj: Float[ndarray, "T 4 4"]) -> Run:
        """The median of what was timed."""
        return Run(method, median(timing.cpu), median(timing.wall), T_hand_obj)


def section() -> str:
    """Measure; the section's text."""
    rows, notes, faster, lower = [], [], [], []
    for category, seed in CLIPS:
        problem = make(category, seed)
        ours, others, peer, note = _compare(problem)
        notes.append(f"- {problem.clip.name}: {note}")
        faster.append(peer.cpu / ours.cpu)
        lower.append(problem.energy(ours.T_hand_obj) / problem.energy(peer.T_hand_obj))
        for run in (ours, *others, peer):
            rows.append([
                problem.clip.name, run.method, f"{run.cpu:.2f}", f"{run.wall:.2f}", f"{run.cpu / ours.cpu:,.1f}",
                f"{problem.energy(run.T_hand_obj):.1f}", f"{100 * problem.add(run.T_hand_obj):.1f}",
            ])  # fmt: skip
    header = ["clip", "method", "CPU s", "wall s", "times ours", "E_mask, px per frame", "ADD, % of diameter"]
    frames = len(problem.clip)
    return "\n\n".join([
        f"On the mask term ours is {min(faster):,.0f} to {max(faster):,.0f} times as fast (processor time) as Adam on "
        f"DEODR from {STARTS} starts, and ends at {min(lower):.2f} to {max(lower):.2f} times the mask energy of the "
        f"better of the two starts that were run. {frames} frames, {adam.ITERATIONS} iterations of Adam, 256 x 256 "
        "pixels; every final energy is the exact one at 256 pixels, without antialiasing.",
        table(header, rows),
        "\n".join(notes),
    ])  # fmt: skip


def _compare(problem: Problem) -> tuple[Run, list[Run], Run, str]:
    """Ours on the mask term (timed before and after the rest), the others, Adam on DEODR from all starts, and notes."""
    from benchmarks.deodr_term import DeodrTerm, agreement

    clip, masks, T_cam_hand = problem.clip, problem.masks, problem.clip.hand.T_cam_hand
    mask_only, all_terms = (reconstruction(clip, masks, options) for options in (MASK_ONLY, ALL_TERMS))
    mask_only()
    before, found = timed(mask_only, REPEATS)
    full, found_full = timed(all_terms, REPEATS)

    everywhere, near = _all_starts(problem), _near_start(problem)
    deodr = DeodrTerm(problem)
    cosine = agreement(deodr, in_camera(near, T_cam_hand))
    if cosine < 0.9:
        raise RuntimeError(f"DEODR's gradient against differences of its energy: cosine {cosine:.3f}, expected 0.9")

    def descend(start: Hinge, term: Term, rate: float) -> Callable[[], Float[ndarray, "T 4 4"]]:
        def call() -> Float[ndarray, "T 4 4"]:
            descent = adam.minimise(start, term, T_cam_hand, rate)
            return adam.poses(descent.motion, problem.centre)[int(np.argmin(descent.energy))]

        return call

    def tuned(term: Term) -> tuple[float, dict[float, float]]:
        """The learning rate that ends lowest from the near start."""
        ends = {rate: problem.energy(descend(near, term, rate)()) for rate in RATES}
        return min(ends, key=lambda rate: ends[rate]), ends

    rate, ends = tuned(deodr)
    from_near, (T_near,) = timed(descend(near, deodr, rate))
    from_first, (T_first,) = timed(descend(everywhere.take(np.array([0])), deodr, rate))
    others = [
        Run.of("ours, all terms", full, found_full[0].T_hand_obj),
        Run.of("Adam on DEODR, 1 start, 30° from the truth", from_near, T_near),
        Run.of("Adam on DEODR, 1 start, the first of ours", from_first, T_first),
    ]
    for level in (256, 64):
        term = problem.mask_term(level)
        timing, (T,) = timed(descend(everywhere, term, tuned(term)[0]))
        others.append(Run.of(f"Adam on our silhouettes at {level} px, {STARTS} starts", timing, T))
    after, _ = timed(mask_only, REPEATS)

    one = from_near + from_first
    better = min(T_near, T_first, key=problem.energy)
    peer = Run(
        f"Adam on DEODR, {STARTS} starts: one start times {STARTS}",
        STARTS * mean(one.cpu),
        STARTS * mean(one.wall),
        better,
    )
    listed = ", ".join(f"{adam.UNIT * r:g}: {energy:.0f}" for r, energy in ends.items())
    note = (
        f"DEODR's gradient against differences of its own energy: cosine {cosine:.3f}; E_mask it ends at from the near "
        f"start by learning rate: {listed}; taken: {adam.UNIT * rate:g}"
    )
    return Run.of("ours, mask term", before + after, found[0].T_hand_obj), others, peer, note


def _all_starts(problem: Problem) -> Hinge:
    """The starts of our own search."""
    fixed = _starts(problem.clip, problem.masks, MASK_ONLY)
    return adam.start(fixed.R, fixed.centre, -problem.centre, len(problem.clip))


def _near_start(problem: Problem) -> Hinge:
    """A start whose rotation is 30 degrees from the truth of the middle frame, placed where all starts are."""
    clip, truth = problem.clip, problem.clip.truth
    assert truth is not None
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    axis = np.random.default_rng(0).normal(size=3)
    turn = se3.exp_so3(NEAR * axis / np.linalg.norm(axis))
    R = turn @ T_hand_obj[len(clip) // 2, :3, :3]
    return adam.start(R[None], _all_starts(problem).centre[:1], -problem.centre, len(clip))
