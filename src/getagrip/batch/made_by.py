"""Which software makes a result with a method: one from outside the package brings its own code."""

from __future__ import annotations

from getagrip.fitting.methods import OURS, Method, method_of
from getagrip.io import own_code
from getagrip.result import software

KEY = "method_code"
"""Of a record's ``software``: the checksum of a method from outside."""
UNKNOWN = "unknown"
"""The checksum of a method whose source cannot be found: its results are never kept."""

_CHECKSUMS: dict[str, tuple[Method, str]] = {}
"""Of methods from outside, as their files were when they were first asked for: what changes later does not run here."""


def made_by(method: str, *also: str) -> dict[str, str]:
    """``result.software``, and of a method that is not the package's own a checksum of its code (``io.own_code``)."""
    there = method_of(method)
    if there is OURS.get(method):
        return software(*also)
    known, code = _CHECKSUMS.get(method, (None, ""))
    if known is not there:
        try:
            code = own_code.checksum((there.fit, there.has_axis, there.checks_masks, there.as_published))
        except own_code.UnknownSourceError:
            code = UNKNOWN
        _CHECKSUMS[method] = there, code
    return software(*also) | {KEY: code}
