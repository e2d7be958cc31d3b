"""A synthetic clip with ground truth: make it, reconstruct it, evaluate the result, draw a report.

    python examples/01_synthetic_clip.py [OUT]

Writes OUT/report.png (out/ by default). The first run takes longer: numba compiles the kernels once and caches them.
"""

import sys
from pathlib import Path

import getagrip

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
out.mkdir(parents=True, exist_ok=True)

# A generic hand holds a mug in front of a moving camera. The clip holds hand poses, camera, mesh and ground truth;
# the masks say in which pixels the object is visible. Other categories, noise and a left hand are options.
clip, masks = getagrip.synthesise("mug", seed=0)

# The search starts from 50 rotations by default. The same seed gives the same result.
options = getagrip.Options(method="soft-hinge", inits=50, seed=0)
result = getagrip.reconstruct(clip, masks, options, progress=lambda stage, done: print(f"{done:4.0%}  {stage}"))
print(f"{result.message}; mask IOU {result.iou.mean():.3f}; {result.seconds['total']:.1f} s")
if result.ambiguous:
    print("another pose explains the masks almost as well; see result.candidates")

# All metrics, in the units that their names end in. The synthetic clip has ground truth, so pose errors are among them.
metrics = getagrip.evaluate(result, clip, masks).metrics
for name in ("iou", "add_mm", "rotation_deg", "translation_mm", "penetration_object_mm"):
    print(f"{name:>24} {metrics[name]:7.2f}")

print(getagrip.write_report(result, clip, masks, out / "report.png", metrics))
