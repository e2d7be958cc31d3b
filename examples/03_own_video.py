"""A rehearsal for your own video: makes of a clip what a camera, a segmenter and a hand estimator would give.

    python examples/03_own_video.py [CLIP] [OUT]

CLIP is a clip folder with images (that of `getagrip demo` by default). Writes into OUT (rehearsal/ by default)
video.mp4, masks/ (PNG, 1 the object, 2 the hand), joints.npz (21 joints in every frame, in the camera frame) and
object.obj. docs/tutorial.md goes on from there.
"""

import sys
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

import getagrip
from getagrip.io.images import write_image, write_video

source = Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo/clips/mug-right-0002")
out = Path(sys.argv[2] if len(sys.argv) > 2 else "rehearsal")
(out / "masks").mkdir(parents=True, exist_ok=True)

clip = getagrip.read_clip(source)
masks = getagrip.read_masks(clip)

pictures = (cv2.imread(str(source / "frames" / f"{name}.jpg"))[..., ::-1] for name in clip.frames)
write_video(out / "video.mp4", pictures, Fraction(clip.fps).limit_denominator(1000), clip.size)

for number, (thing, hand) in enumerate(zip(masks.object, masks.ignore, strict=True), start=1):  # frames count from 1
    write_image(out / "masks" / f"{number:06d}.png", np.where(thing, 1, np.where(hand, 2, 0)).astype(np.uint8))

T = clip.hand.T_cam_hand
joints = clip.hand.joints @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]  # (T, 21, 3), in the camera frame [m]
np.savez(out / "joints.npz", joints=joints)

getagrip.write_mesh(clip.mesh, out / "object.obj")
print(f"{len(clip)} frames, focal length {clip.K[0, 0, 0]:.0f} px: {out}")
