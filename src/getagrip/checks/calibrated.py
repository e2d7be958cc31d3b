"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-22, commit 00d7492 with uncommitted changes.
"""

from getagrip.checks.calibration import Calibration, Weight

CALIBRATIONS: dict[str, Calibration] = {
    "soft-hinge": Calibration(
        weights={
            "energy-gap": Weight(3.5745, 0.083675, 0.83666),
            "contact-gap": Weight(-1.8658, -4.8795, -1.6701),
            "mask-miss": Weight(-0.30168, -4.2018, -1.2706),
            "off-axis-turn": Weight(-1.1678, -3.9824, -2.33),
        },
        bias=-10.606,
        data=(
            "320 results of training clips of DexYCB and synthetic, of which 84 % are right, with right"
            " inputs and with errors of hands, masks, size and shape"
        ),
        made="2026-11-22, commit 00d7492 with uncommitted changes",
    ),
}
"""By method."""
