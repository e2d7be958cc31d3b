"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-23, commit 6801a2e.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.2886, 0.06818, 0.83666),
            "solution-spread": Weight(-1.1956, -5.8091, -3.3811),
            "pose-spread": Weight(-1.3825, -3.8424, -1.1748),
            "mask-misfit": Weight(-0.47014, -0.50041, 1.9762),
            "mesh-deformation": Weight(-7.1374, 0, 0.037261),
            "contact-gap": Weight(-0.94425, -4.9506, -1.6467),
            "off-axis-turn": Weight(-0.75618, -5.1324, -2.4835),
            "hand-shift": Weight(-92.068, 0, 0.054522),
            "hand-turn": Weight(-7.9669, 0, 0.18518),
        },
        bias=-14.03,
        data=(
            "690 results of training clips of DexYCB and synthetic, of which 83 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit 6801a2e",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(0.59799, 0.06818, 0.83666),
            "solution-spread": Weight(-1.0956, -5.8091, -3.3811),
            "pose-spread": Weight(-0.77269, -3.8424, -1.1748),
            "mask-misfit": Weight(-0.63087, -0.50041, 1.9762),
            "mesh-deformation": Weight(-11.498, 0, 0.037261),
            "contact-gap": Weight(-0.85067, -4.9506, -1.6467),
            "off-axis-turn": Weight(-0.4874, -5.1324, -2.4835),
            "hand-shift": Weight(-30.979, 0, 0.054522),
            "hand-turn": Weight(-0.26659, 0, 0.18518),
        },
        bias=-10.205,
        data=(
            "690 results of training clips of DexYCB and synthetic, of which 86 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-23, commit 6801a2e",
    ),
}
"""By method, and by where poses are right."""
