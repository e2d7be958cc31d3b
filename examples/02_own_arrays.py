"""Your own arrays, without any folder on disk: hands from a tracker, masks from a segmenter, a mesh; poses come back.

    python examples/02_own_arrays.py [OUT]

Writes OUT/poses.npz (out/ by default).
"""

import sys
from pathlib import Path

import numpy as np

import getagrip

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
out.mkdir(parents=True, exist_ok=True)

# These arrays stand for yours. T frames, V vertices; metres; camera axes x right, y down, z forward.
given, input_masks = getagrip.synthesise("bottle", seed=1)
vertices, faces = given.hand.vertices, given.hand.faces  # (T, V, 3) in a frame that moves with the hand; (F, 3)
T_cam_hand = given.hand.T_cam_hand  # (T, 4, 4): X_cam = T_cam_hand @ X_hand
regions = given.hand.regions  # vertex ids of the pads of the fingertips: "thumb", "index", "middle", "ring", "pinky"
K = given.K[0]  # (3, 3) pinhole intrinsics [px]; lens distortion must have been removed
visible = input_masks.object  # (T, H, W): the object
in_front = input_masks.ignore  # (T, H, W): the hand and all else in front of it
object_vertices, object_faces = given.mesh.vertices, given.mesh.faces

frames, height, width = visible.shape
clip = getagrip.Clip(
    hand=getagrip.HandTrack(vertices, faces, T_cam_hand, regions),
    mesh=getagrip.Mesh(object_vertices, object_faces),
    K=np.tile(K, (frames, 1, 1)),
    size=(width, height),
    side="right",
)
result = getagrip.reconstruct(clip, getagrip.Masks(visible, in_front), getagrip.Options(inits=20))

# The result names its frames. Its poses are relative to the hands, which it corrected if their own pixels disagreed.
used = clip.index_of(result.frames)
hand = clip.take(used).with_hand_at(result.T_cam_hand).hand
T_cam_obj = hand.T_cam_hand @ result.T_hand_obj  # the object is scaled before it is posed: T_cam_obj @ (scale * X_obj)
np.savez(out / "poses.npz", frames=used, T_cam_obj=T_cam_obj, scale=result.scale, iou=result.iou)
print(f"{len(used)} poses, mask IOU {result.iou.mean():.3f}: {out / 'poses.npz'}")
