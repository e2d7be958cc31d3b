"""The probability for estimated hands, and the thresholds of all kinds; written by ``python -m benchmarks.kept``.

Made 2026-11-25, commit e3858339.
"""

from getagrip.checks.calibration import Calibration, Weight, Where
from getagrip.checks.keeping import InputKind, Keeping

ESTIMATED: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.9914, 0.25942, 0.83666),
            "solution-spread": Weight(-0.47182, -5.8091, -3.3314),
            "pose-spread": Weight(0, -3.3877, -1.7701),
            "mask-misfit": Weight(-4.0531, 0.19866, 0.8208),
            "size-shift": Weight(-0.14771, -3.912, -1.6156),
            "contact-gap": Weight(-0.76429, -4.309, -1.9437),
            "depth-order": Weight(-1.0138, -3.9895, -1.3451),
            "off-axis-turn": Weight(-0.051108, -3.8885, -2.4592),
            "hand-shift": Weight(0, 0.001067, 0.14979),
            "hand-turn": Weight(-0.5667, 0.0082065, 0.69707),
            "hand-spread": Weight(-0.9679, -3.6073, -2.6949),
            "hand-misfit": Weight(-0.43935, -3.4788, -1.6972),
        },
        bias=-11.509,
        data=(
            "46 results of training clips of DexYCB with hands off as estimates are, with and without "
            "2D joints, of which 59 % are right"
        ),
        made="2026-11-25, commit e3858339",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(2.986, 0.25942, 0.83666),
            "solution-spread": Weight(-0.92615, -5.8091, -3.3314),
            "pose-spread": Weight(-0.33958, -3.3877, -1.7701),
            "mask-misfit": Weight(-2.0362, 0.19866, 0.8208),
            "size-shift": Weight(-0.65101, -3.912, -1.6156),
            "contact-gap": Weight(-0.47902, -4.309, -1.9437),
            "depth-order": Weight(0, -3.9895, -1.3451),
            "off-axis-turn": Weight(-0.41784, -3.8885, -2.4592),
            "hand-shift": Weight(-20.073, 0.001067, 0.14979),
            "hand-turn": Weight(0, 0.0082065, 0.69707),
            "hand-spread": Weight(-0.12119, -3.6073, -2.6949),
            "hand-misfit": Weight(-1.3256, -3.4788, -1.6972),
        },
        bias=-12.615,
        data=(
            "46 results of training clips of DexYCB with hands off as estimates are, with and without "
            "2D joints, of which 83 % are right"
        ),
        made="2026-11-25, commit e3858339",
    ),
}
"""By method, and by where poses are right."""
KEEPING: dict[tuple[InputKind, Where], Keeping] = {
    ("measured", "hand"): Keeping(
        {0.5: 0.9679, 0.6: 0.9679, 0.7: 0.9679, 0.8: 0.9679, 0.9: 0.9679, 0.95: 0.9679}, {1: 0.9679}
    ),
    ("estimated", "hand"): Keeping({0.5: 0.01371, 0.6: 0.0442, 0.7: 0.4507, 0.8: 0.6211}, {}),
    ("joints", "hand"): Keeping({}, {}),
    ("depth", "hand"): Keeping({}, {}),
    ("measured", "camera"): Keeping(
        {0.5: 0.9579, 0.6: 0.9579, 0.7: 0.9579, 0.8: 0.9579, 0.9: 0.9579, 0.95: 0.9579}, {1: 0.9579}
    ),
    ("estimated", "camera"): Keeping({}, {}),
    ("joints", "camera"): Keeping({}, {}),
    ("depth", "camera"): Keeping({}, {}),
}
"""By kind of input, and by where poses are right."""
