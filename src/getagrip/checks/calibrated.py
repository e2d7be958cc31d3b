"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-23, commit 4062d70.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.4735, 0.085718, 0.83666),
            "solution-spread": Weight(-1.6466, -5.8091, -3.599),
            "pose-spread": Weight(-1.4498, -3.8462, -1.2955),
            "mask-misfit": Weight(-0.14501, -0.50143, 1.933),
            "mesh-deformation": Weight(-18.189, 0, 0.038392),
            "size-shift": Weight(-0.57607, -3.912, -1.1824),
            "contact-gap": Weight(-0.72372, -4.9711, -1.7252),
            "depth-order": Weight(-0.85365, -4.4665, -1.6112),
            "off-axis-turn": Weight(-0.81932, -5.1028, -2.5202),
            "hand-shift": Weight(-81.979, 0, 0.032532),
            "hand-turn": Weight(-8.3647, 0, 0.17665),
        },
        bias=-20.684,
        data=(
            "666 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit 4062d70",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(0.88508, 0.085718, 0.83666),
            "solution-spread": Weight(-1.3305, -5.8091, -3.599),
            "pose-spread": Weight(-0.48968, -3.8462, -1.2955),
            "mask-misfit": Weight(-0.31795, -0.50143, 1.933),
            "mesh-deformation": Weight(-35.735, 0, 0.038392),
            "size-shift": Weight(-0.95142, -3.912, -1.1824),
            "contact-gap": Weight(-0.63886, -4.9711, -1.7252),
            "depth-order": Weight(-0.65419, -4.4665, -1.6112),
            "off-axis-turn": Weight(-0.33903, -5.1028, -2.5202),
            "hand-shift": Weight(-30.404, 0, 0.032532),
            "hand-turn": Weight(0, 0, 0.17665),
        },
        bias=-14.545,
        data=(
            "666 results of training clips of DexYCB and synthetic, of which 87 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit 4062d70",
    ),
}
"""By method, and by where poses are right."""
