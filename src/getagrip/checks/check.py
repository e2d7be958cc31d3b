"""A check: the measured quantity, its usual range, its messages; and running checks."""

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
"""Checks that are not reported where one of these, more severe, reports the same problem."""
OWN_MESH_ADVICE = "the shape is a guess: give the object's own mesh (draft, clip new: --object MESH)"
"""Advice of checks ``of_shape`` where the mesh is a built-in shape."""
MAX_CHECK_VALUE = 1e9
"""Maximum magnitude of a stored value, since JSON has no infinity."""


@dataclass(frozen=True)
class Check:
    """A number about a clip or its result, and its usual range.

    Attributes:
        name: name of the check.
        measure: the number; NaN where it cannot be known.
        fault: the fault beyond the limits: a text with the ``{value}`` as ``shown``, or a function of the evidence.
        advice: what to do about the fault.
        low: lower limit.
        high: upper limit.
        serious: True if the result is probably worthless; False if it may be right.
        shown: format of values and limits in messages.
        of_shape: True if the object's own mesh, in place of a built-in shape, would remove the fault.
        of_distance: True if the fault may be the distance between hand and object alone. Beside a hand that was lifted
            from 2D joints, whose distance is uncertain, it is never serious: the probability weighs it.
        low_where_met_less: lower limit where masks may be met less (``Evidence.met_less``); None: ``low``. The measure
            is NaN above it.
    """

    name: str
    measure: Callable[[Evidence], float]
    fault: str | Callable[[Evidence], str]
    advice: str
    low: float = -np.inf
    high: float = np.inf
    serious: bool = True
    shown: Callable[[float], str] = "{:.3g}".format
    of_shape: bool = False
    of_distance: bool = False
    low_where_met_less: float | None = None

    @property
    def usual(self) -> str:
        """The usual range in words."""
        if np.isfinite(self.low) and np.isfinite(self.high):
            return f"{self.shown(self.low)} to {self.shown(self.high)}"
        return f"at least {self.shown(self.low)}" if np.isfinite(self.low) else f"at most {self.shown(self.high)}"

    def is_usual(self, value: float) -> bool:
        """Return whether a value is within the limits, or unknown (NaN)."""
        return bool(np.isnan(value) or self.low <= value <= self.high)

    def verdict(self, value: float) -> str:
        """Judge a measured value: "usual", "note", "serious" or "not applicable"."""
        if np.isnan(value):
            return "not applicable"
        return "usual" if self.is_usual(value) else "serious" if self.serious else "note"

    def is_serious(self, it: Evidence) -> bool:
        """Return whether the fault makes this result worthless."""
        return self.serious and not (self.of_distance and it.hand_lifted)

    def finding(self, value: float, it: Evidence) -> Finding | None:
        """Return the finding about a measured value; None for usual values."""
        if self.is_usual(value):
            return None
        low = self.low if self.low_where_met_less is None or not it.met_less else self.low_where_met_less
        limit, least = (low, "least") if value < self.low else (self.high, "most")
        fault = self.fault.format(value=self.shown(value)) if isinstance(self.fault, str) else self.fault(it)
        usual = f" (usual: at {least} {self.shown(limit)})" if limit else ""  # a limit of 0 is obvious
        advice = OWN_MESH_ADVICE if self.of_shape and it.shape_assumed else self.advice
        return Finding(self.name, self.is_serious(it), value, limit, f"{fault}{usual}; {advice}")


def run_checks(checks: Iterable[Check], it: Evidence) -> tuple[dict[str, float], tuple[Finding, ...]]:
    """Run checks: return the value of each, up to ``MAX_CHECK_VALUE`` in magnitude, and the findings.

    A check of a plug-in that raises is a finding, too.
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
            finding = Finding(check.name, False, 0.0, 0.0, f"{plugin} failed: {type(error).__name__}: {error}")
        found += [] if finding is None else [finding]
    names = {finding.check for finding in found}
    return measured, tuple(f for f in found if names.isdisjoint(SUPERSEDED_BY.get(f.check, ())))


def format_percent(share: float) -> str:
    """Write a fraction in per cent."""
    return f"{100.0 * share:.3g} %"


def format_millimetres(length: float) -> str:
    """Write a length in millimetres."""
    return f"{length:.3g} mm"


def format_diameter_share(share: float) -> str:
    """Write a length, given in object diameters, as per cent of the diameter."""
    return f"{format_percent(share)} of its diameter"
