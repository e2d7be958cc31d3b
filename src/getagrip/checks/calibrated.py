"""What signs count; written by ``python -m benchmarks.probability``.

Made 2026-11-24, commit b491d1d.
"""

from getagrip.checks.calibration import Calibration, Weight, Where

CALIBRATIONS: dict[tuple[str, Where], Calibration] = {
    ("soft-hinge", "hand"): Calibration(
        where="hand",
        weights={
            "energy-gap": Weight(1.7305, 0.10334, 0.83666),
            "solution-spread": Weight(-0.40855, -5.8091, -1.6186),
            "pose-spread": Weight(-1.2686, -3.8198, -1.572),
            "mask-misfit": Weight(0, -0.50107, 1.7118),
            "mesh-deformation": Weight(-23.016, 0, 0.035809),
            "size-shift": Weight(-0.49164, -3.912, -1.3695),
            "contact-gap": Weight(-0.97471, -5.0006, -1.7796),
            "depth-order": Weight(-0.70404, -4.4523, -1.5763),
            "off-axis-turn": Weight(-0.77003, -4.2682, -2.0712),
            "hand-shift": Weight(-101.03, 0, 0.034086),
            "hand-turn": Weight(-11.195, 0, 0.17261),
        },
        bias=-13.282,
        data=(
            "670 results of training clips of DexYCB and synthetic, of which 84 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit b491d1d",
    ),
    ("soft-hinge", "camera"): Calibration(
        where="camera",
        weights={
            "energy-gap": Weight(2.0135, 0.10334, 0.83666),
            "solution-spread": Weight(-0.29571, -5.8091, -1.6186),
            "pose-spread": Weight(-1.1108, -3.8198, -1.572),
            "mask-misfit": Weight(-0.0441, -0.50107, 1.7118),
            "mesh-deformation": Weight(-38.111, 0, 0.035809),
            "size-shift": Weight(-0.82834, -3.912, -1.3695),
            "contact-gap": Weight(-1.0833, -5.0006, -1.7796),
            "depth-order": Weight(-0.296, -4.4523, -1.5763),
            "off-axis-turn": Weight(-0.23587, -4.2682, -2.0712),
            "hand-shift": Weight(-37.282, 0, 0.034086),
            "hand-turn": Weight(0, 0, 0.17261),
        },
        bias=-10.629,
        data=(
            "670 results of training clips of DexYCB and synthetic, of which 90 % are right: right "
            "inputs, and errors of hands, masks, size and shape"
        ),
        made="2026-11-24, commit b491d1d",
    ),
}
"""By method, and by where poses are right."""
