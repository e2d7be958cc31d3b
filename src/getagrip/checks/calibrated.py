"""What signs count; written by ``python -m benchmarks.probability``."""

from getagrip.checks.calibration import Calibration

CALIBRATIONS: dict[str, Calibration] = {}
