"""A check: what is measured, what is usual, how a value is shown; and how checks are run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from getagrip.checks.evidence import Evidence
from getagrip.io import plugins
from getagrip.result.findings import Finding

SUPERSEDED_BY = {
    "mesh-open": ("mesh-holes",),
    "frames-late": ("frame-order",),
    "tracker-glitches": ("many-tracker-glitches",),
    "other-size": ("wrong-size",),
    "outlier-masks": ("many-outlier-masks",),
    "mesh-deformed": ("mesh-much-deformed",),
    "pixel-stretch": ("principal-point",),
    "field-of-view": ("principal-point",),
    "mask-misfit": ("large-mask-misfit", "poor-mask-fit", "mask-fit"),
    "poor-mask-fit": ("mask-fit",),
    "uneven-mask-fit": ("mask-fit",),
}
"""Checks that are not reported where a more severe check, one of these, reports the same problem."""
OWN_MESH_ADVICE = "the shape is a guess: give the object's own mesh (draft, clip new: --object MESH)"
"""The advice of checks that another mesh would mend, where the mesh is a built-in shape."""
MAX_CHECK_VALUE = 1e9
"""JSON has no infinity."""


@dataclass(frozen=True)
class Check:
    """A number about a clip or its result, and the range in which it is nearly always when all is right."""

    name: str
    measure: Callable[[Evidence], float]
    """NaN where it cannot be known."""
    fault: str | Callable[[Evidence], str]
    """The fault beyond the limits: a text with the ``{value}`` as it is ``shown``, or a function of the evidence."""
    advice: str
    low: float = -np.inf
    high: float = np.inf
    serious: bool = True
    """True if the result is probably worthless; else it may be right."""
    shown: Callable[[float], str] = "{:.3g}".format
    """A value, and a limit, as people read it."""
    of_shape: bool = False
    """True if the object's own mesh would mend it, where the clip has a built-in shape."""

    @property
    def usual(self) -> str:
        """The range in words."""
        if np.isfinite(self.low) and np.isfinite(self.high):
            return f"{self.shown(self.low)} to {self.shown(self.high)}"
        return f"at least {self.shown(self.low)}" if np.isfinite(self.low) else f"at most {self.shown(self.high)}"

    def is_usual(self, value: float) -> bool:
        """Return whether a value is within the limits; so is one that is not known, NaN."""
        return bool(np.isnan(value) or self.low <= value <= self.high)

    def verdict(self, value: float) -> str:
        """Judge a measured value in a word or two."""
        if np.isnan(value):
            return "not applicable"
        return "usual" if self.is_usual(value) else "serious" if self.serious else "note"

    def finding(self, value: float, it: Evidence) -> Finding | None:
        """Return the finding about a measured value; None where it is usual."""
        if self.is_usual(value):
            return None
        limit, least = (self.low, "least") if value < self.low else (self.high, "most")
        fault = self.fault.format(value=self.shown(value)) if isinstance(self.fault, str) else self.fault(it)
        usual = f" (usual: at {least} {self.shown(limit)})" if limit else ""  # that there is usually none is plain
        advice = OWN_MESH_ADVICE if self.of_shape and it.shape_assumed else self.advice
        return Finding(self.name, self.serious, value, limit, f"{fault}{usual}; {advice}")


def run_checks(checks: Iterable[Check], it: Evidence) -> tuple[dict[str, float], tuple[Finding, ...]]:
    """Run checks: return the value of each, at most ``MAX_CHECK_VALUE`` in magnitude, and the findings.

    That one of another package has raised is a finding, too.
    """
    measured: dict[str, float] = {}
    found: list[Finding] = []
    for check in checks:
        try:
            with plugins.convert_base_exceptions():
                measured[check.name] = float(np.clip(check.measure(it), -MAX_CHECK_VALUE, MAX_CHECK_VALUE))
                finding = check.finding(measured[check.name], it)
        except Exception as error:
            if (plugin := plugins.plugin_of(check)) is None:
                raise
            measured[check.name] = np.nan
            message = f"{plugin} failed: {type(error).__name__}: {error}"
            finding = Finding(check.name, False, 0.0, 0.0, message)
        found += [] if finding is None else [finding]
    names = {finding.check for finding in found}
    return measured, tuple(f for f in found if names.isdisjoint(SUPERSEDED_BY.get(f.check, ())))


def format_percent(share: float) -> str:
    """Write a share in per cent."""
    return f"{100.0 * share:.3g} %"


def format_millimetres(length: float) -> str:
    """Write a length in millimetres."""
    return f"{length:.3g} mm"


def format_diameter_share(share: float) -> str:
    """Write a length as a share of the object's diameter."""
    return f"{format_percent(share)} of its diameter"
