"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-22, commit cd93e56.
"""

from getagrip.checks.calibration import Calibration, Weight

CALIBRATIONS: dict[str, Calibration] = {
    "soft-hinge": Calibration(
        weights={
            "energy-gap": Weight(3.487, 0.073892, 0.83666),
            "contact-gap": Weight(-0.89819, -4.914, -1.6695),
            "pose-spread": Weight(0, -5, 0),
            "off-axis-turn": Weight(0, -5.1751, -2.473),
            "hand-shift": Weight(-69.058, 0, 0.046022),
            "hand-turn": Weight(-6.3077, 0, 0.18425),
            "mask-misfit": Weight(0, 0, 1),
            "solution-spread": Weight(0, -5, 0),
        },
        bias=-4.5403,
        data=(
            "690 results of training clips of DexYCB and synthetic, of which 79 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-22, commit cd93e56",
    ),
}
"""By method."""
