"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-22, commit c87133a with uncommitted changes.
"""

from getagrip.checks.calibration import Calibration, Weight

CALIBRATIONS: dict[str, Calibration] = {
    "soft-hinge": Calibration(
        weights={
            "energy-gap": Weight(3.193, 0.07689, 0.83666),
            "contact-gap": Weight(-1.7909, -4.8763, -1.6776),
            "mask-miss": Weight(-0.32188, -4.2007, -1.313),
            "off-axis-turn": Weight(-1.1718, -3.9787, -2.046),
            "hand-shift": Weight(-64.6, 0, 0.045663),
            "hand-turn": Weight(-7.5775, 3.613e-15, 0.28309),
            "hand-miss": Weight(-5.2844, 0, 0.14822),
        },
        bias=-10.076,
        data=(
            "362 results of training clips of DexYCB and synthetic, of which 80 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-22, commit c87133a with uncommitted changes",
    ),
}
"""By method."""
