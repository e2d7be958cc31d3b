"""Checks of inputs and results: each measures one quantity, and reports values beyond its limits.

``INPUT_CHECKS`` need the clip and its masks, ``RESULT_CHECKS`` the found poses, too. Limits were chosen on training
data (docs/checks.md). ``calibration`` turns the features of ``compute_features`` into a probability.
"""

from getagrip.checks.check import Check, run_checks
from getagrip.checks.evidence import Evidence
from getagrip.checks.features import compute_features
from getagrip.checks.results import SolvedEvidence
from getagrip.checks.table import INPUT_CHECKS, MIN_MEAN_IOU, RESULT_CHECKS, input_checks, result_checks

__all__ = [
    "INPUT_CHECKS",
    "MIN_MEAN_IOU",
    "RESULT_CHECKS",
    "Check",
    "Evidence",
    "SolvedEvidence",
    "compute_features",
    "input_checks",
    "result_checks",
    "run_checks",
]
