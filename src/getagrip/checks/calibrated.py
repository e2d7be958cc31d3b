"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-23, commit d491815.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(2.2987, 0.081878, 0.83666),
            "solution-spread": Weight(-1.4071, -5.8091, -3.4531),
            "pose-spread": Weight(-1.5897, -3.8208, -1.1273),
            "mask-misfit": Weight(-0.38111, -0.50122, 1.9048),
            "mesh-deformation": Weight(-30.124, 0, 0.03764),
            "contact-gap": Weight(-0.60445, -4.9467, -1.6476),
            "depth-order": Weight(-0.81338, -4.4647, -1.6056),
            "off-axis-turn": Weight(-1.0411, -5.1014, -2.4558),
            "hand-shift": Weight(-52.992, 0, 0.040675),
            "hand-turn": Weight(-7.3358, 0, 0.182),
        },
        bias=-18.755,
        data=(
            "671 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit d491815",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(2.2439, 0.081878, 0.83666),
            "solution-spread": Weight(-0.82202, -5.8091, -3.4531),
            "pose-spread": Weight(-0.9003, -3.8208, -1.1273),
            "mask-misfit": Weight(-0.53642, -0.50122, 1.9048),
            "mesh-deformation": Weight(-35.556, 0, 0.03764),
            "contact-gap": Weight(-0.56922, -4.9467, -1.6476),
            "depth-order": Weight(-0.6211, -4.4647, -1.6056),
            "off-axis-turn": Weight(-0.72663, -5.1014, -2.4558),
            "hand-shift": Weight(-33.055, 0, 0.040675),
            "hand-turn": Weight(-0.79472, 0, 0.182),
        },
        bias=-11.843,
        data=(
            "671 results of training clips of DexYCB and synthetic, of which 86 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit d491815",
    ),
}
"""By method, and by where poses are right."""
