"""A real dataset: the first stable grasp of DexYCB, reconstructed and compared with its true poses.

    python examples/05_real_dataset.py DATA [MESHES]

DATA is the folder of DexYCB, with MESHES the folder of the YCB models (DATA/models by default), or any folder of clips,
as `getagrip import` and `getagrip clip new` write them.
"""

import sys
from pathlib import Path

import getagrip
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb

if len(sys.argv) < 2 or not Path(sys.argv[1]).is_dir():
    print("skipped: name the folder of DexYCB, or one of clips. DexYCB is at https://dex-ycb.github.io")
    sys.exit()
data = Path(sys.argv[1])
meshes = Path(sys.argv[2]) if len(sys.argv) > 2 else None

if folders := sorted(path.parent for path in data.glob("*/clip.json")):
    clip = getagrip.read_clip(folders[0])  # every number is checked here
    masks = getagrip.read_masks(clip)
else:
    # The reader cuts sequences into stable grasps, fits a hand to the 21 joints, and renders masks from the true poses.
    clip, masks = next(clips(DexYcb(root=data, meshes=meshes)))
print(f"{clip.name}: a {clip.category} in a {clip.side} hand, {len(clip)} frames")

result = getagrip.reconstruct(clip, masks)
metrics = getagrip.evaluate(result, clip, masks).metrics
print(f"mask IOU {metrics['iou']:.3f}")
if clip.truth is not None:
    print(f"ADD {metrics['add_mm']:.1f} mm, with the object's symmetries {metrics['add_sym_mm']:.1f} mm")
