"""Every method, by its name: ours, those after the paper's, the baselines, and the paper's to the letter.

A method is a function from a ``Problem`` to a ``MethodResult``. A new one needs a file here and a line in ``METHODS``;
a script adds its own with ``METHODS["name"] = Method(...)``. Loading the table costs nothing: a method's file is
imported when it is first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from getagrip.errors import UsageError

if TYPE_CHECKING:
    from getagrip.fitting.problem import MethodResult, Problem

OnStage = Callable[[str], None]
"""Called with the name of each stage when it ends."""
Fit = Callable[["Problem", OnStage], "MethodResult"]


@dataclass(frozen=True)
class Method:
    """A way to find an object in a hand."""

    label: str
    """What tables and pictures call it."""
    fit: Fit
    """Raises ``GetagripError`` where nothing can be rendered."""
    has_axis: bool = False
    """Whether its results have a latent axis."""
    baseline: bool = False
    """Whether it is another system's method, to compare with."""
    slow: bool = False
    """Whether it takes so long that benchmarks run it only where it is named."""
    checks_masks: bool = False
    """Whether it is fitted again without the masks that contradict the others (``outlier_masks``)."""
    as_published: bool = False
    """Whether it is left as its authors state it: nothing is done to its input."""


def method_of(name: str) -> Method:
    """The method of a name. Raises ``UsageError`` for one that is not in ``METHODS``."""
    if name not in METHODS:
        raise UsageError(f"unknown method {name!r}; choose from {', '.join(METHODS)}")
    return METHODS[name]


def _in(file: str, function: str = "fit") -> Fit:
    """A function of a file beside this one."""

    def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
        found: Fit = getattr(import_module(f"{__name__}.{file}"), function)
        return found(problem, on_stage)

    return fit


def _published(label: str, function: str, has_axis: bool = False) -> Method:
    """The paper's method to the letter."""
    return Method(label, _in("paper", function), has_axis, baseline=True, slow=True, as_published=True)


METHODS: dict[str, Method] = {
    "one-dof": Method("1-DoF, ours", _in("all_frames", "one_dof"), has_axis=True, checks_masks=True),
    "soft-hinge": Method("soft hinge", _in("all_frames", "soft_hinge"), has_axis=True, checks_masks=True),
    "static": Method("Static", _in("all_frames", "static")),
    "dynamic": Method("Dynamic", _in("all_frames", "dynamic")),
    "single-frame": Method("Single Frame", _in("single_frame"), baseline=True),
    "homan": Method("HOMan", _in("homan"), baseline=True),
    "contact-consistency": Method("contact consistency", _in("contact_consistency"), baseline=True),
    "paper": _published("1-DoF, the paper's", "fit", has_axis=True),
    "paper-static": _published("Static, the paper's", "static"),
    "paper-dynamic": _published("Dynamic, the paper's", "dynamic"),
}
OURS: Mapping[str, Method] = dict(METHODS)
"""Those of the package, whatever a script adds or puts in their places."""
