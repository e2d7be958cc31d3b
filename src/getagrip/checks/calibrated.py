"""The weights of the signs; written by ``python -m benchmarks.probability``.

Made 2026-11-24, commit 5c95f27.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.6953, 0.10923, 0.83666),
            "solution-spread": Weight(-0.42459, -5.8091, -1.6654),
            "pose-spread": Weight(-1.3295, -3.8212, -1.5714),
            "mask-misfit": Weight(0, -0.50116, 1.7118),
            "mesh-deformation": Weight(-25.202, 0, 0.035813),
            "size-shift": Weight(-0.45896, -3.912, -1.3687),
            "contact-gap": Weight(-0.90333, -5.0007, -1.7791),
            "depth-order": Weight(-0.5978, -4.4526, -1.6141),
            "off-axis-turn": Weight(-0.97934, -4.2682, -2.0711),
            "hand-shift": Weight(-91.395, 0, 0.034669),
            "hand-turn": Weight(-12.24, 0, 0.17278),
        },
        bias=-13.41,
        data=(
            "669 results of training clips of DexYCB and synthetic, of which 85 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit 5c95f27",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(1.9135, 0.10923, 0.83666),
            "solution-spread": Weight(-0.29743, -5.8091, -1.6654),
            "pose-spread": Weight(-1.1088, -3.8212, -1.5714),
            "mask-misfit": Weight(-0.11148, -0.50116, 1.7118),
            "mesh-deformation": Weight(-34.515, 0, 0.035813),
            "size-shift": Weight(-0.82941, -3.912, -1.3687),
            "contact-gap": Weight(-1.0513, -5.0007, -1.7791),
            "depth-order": Weight(-0.32044, -4.4526, -1.6141),
            "off-axis-turn": Weight(-0.1708, -4.2682, -2.0711),
            "hand-shift": Weight(-36.727, 0, 0.034669),
            "hand-turn": Weight(0, 0, 0.17278),
        },
        bias=-10.352,
        data=(
            "669 results of training clips of DexYCB and synthetic, of which 90 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit 5c95f27",
    ),
}
"""By method, and by where poses are right."""
