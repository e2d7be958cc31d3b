"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-24, commit ebe23da.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(2.0125, 0.083491, 0.83666),
            "solution-spread": Weight(-0.74568, -5.8091, -3.6439),
            "pose-spread": Weight(-1.4147, -3.8138, -1.4861),
            "mask-misfit": Weight(0, -0.49948, 1.7095),
            "mesh-deformation": Weight(-15.03, 0, 0.03744),
            "size-shift": Weight(-0.26467, -3.912, -1.406),
            "contact-gap": Weight(-1.1233, -4.9572, -1.7398),
            "depth-order": Weight(-0.61986, -4.4647, -1.6157),
            "off-axis-turn": Weight(-1.1566, -4.2594, -2.0577),
            "hand-shift": Weight(-77.755, 0, 0.034418),
            "hand-turn": Weight(-10.8, 0, 0.17737),
        },
        bias=-16.549,
        data=(
            "671 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit ebe23da",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(1.2681, 0.083491, 0.83666),
            "solution-spread": Weight(-1.0265, -5.8091, -3.6439),
            "pose-spread": Weight(-0.73982, -3.8138, -1.4861),
            "mask-misfit": Weight(0, -0.49948, 1.7095),
            "mesh-deformation": Weight(-42.386, 0, 0.03744),
            "size-shift": Weight(-0.62945, -3.912, -1.406),
            "contact-gap": Weight(-1.1709, -4.9572, -1.7398),
            "depth-order": Weight(-0.66094, -4.4647, -1.6157),
            "off-axis-turn": Weight(0, -4.2594, -2.0577),
            "hand-shift": Weight(-25.165, 0, 0.034418),
            "hand-turn": Weight(0, 0, 0.17737),
        },
        bias=-13.372,
        data=(
            "671 results of training clips of DexYCB and synthetic, of which 88 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit ebe23da",
    ),
}
"""By method, and by where poses are right."""
