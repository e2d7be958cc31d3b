"""Do the methods get enough computation? Final energy and error against the number of initial poses and of iterations.

    python -m benchmarks.baselines [clips]

Puts a table into docs/results-search.md: each method as it is, with two and four times the initial poses, and with two
and four times the iterations of every stage. A method gets enough where more of either hardly lowers its energy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from statistics import mean, median
from unittest.mock import patch

from benchmarks import page
from benchmarks.problem import Problem
from getagrip.clip.sampling import frame_indices
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.datasets.synthetic.noise import NOISE
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.fitting.methods import all_frames, homan, homan_refine, single_frame
from getagrip.fitting.observation import observe
from getagrip.fitting.options import Options
from getagrip.fitting.reconstruct import reconstruct
from getagrip.fitting.schedule import Schedule, Stage

METHODS = (
    "soft-hinge",
    "one-dof",
    "static",
    "dynamic",
    "contact-consistency",
    "homan",
    "single-frame",
)
FACTORS = ((1, 1), (2, 1), (4, 1), (1, 2), (1, 4))
"""Of initial poses and of iterations."""
CONDITIONS = {"exact": SceneOptions(), "moderate": SceneOptions(**vars(NOISE["moderate"]))}
CLOSE = 1.02
"""An energy within this factor of the least that the method found with any setting counts as found."""


@dataclass(frozen=True)
class Score:
    """One method on one clip."""

    energy: float
    """Per frame."""
    add: float
    """Up to symmetries, as a share of the diameter."""
    seconds: float


@contextmanager
def longer(factor: int) -> Iterator[None]:
    """All methods with so many times the iterations."""

    def stage(of: Stage) -> Stage:
        return replace(of, iterations=factor * of.iterations)

    def schedule(of: Schedule) -> Schedule:
        return replace(
            of,
            static_iterations=factor * of.static_iterations,
            relaxed_iterations=factor * of.relaxed_iterations,
            coarse=tuple(map(stage, of.coarse)),
            fine=tuple(map(stage, of.fine)),
        )

    refine = tuple((level, factor * iterations) for level, iterations in homan_refine.STAGES)
    with ExitStack() as stack:
        stack.enter_context(patch.object(all_frames, "USUAL", schedule(all_frames.USUAL)))
        stack.enter_context(patch.object(single_frame, "SCHEDULE", schedule(single_frame.SCHEDULE)))
        stack.enter_context(patch.object(homan, "FIRST", factor * homan.FIRST))
        stack.enter_context(patch.object(homan, "LATER", factor * homan.LATER))
        stack.enter_context(patch.object(homan_refine, "STAGES", refine))
        yield


def score(problem: Problem, method: str, poses: int, iterations: int) -> Score:
    """Reconstruct with so many times the initial poses and iterations."""
    with longer(iterations):
        result = reconstruct(problem.clip, problem.masks, Options(method=method, inits=poses * Options().inits))
    frames = len(result.frames)
    return Score(result.energy["total"] / frames, problem.add(result.T_hand_obj), result.seconds["total"])


def main(clips: int) -> None:
    """Write the table, for so many clips: categories spread evenly, every second one with noise."""
    problems = []
    for k, c in enumerate(frame_indices(len(CATEGORIES), clips)):
        clip, masks = synthesise(sorted(CATEGORIES)[c], 0, tuple(CONDITIONS.values())[k % 2])
        problems.append(Problem(clip, masks, observe(masks, clip.K)))
    summary = f"{len(problems)} clips of as many categories, half of them {', half '.join(CONDITIONS)}."
    heads = [
        "method",
        "initial poses",
        "iterations",
        "energy per frame",
        "median",
        "found %",
        "ADD %",
        "ADD median %",
        "s",
    ]
    rows = []
    for method in METHODS:
        scores = {factors: [score(p, method, *factors) for p in problems] for factors in FACTORS}
        least = [min(s.energy for s in of_clip) for of_clip in zip(*scores.values(), strict=True)]
        for (poses, iterations), group in scores.items():
            energies = [s.energy for s in group]
            found = mean(s.energy < CLOSE * e for s, e in zip(group, least, strict=True))
            row = [method, f"x{poses}", f"x{iterations}", f"{mean(energies):.1f}", f"{median(energies):.1f}"]
            row += [f"{100 * found:.0f}", f"{100 * mean(s.add < 0.1 for s in group):.0f}"]
            row += [f"{100 * median(s.add for s in group):.1f}", f"{median(s.seconds for s in group):.2f}"]
            print(" | ".join(row), flush=True)
            rows.append(row)
    page.write("baselines", f"{page.circumstances()}\n\n{summary}\n\n{page.table(heads, rows)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 16)
