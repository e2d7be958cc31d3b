"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-22, commit 4c41c47 with uncommitted changes.
"""

from getagrip.checks.calibration import Calibration, Weight

CALIBRATIONS: dict[str, Calibration] = {
    "soft-hinge": Calibration(
        weights={
            "energy-gap": Weight(3.4206, 0.076131, 0.83666),
            "contact-gap": Weight(-1.7651, -4.8772, -1.6755),
            "mask-miss": Weight(-0.34074, -4.201, -1.3009),
            "off-axis-turn": Weight(-1.2724, -3.9798, -2.0434),
            "hand-shift": Weight(-67.255, 0, 0.043335),
            "hand-turn": Weight(-7.1426, 3.613e-15, 0.2378),
        },
        bias=-10.566,
        data=(
            "350 results of training clips of DexYCB and synthetic, of which 81 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-22, commit 4c41c47 with uncommitted changes",
    ),
}
"""By method."""
