"""Draw docs/images/contact_iou.png: a synthetic can is grasped, shifted, released and grasped again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from getagrip.bench.figures.contact_matrix import write_matrix
from getagrip.geometry import se3
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import segment
from getagrip.synthetic.scene import make_scene
from getagrip.synthetic.scene_options import SceneOptions

OUT = Path(__file__).resolve().parents[1] / "images" / "contact_iou.png"
FRAMES = 300
DEFINITION = Definition(contact=0.005, points="area")


def main() -> None:
    clip = make_scene("can", 0, SceneOptions(frames=FRAMES)).clip
    assert clip.truth is not None
    n = np.arange(FRAMES)
    away = np.interp(n, [20, 35, 185, 200, 220, 235, 280, 295], [1, 0, 0, 1, 1, 0, 0, 1])
    slid = np.interp(n, [100, 115, 200, 210], [0, 1, 1, 0])
    along = se3.inverse(clip.truth.T_cam_hand)[:, :3, :3] @ clip.truth.T_cam_obj[:, :3, 2:3]  # the can's axis
    towards = np.array([0.0, -0.15, 0.0])  # the direction the palm faces
    shift = away[:, None] * towards + 0.035 * slid[:, None] * along[:, :, 0]
    T_cam_obj = clip.truth.T_cam_hand @ se3.rigid(t=shift) @ se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    clip = replace(clip, truth=replace(clip.truth, T_cam_obj=T_cam_obj))
    iou, grasps = segment(clip, DEFINITION)
    subtitle = f"{clip.side} hand, {clip.category}  ·  area within 5 mm, IOU above 0.5, all-pairs, 20 frames or more"
    write_matrix(OUT, iou, grasps, clip.fps, DEFINITION.tau, "taken, shifted, let go, taken again", subtitle)


if __name__ == "__main__":
    main()
