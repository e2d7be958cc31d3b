"""The probability for estimated hands, and thresholds by kind of input; written by ``python -m benchmarks.kept``.

Made 2026-11-25, commit 472c0eab.
"""

from getagrip.checks.calibration import Calibration, Weight, Where
from getagrip.checks.keeping import InputKind, Keeping

ESTIMATED: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(0.53703, 0.3711, 0.83666),
            "solution-spread": Weight(-0.097319, -5.8091, -2.1976),
            "pose-spread": Weight(-0.46342, -3.7228, -1.6074),
            "mask-misfit": Weight(-5.1865, -0.49611, 0.18496),
            "contact-gap": Weight(-1.2696, -4.5295, -1.5145),
            "hand-turn": Weight(-0.79563, 0.0070498, 0.74671),
            "hand-spread": Weight(-3.941, -3.4827, -2.5002),
            "hand-misfit": Weight(-0.67365, -3.9988, -2.008),
            "penetration": Weight(-1.546, -4.314, -2.1522),
            "joint-error": Weight(-1.4421, -2.8489, -1.8326),
            "depth-images": Weight(0.26443, 0, 2),
        },
        bias=-28.06,
        data=(
            "76 results of 19 training clips of DexYCB with hands off as estimates are, with and "
            "without 2D joints and depth, of which 71 % are right"
        ),
        made="2026-11-25, commit 472c0eab",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(1.19, 0.3711, 0.83666),
            "solution-spread": Weight(-0.84349, -5.8091, -2.1976),
            "pose-spread": Weight(-1.1255, -3.7228, -1.6074),
            "mask-misfit": Weight(-2.838, -0.49611, 0.18496),
            "contact-gap": Weight(-0.54258, -4.5295, -1.5145),
            "hand-turn": Weight(0, 0.0070498, 0.74671),
            "hand-spread": Weight(-0.8403, -3.4827, -2.5002),
            "hand-misfit": Weight(0, -3.9988, -2.008),
            "penetration": Weight(0, -4.314, -2.1522),
            "joint-error": Weight(0, -2.8489, -1.8326),
            "depth-images": Weight(0.030548, 0, 2),
        },
        bias=-8.827,
        data=(
            "76 results of 19 training clips of DexYCB with hands off as estimates are, with and "
            "without 2D joints and depth, of which 96 % are right"
        ),
        made="2026-11-25, commit 472c0eab",
    ),
}
"""By method, and by where poses are right."""
KEEPING: dict[tuple[InputKind, Where], Keeping] = {
    ("measured", "hand"): Keeping(
        {0.5: 0.9679, 0.6: 0.9679, 0.7: 0.9679, 0.8: 0.9679, 0.9: 0.9679, 0.95: 0.9679}, {1: 0.9679}
    ),
    ("estimated", "hand"): Keeping({0.5: 0.166, 0.6: 0.2367, 0.7: 0.2499}, {}),
    ("joints", "hand"): Keeping({0.5: 0.0176, 0.6: 0.0176, 0.7: 0.0176, 0.8: 0.7273}, {}),
    ("depth", "hand"): Keeping(
        {0.5: 0.01111, 0.6: 0.01111, 0.7: 0.01111, 0.8: 0.01111, 0.9: 0.6373, 0.95: 0.8306}, {1: 0.6373}
    ),
    ("measured", "camera"): Keeping(
        {0.5: 0.9579, 0.6: 0.9579, 0.7: 0.9579, 0.8: 0.9579, 0.9: 0.9579, 0.95: 0.9579}, {1: 0.9579}
    ),
    ("estimated", "camera"): Keeping({0.5: 0.9367, 0.6: 0.9367, 0.7: 0.9367, 0.8: 0.9367}, {}),
    ("joints", "camera"): Keeping({0.5: 0.964, 0.6: 0.964, 0.7: 0.964, 0.8: 0.964}, {}),
    ("depth", "camera"): Keeping({0.5: 0.9849, 0.6: 0.9849, 0.7: 0.9849, 0.8: 0.9849, 0.9: 0.9849}, {1: 0.9849}),
}
"""By kind of input, and by where poses are right."""
