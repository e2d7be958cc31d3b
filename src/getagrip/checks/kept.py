"""The probability for estimated hands, and thresholds by kind of input; written by ``python -m benchmarks.kept``.

Made 2026-11-26, commit a7a098b8.
"""

from getagrip.checks.calibration import Calibration, Weight, Where
from getagrip.checks.keeping import InputKind, Keeping

ESTIMATED: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(0, 0.17624, 0.83666),
            "solution-spread": Weight(-0.7368, -5.8091, -2.1696),
            "pose-spread": Weight(0, -3.7991, -1.8759),
            "mask-misfit": Weight(-1.4787, -0.47685, 0.51336),
            "contact-gap": Weight(-1.1943, -4.5016, -1.6914),
            "hand-turn": Weight(-0.5061, 0.010303, 0.81021),
            "hand-spread": Weight(-3.8907, -3.4762, -2.561),
            "hand-misfit": Weight(-1.8706, -3.7, -1.7422),
            "penetration": Weight(0, -4.2289, -1.9204),
            "joint-error": Weight(-0.75171, -2.8809, -1.8326),
            "depth-images": Weight(0.17235, 0, 2),
        },
        bias=-25.486,
        data=(
            "395 results of 52 training clips of DexYCB with hands off as estimates are, with and "
            "without 2D joints and depth, of which 76 % are right"
        ),
        made="2026-11-26, commit a7a098b8",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(0.20712, 0.17624, 0.83666),
            "solution-spread": Weight(-0.42389, -5.8091, -2.1696),
            "pose-spread": Weight(-0.40597, -3.7991, -1.8759),
            "mask-misfit": Weight(-9.5164, -0.47685, 0.51336),
            "contact-gap": Weight(-1.702, -4.5016, -1.6914),
            "hand-turn": Weight(0, 0.010303, 0.81021),
            "hand-spread": Weight(-1.3053, -3.4762, -2.561),
            "hand-misfit": Weight(-0.93644, -3.7, -1.7422),
            "penetration": Weight(-0.36781, -4.2289, -1.9204),
            "joint-error": Weight(-0.081452, -2.8809, -1.8326),
            "depth-images": Weight(0, 0, 2),
        },
        bias=-14.395,
        data=(
            "395 results of 52 training clips of DexYCB with hands off as estimates are, with and "
            "without 2D joints and depth, of which 92 % are right"
        ),
        made="2026-11-26, commit a7a098b8",
    ),
}
"""By method, and by where poses are right."""
KEEPING: dict[tuple[InputKind, Where], Keeping] = {
    ("measured", "hand"): Keeping({0.5: 0.5, 0.6: 0.6, 0.7: 0.7, 0.8: 0.8, 0.9: 0.9, 0.95: 0.95, 0.98: 0.98}, {1: 0.9}),
    ("estimated", "hand"): Keeping(
        {0.5: 0.02801, 0.6: 0.02801, 0.7: 0.308, 0.8: 0.6088, 0.9: 0.7745, 0.95: 0.9238}, {1: 0.7745}
    ),
    ("joints", "hand"): Keeping(
        {0.5: 0.0006908, 0.6: 0.0006908, 0.7: 0.0006908, 0.8: 0.1394, 0.9: 0.7453, 0.95: 0.9221}, {1: 0.7453}
    ),
    ("depth", "hand"): Keeping(
        {0.5: 0.02777, 0.6: 0.02777, 0.7: 0.02777, 0.8: 0.02777, 0.9: 0.5385, 0.95: 0.9005, 0.98: 0.9428}, {1: 0.5385}
    ),
    ("measured", "camera"): Keeping(
        {0.5: 0.5, 0.6: 0.6, 0.7: 0.7, 0.8: 0.8, 0.9: 0.9, 0.95: 0.95, 0.98: 0.98}, {1: 0.9}
    ),
    ("estimated", "camera"): Keeping(
        {0.5: 0.0001491, 0.6: 0.0001491, 0.7: 0.0001491, 0.8: 0.0001491, 0.9: 0.2192, 0.95: 0.5468, 0.98: 0.853},
        {1: 0.2192},
    ),
    ("joints", "camera"): Keeping(
        {0.5: 0.0007198, 0.6: 0.0007198, 0.7: 0.0007198, 0.8: 0.0007198, 0.9: 0.004114, 0.95: 0.6879, 0.98: 0.982},
        {1: 0.004114},
    ),
    ("depth", "camera"): Keeping(
        {0.5: 0.01929, 0.6: 0.01929, 0.7: 0.01929, 0.8: 0.01929, 0.9: 0.01929, 0.95: 0.0907, 0.98: 0.8611}, {1: 0.01929}
    ),
}
"""By kind of input, and by where poses are right."""
