"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-22, commit 00fde85.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.7779, 0.073892, 0.83666),
            "solution-spread": Weight(-0.8043, -5.8091, -3.2929),
            "pose-spread": Weight(-1.1594, -3.8424, -1.1206),
            "mask-misfit": Weight(-0.68132, -0.49544, 2.2988),
            "contact-gap": Weight(-0.76022, -4.914, -1.6683),
            "off-axis-turn": Weight(-0.42808, -5.1751, -2.4767),
            "hand-shift": Weight(-58.619, 0, 0.046022),
            "hand-turn": Weight(-4.7928, 0, 0.18425),
        },
        bias=-10.205,
        data=(
            "690 results of training clips of DexYCB and synthetic, of which 79 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-22, commit 00fde85",
    ),
}
"""By method, and by where poses are right."""
