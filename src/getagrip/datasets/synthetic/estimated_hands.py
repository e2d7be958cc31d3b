"""How far hands estimated from images are off; written by ``python -m benchmarks.hand_errors measure``.

Measured 2026-11-22, commit 71a6ebc:
ARCTIC's s05, 152 hands in grasps of both hands, 4482 frames.
The estimates are of images of fixed cameras, in ArtiGrasp's repository (``scripts/convert/artigrasp.py``).
"""

ESTIMATED = {
    "hand_bias_deg": 14.2,
    "hand_bias_mm": 14.0,
    "hand_bias_depth_mm": 15.9,
    "finger_bias_deg": 11.2,
    "hand_jitter_deg": 7.67,
    "hand_jitter_mm": 11.2,
    "hand_jitter_depth_mm": 6.95,
    "finger_jitter_deg": 6.82,
    "jitter_memory_s": 0.454,
    "spread": 0.574,
    "outlier_share": 0.0765,
    "outlier_times": 3.7,
    "outlier_s": 0.1,
}
"""Fields of ``Noise``: errors drawn for clips of the same lengths have these measures (fingers: joints as far off)."""
MEASURED = {
    "turn_bias": 0.278,
    "turn_jitter": 0.0896,
    "across_bias": 0.0131,
    "across_jitter": 0.00593,
    "depth_bias": 0.0178,
    "depth_jitter": 0.00734,
    "finger_bias": 0.285,
    "finger_jitter": 0.101,
    "memory": 0.111,
    "spread": 0.613,
    "outlier_share": 0.0765,
    "outlier_times": 3.7,
    "outlier_s": 0.1,
    "aligned": 0.00971,
}
"""``error_curves.measure`` of the estimates, and their joints' error after the best similarity; SI units."""
LENGTHS = [20, 21, 23, 25, 27, 29, 30, 32, 35, 47]
"""Frames of these grasps: 5, 15, ..., 95 % are shorter."""
