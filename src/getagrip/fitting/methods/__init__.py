"""Every method, by its name: ours, those after the paper's, the baselines, and the paper's own.

A method is a function from a ``Problem`` to a ``MethodResult``. A new one needs a file here and a line in ``METHODS``;
a script adds its own with ``METHODS["name"] = Method(...)``, a package with an entry point. Loading the table costs
nothing: a method's file is imported when it is first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from getagrip.errors import UsageError, unknown_choice_error
from getagrip.io.plugins import PluginTable

if TYPE_CHECKING:
    from getagrip.fitting.problem import MethodResult, Problem

OnStage = Callable[[str], None]
"""Called with the name of each stage when it ends."""
Fit = Callable[["Problem", OnStage], "MethodResult"]


@dataclass(frozen=True)
class Method:
    """A way to find an object in a hand."""

    label: str
    """Name in tables and pictures."""
    fit: Fit
    """Raises ``GetagripError`` where nothing can be rendered."""
    has_axis: bool = False
    """True if its results have a latent axis."""
    slow: bool = False
    """True if it is so slow that benchmarks run it only where it is named."""
    checks_masks: bool = False
    """True if it is fitted again without outlier masks (``stages.robust_masks``)."""
    as_published: bool = False
    """True if it stays as its authors state it: its input is not changed."""


def method_of(name: str) -> Method:
    """Return the method of a name. Raises ``UsageError`` for one that is not in ``METHODS``, or cannot be loaded."""
    if name not in METHODS:
        raise unknown_choice_error("method", name, METHODS)
    return METHODS[name]


def label_of(name: str) -> str:
    """Return the label of a method: its name where it is not installed here."""
    try:
        return method_of(name).label
    except UsageError:
        return name


def _lazy_fit(file: str, function: str = "fit") -> Fit:
    """Return a function of a file beside this one."""

    def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
        found: Fit = getattr(import_module(f"{__name__}.{file}"), function)
        return found(problem, on_stage)

    return fit


def _paper_method(label: str, function: str, has_axis: bool = False) -> Method:
    """Make one of the paper's methods, by its own energy and optimiser."""
    return Method(label, _lazy_fit("paper", function), has_axis, slow=True, as_published=True)


BUILTIN_METHODS: Mapping[str, Method] = {
    "one-dof": Method("1-DoF, ours", _lazy_fit("all_frames", "one_dof"), has_axis=True, checks_masks=True),
    "soft-hinge": Method("soft hinge", _lazy_fit("all_frames", "soft_hinge"), has_axis=True, checks_masks=True),
    "static": Method("Static", _lazy_fit("all_frames", "static")),
    "dynamic": Method("Dynamic", _lazy_fit("all_frames", "dynamic")),
    "single-frame": Method("Single Frame", _lazy_fit("single_frame")),
    "homan": Method("HOMan", _lazy_fit("homan")),
    "contact-consistency": Method("contact consistency", _lazy_fit("all_frames", "fit_contact_consistency")),
    "paper": _paper_method("1-DoF, the paper's", "fit", has_axis=True),
    "paper-static": _paper_method("Static, the paper's", "static"),
    "paper-dynamic": _paper_method("Dynamic, the paper's", "dynamic"),
    "paper-single-frame": _paper_method("Single Frame, the paper's", "single_frame"),
    "paper-homan": _paper_method("HOMan, by the paper's energy", "homan"),
}
"""Those of the package, whatever a script adds or puts in their places."""
METHODS = PluginTable("methods", dict(BUILTIN_METHODS), "a Method", lambda _, it: isinstance(it, Method))
