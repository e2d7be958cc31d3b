"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-24, commit 501ee4b.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.655, 0.10105, 0.83666),
            "solution-spread": Weight(-0.56531, -5.8091, -1.5459),
            "pose-spread": Weight(-1.5838, -3.8178, -1.5961),
            "mask-misfit": Weight(0, -0.50401, 1.7087),
            "mesh-deformation": Weight(-25.322, 0, 0.035921),
            "size-shift": Weight(-0.343, -3.912, -1.4216),
            "contact-gap": Weight(-1.2489, -4.9577, -1.7791),
            "depth-order": Weight(-0.63339, -4.4654, -1.6173),
            "off-axis-turn": Weight(-1.0509, -4.2595, -2.0311),
            "hand-shift": Weight(-84.868, 0, 0.034669),
            "hand-turn": Weight(-15.108, 0, 0.17473),
        },
        bias=-15.738,
        data=(
            "669 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit 501ee4b",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(1.0477, 0.10105, 0.83666),
            "solution-spread": Weight(-0.60128, -5.8091, -1.5459),
            "pose-spread": Weight(-0.67382, -3.8178, -1.5961),
            "mask-misfit": Weight(0, -0.50401, 1.7087),
            "mesh-deformation": Weight(-41.817, 0, 0.035921),
            "size-shift": Weight(-0.73233, -3.912, -1.4216),
            "contact-gap": Weight(-1.399, -4.9577, -1.7791),
            "depth-order": Weight(-0.47918, -4.4654, -1.6173),
            "off-axis-turn": Weight(0, -4.2595, -2.0311),
            "hand-shift": Weight(-31.008, 0, 0.034669),
            "hand-turn": Weight(0, 0, 0.17473),
        },
        bias=-10.881,
        data=(
            "669 results of training clips of DexYCB and synthetic, of which 89 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit 501ee4b",
    ),
}
"""By method, and by where poses are right."""
