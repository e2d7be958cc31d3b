"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-24, commit 36f6275.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(2.0545, 0.072881, 0.83666),
            "solution-spread": Weight(-0.74787, -5.8091, -3.5346),
            "pose-spread": Weight(-1.332, -3.816, -1.5996),
            "mask-misfit": Weight(0, -0.50401, 1.7101),
            "mesh-deformation": Weight(-10.687, 0, 0.037714),
            "size-shift": Weight(-0.2283, -3.912, -1.4447),
            "contact-gap": Weight(-1.2952, -4.9492, -1.7348),
            "depth-order": Weight(-0.58828, -4.4654, -1.6472),
            "off-axis-turn": Weight(-0.94709, -4.2595, -2.0885),
            "hand-shift": Weight(-66.355, 0, 0.03247),
            "hand-turn": Weight(-13.88, 0, 0.1765),
        },
        bias=-15.954,
        data=(
            "669 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit 36f6275",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(1.4805, 0.072881, 0.83666),
            "solution-spread": Weight(-1.1209, -5.8091, -3.5346),
            "pose-spread": Weight(-0.56117, -3.816, -1.5996),
            "mask-misfit": Weight(0, -0.50401, 1.7101),
            "mesh-deformation": Weight(-43.713, 0, 0.037714),
            "size-shift": Weight(-0.78183, -3.912, -1.4447),
            "contact-gap": Weight(-1.3496, -4.9492, -1.7348),
            "depth-order": Weight(-0.54061, -4.4654, -1.6472),
            "off-axis-turn": Weight(-0.15251, -4.2595, -2.0885),
            "hand-shift": Weight(-10.476, 0, 0.03247),
            "hand-turn": Weight(-1.764, 0, 0.1765),
        },
        bias=-14.522,
        data=(
            "669 results of training clips of DexYCB and synthetic, of which 89 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit 36f6275",
    ),
}
"""By method, and by where poses are right."""
