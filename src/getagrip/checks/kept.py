"""The probability for estimated hands, and the thresholds of all kinds; written by ``python -m benchmarks.kept``."""

from getagrip.checks.calibration import Calibration, Where
from getagrip.checks.keeping import Keeping, Kind

ESTIMATED: dict[tuple[str, Where], Calibration] = {}
"""By method, and by where poses are right."""
KEEPING: dict[tuple[Kind, Where], Keeping] = {}
"""By kind of input, and by where poses are right."""
