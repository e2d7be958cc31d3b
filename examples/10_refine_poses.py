"""Another system's poses: evaluate them as our own results, then refine them by a fit that starts from them.

    python examples/10_refine_poses.py [OUT]

Writes OUT/theirs.npz and OUT/refined.npz (out/refine by default). `getagrip refine` does it for many clips, and keeps
the format of the file; docs/metrics.md lists the formats that are read.
"""

import sys
from pathlib import Path

import numpy as np

import getagrip
from getagrip.fitting.options import PriorsFile
from getagrip.geometry import se3
from getagrip.metrics.evaluate.external import read_external_poses

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/refine")
out.mkdir(parents=True, exist_ok=True)
clip, masks = getagrip.synthesise("bottle", seed=1)

# A tracker that drifts: by the last frame the object is 3 cm off and turned by 20 degrees. Matrices map mesh to camera.
drift = np.linspace(0.0, 1.0, len(clip))[:, None]
off = se3.rigid(se3.exp_so3(drift * np.radians([0.0, 20.0, 0.0])), drift * np.array([0.03, 0.0, 0.0]))
np.savez(out / "theirs.npz", frames=np.array(clip.frames), T_cam_obj=clip.truth.T_cam_obj @ off)

theirs = read_external_poses(out / "theirs.npz", "theirs", clip, masks)
options = getagrip.Options(init="poses", priors=PriorsFile(out / "theirs.npz"))
refined = getagrip.reconstruct(clip, masks, options)  # starts from them, beside uniform rotations; all evidence decides

for name, result in (("theirs", theirs), ("refined", refined)):
    metrics = getagrip.evaluate(result, clip, masks).metrics
    print(f"{name:>8}: IOU {metrics['iou']:.3f}, ADD sym. {metrics['add_sym_mm']:.1f} mm")
np.savez(out / "refined.npz", frames=np.array(refined.frames), T_cam_obj=refined.T_cam_obj)
