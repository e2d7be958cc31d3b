"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-23, commit 1e1b1c2.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.669, 0.069085, 0.83666),
            "solution-spread": Weight(-1.0233, -5.8091, -3.4077),
            "pose-spread": Weight(-1.1679, -3.8424, -1.1216),
            "mask-misfit": Weight(-0.54347, -0.50041, 1.9098),
            "mesh-deformation": Weight(-39.622, 0, 0.037261),
            "contact-gap": Weight(-1.0815, -4.9256, -1.6194),
            "off-axis-turn": Weight(-0.84971, -5.1324, -2.4307),
            "hand-shift": Weight(-89.146, 0, 0.054522),
            "hand-turn": Weight(-7.3582, 0, 0.18518),
        },
        bias=-13.532,
        data=(
            "690 results of training clips of DexYCB and synthetic, of which 82 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit 1e1b1c2",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(1.2075, 0.069085, 0.83666),
            "solution-spread": Weight(-0.88873, -5.8091, -3.4077),
            "pose-spread": Weight(-0.61878, -3.8424, -1.1216),
            "mask-misfit": Weight(-0.74282, -0.50041, 1.9098),
            "mesh-deformation": Weight(-40.083, 0, 0.037261),
            "contact-gap": Weight(-1.0163, -4.9256, -1.6194),
            "off-axis-turn": Weight(-0.63885, -5.1324, -2.4307),
            "hand-shift": Weight(-27.289, 0, 0.054522),
            "hand-turn": Weight(0, 0, 0.18518),
        },
        bias=-10.081,
        data=(
            "690 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit 1e1b1c2",
    ),
}
"""By method, and by where poses are right."""
