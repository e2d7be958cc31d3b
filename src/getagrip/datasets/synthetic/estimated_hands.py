"""How far hands estimated from images are off; written by ``python -m benchmarks.hand_errors measure``.

Measured 2026-11-22, commit ed3e31a:
ARCTIC's s05, 102 hands in grasps of both hands, 3000 frames.
The estimates are of images of fixed cameras, in ArtiGrasp's repository (``datasets/artigrasp_estimated``).
"""

ESTIMATED = {
    "hand_bias_deg": 15.3,
    "hand_bias_mm": 15.6,
    "hand_bias_depth_mm": 17.2,
    "finger_bias_deg": 11.7,
    "hand_jitter_deg": 6.77,
    "hand_jitter_mm": 10.1,
    "hand_jitter_depth_mm": 5.81,
    "finger_jitter_deg": 6.01,
    "jitter_memory_s": 0.359,
    "spread": 0.589,
    "outlier_share": 0.0743,
    "outlier_times": 3.71,
    "outlier_s": 0.0941,
}
"""Fields of ``Noise``: errors drawn for clips of the same lengths have these measures (fingers: joints as far off)."""
MEASURED = {
    "turn_bias": 0.292,
    "turn_jitter": 0.0833,
    "across_bias": 0.0142,
    "across_jitter": 0.00584,
    "depth_bias": 0.0189,
    "depth_jitter": 0.0067,
    "finger_bias": 0.295,
    "finger_jitter": 0.0957,
    "memory": 0.107,
    "spread": 0.623,
    "outlier_share": 0.0743,
    "outlier_times": 3.71,
    "outlier_s": 0.0941,
    "aligned": 0.00962,
}
"""``error_curves.measure`` of the estimates, and their joints' error after the best similarity; SI units."""
LENGTHS = [20, 22, 23, 25, 26, 28, 30, 31, 34, 49]
"""Frames of these grasps: 5, 15, ..., 95 % are shorter."""
