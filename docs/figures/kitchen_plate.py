"""The picture of docs/kitchen.md: python docs/figures/kitchen_plate.py CLIP RESULT

A clip and its result: masks, hand and mesh, but no pixel of the footage. The commands of that page make both, with
a focal length of 1000 px.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from getagrip.clip import read_clip, read_masks
from getagrip.geometry.camera import crops_around
from getagrip.geometry.render import render_rgb
from getagrip.pictures.shown import View
from getagrip.result import read_result

OUT = Path(__file__).parent.parent / "images" / "kitchen-plate.png"
SHOWN = 6
SIDE = 300
HAND, PLATE = (0.91, 0.72, 0.60), (0.45, 0.62, 0.78)
VISIBLE, HIDDEN = (214, 210, 200), (238, 236, 230)
"""Colours of the masks under the silhouettes."""


def main(clip_folder: str, result_folder: str) -> None:
    """Top: the masks with the silhouettes of the result; bottom: the hand and the plate."""
    given, (result, _) = read_clip(clip_folder), read_result(result_folder)
    given = given.take(np.array([given.frames.index(name) for name in result.frames]))
    masks = read_masks(given)
    view = View.of(result, given, masks)
    clip = view.clip
    crops = crops_around(masks.object, 1.45, 2 * SIDE)
    K = crops.intrinsics(clip.K)
    visible, hidden = crops.resample(masks.object, False), crops.resample(masks.ignore, False)
    columns = []
    for k in np.linspace(0, len(clip) - 1, SHOWN).round().astype(int):
        hand, plate = view.hand(k), view.object(k)
        size = (crops.size, crops.size)
        ground = np.full((*size, 3), 255, np.uint8)
        ground[hidden[k]], ground[visible[k]] = HIDDEN, VISIBLE
        for vertices, faces, colour in ((hand, clip.hand.faces, HAND), (plate, clip.mesh.faces, PLATE)):
            alone = render_rgb([(vertices, faces, (0.0, 0.0, 0.0))], K[k], size) < 128
            contours, _ = cv2.findContours(alone.any(-1).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(ground, contours, -1, tuple(200.0 * c for c in colour), 3, cv2.LINE_AA)
        both = render_rgb([(hand, clip.hand.faces, HAND), (plate, clip.mesh.faces, PLATE)], K[k], size)
        column = cv2.resize(np.vstack([ground, both]), (SIDE, 2 * SIDE), interpolation=cv2.INTER_AREA)
        iou = "mask in doubt" if np.isnan(result.iou[k]) else f"IOU {result.iou[k]:.2f}"
        words = f"frame {int(clip.frames[k])}, {iou}"
        cv2.putText(column, words, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (70, 70, 70), 1, cv2.LINE_AA)
        columns.append(column)
    cv2.imwrite(str(OUT), np.hstack(columns)[..., ::-1])


if __name__ == "__main__":
    main(*sys.argv[1:])
