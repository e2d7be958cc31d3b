"""An estimator's files: 21 joints a frame and masks as PNGs become a clip, its hand fitted and its sources noted.

    python examples/04_estimator_files.py [OUT]

Writes the files into OUT/files and the clip into OUT/clip (out/estimator by default). `getagrip import hands` and
`getagrip import masks` do the same; docs/estimators.md lists the programs whose files are read.
"""

import sys
from pathlib import Path

import numpy as np

import getagrip
from getagrip.io.images import write_image
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.readers.trackers import Request, read_tracked_hands
from getagrip.readers.trackers.joints import Joints

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/estimator")
joints_file, masks_folder = out / "files" / "joints.npz", out / "files" / "masks"
masks_folder.mkdir(parents=True, exist_ok=True)

# These files stand for those of your programs: joints before the camera [m], and labels, 1 the object and 2 the hand.
scene, seen = getagrip.synthesise("mug", seed=2)
T = scene.hand.T_cam_hand
np.savez(joints_file, joints=scene.hand.joints @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3])
for name, thing, hand in zip(scene.frames, seen.object, seen.ignore, strict=True):
    write_image(masks_folder / f"{name}.png", np.where(thing, 1, np.where(hand, 2, 0)).astype(np.uint8))

# TRACKERS has a reader for each program (HaMeR(), WiLoR(), ...). Plain joints say no order, so the reader asks for it.
hands = read_tracked_hands([joints_file], Joints(order="openpose"), Request("right", scene.frames, scene.K, scene.size))
read = open_masks(masks_folder, MaskRequest(scene.frames, scene.size, object=("1",), hand=("2",)))
masks = getagrip.Masks.of(found for n in range(len(scene)) if (found := read(n)) is not None)

clip = getagrip.Clip(
    hand=hands.track,
    mesh=scene.mesh,
    K=scene.K,
    size=scene.size,
    side="right",
    frames=scene.frames,
    provenance=hands.provenance,
)
print(getagrip.write_clip(clip, masks, out / "clip", replace=True))
print("\n".join(f"{topic}: {source}" for topic, source in clip.provenance.items()))

result = getagrip.reconstruct(clip, masks)
print(f"mask IOU {result.iou.mean():.3f}; {result.message}")
