"""The calibrations in ``calibrated.json``: weights of the signs, and thresholds by kind of input.

A measured hand that its evidence turned far was solved with the object as an estimate is: it is *corrected*, and has a
calibration of its own.

``python -m benchmarks.probability`` and ``python -m benchmarks.kept`` write it.
"""

from __future__ import annotations

import json
from pathlib import Path

from getagrip.checks.calibration import Calibration, FeatureWeight, Where
from getagrip.checks.keeping import InputKind, KeepThresholds

CALIBRATION_FILE = Path(__file__).with_suffix(".json")
Calibrations = dict[tuple[str, Where], Calibration]
"""By method, and by where poses are right."""
Thresholds = dict[tuple[InputKind, Where], KeepThresholds]
"""By kind of input, and by where poses are right."""


def read_calibrations(file: Path) -> tuple[Calibrations, Calibrations, Calibrations, Thresholds]:
    """Read the calibrations for measured, for corrected and for estimated hands, and the thresholds."""
    stored = json.loads(file.read_text(encoding="utf-8"))
    measured, corrected, estimated = (
        {
            (method, one["where"]): Calibration(
                **one | {"weights": {name: FeatureWeight(*numbers) for name, numbers in one["weights"].items()}}
            )
            for method, each in stored[hands].items()
            for one in each
        }
        for hands in ("measured", "corrected", "estimated")
    )
    thresholds = {
        (one["input"], one["where"]): KeepThresholds(
            {float(share): p for share, p in one["least"].items()}, {int(size): p for size, p in one["sets"].items()}
        )
        for one in stored["keeping"]
    }
    return measured, corrected, estimated, thresholds


CALIBRATIONS, CORRECTED_CALIBRATIONS, ESTIMATED_CALIBRATIONS, KEEP_THRESHOLDS = read_calibrations(CALIBRATION_FILE)
