"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-22, commit 6aab682.
"""

from getagrip.checks.calibration import Calibration, Weight

CALIBRATIONS: dict[str, Calibration] = {
    "soft-hinge": Calibration(
        weights={
            "energy-gap": Weight(3.3983, 0.077522, 0.83666),
            "contact-gap": Weight(-1.6351, -4.8833, -1.6794),
            "mask-miss": Weight(-0.26784, -4.2004, -1.3232),
            "off-axis-turn": Weight(-1.1293, -3.9778, -2.0481),
            "hand-shift": Weight(-48.895, 0, 0.045228),
            "hand-turn": Weight(-7.281, 3.613e-15, 0.27926),
            "hand-miss": Weight(-5.9302, 0, 0.14815),
        },
        bias=-9.4614,
        data=(
            "372 results of training clips of DexYCB and synthetic, of which 79 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-22, commit 6aab682",
    ),
}
"""By method."""
