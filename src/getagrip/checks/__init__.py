"""Checks of inputs and results: each measures one thing, and reports values beyond its limits.

``INPUT_CHECKS`` need the clip and its masks, ``RESULT_CHECKS`` the poses that were found, too. Limits were chosen on
training data (docs/checks.md). ``read_signs`` is what ``CALIBRATIONS`` (``calibrated``) make a probability of.
"""

from getagrip.checks.check import Check, examine
from getagrip.checks.evidence import Evidence
from getagrip.checks.signs import read_signs
from getagrip.checks.solved import Solved
from getagrip.checks.table import INPUT_CHECKS, LEAST_IOU, RESULT_CHECKS, input_checks, result_checks

__all__ = [
    "INPUT_CHECKS",
    "LEAST_IOU",
    "RESULT_CHECKS",
    "Check",
    "Evidence",
    "Solved",
    "examine",
    "input_checks",
    "read_signs",
    "result_checks",
]
