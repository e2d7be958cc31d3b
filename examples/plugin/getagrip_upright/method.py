"""A method: the soft hinge, with a term that keeps the object's z axis vertical."""

from getagrip.fitting.methods import Method, OnStage
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.problem import MethodResult, Problem
from getagrip_upright.upright import UP, AxisTerm


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """The soft hinge with one term more."""
    return soft_hinge(problem, on_stage, more=lambda _: lambda level, frames: [AxisTerm("upright", UP, 10.0)])


UPRIGHT = Method("upright", fit, has_axis=True)
