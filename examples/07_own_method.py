"""A method of your own in the benchmark: a function from a Problem to a MethodResult, under a name in METHODS.

    python examples/07_own_method.py OUT

compares it with the default on two synthetic clips; tables and results go into OUT (default: out/own-method). What
follows OUT goes to `getagrip bench` as it is.
"""

import sys
from pathlib import Path

import numpy as np

from getagrip.fitting.methods import METHODS, Method, OnStage
from getagrip.fitting.objective import energy_of
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.initial_poses import initial_poses
from getagrip.fitting.solver.solve import minimise


def coarse_static(problem: Problem, on_stage: OnStage) -> MethodResult:
    """One pose for all frames, fitted from each initial pose at 64 pixels; the lowest energy wins. No contact terms."""
    start = initial_poses(problem.clip, problem.masks, problem.options.inits, problem.options.seed)
    terms = energy_of(problem, push=0.0, pull=0.0)(64, np.arange(len(problem.clip)))
    found = minimise(start, terms, problem.clip.hand.T_cam_hand, iterations=20)
    on_stage("coarse")
    best = found.take(np.array([np.argmin(found.energy)]))
    energy_per_term = {name: float(value[0]) for name, value in best.terms.items()}
    return MethodResult(best.motion.poses(), best.energy, energy_per_term, best.status[0])


METHODS["coarse-static"] = Method("Coarse static", coarse_static)  # at the top: the benchmark's processes run it, too

if __name__ == "__main__":
    from getagrip.cli import main  # after METHODS is complete: the choices of --methods are made from it

    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/own-method")
    methods = ["soft-hinge", "coarse-static"]
    sys.exit(main(["bench", "synthetic", "--clips", "2", "--out", str(out), "--methods", *methods, *sys.argv[2:]]))
