"""The picture of docs/tape.md: python docs/figures/held_object.py CLIP RESULT tape

A clip and its result: masks, hand and mesh, but no pixel of the footage. The commands of that page make both.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray
from PIL import Image

from getagrip.clip import Clip, read_clip, read_masks
from getagrip.geometry import se3
from getagrip.geometry.camera import crops_around
from getagrip.geometry.rasterize import render_rgb
from getagrip.report.pictures.result_view import View
from getagrip.result import read_result

IMAGES = Path(__file__).parent.parent / "images"
SHOWN = 6
SIDE = 300
TURN = 1.9
"""From the camera's side [rad]."""
HAND, OBJECT = (0.91, 0.72, 0.60), (0.45, 0.62, 0.78)
VISIBLE, HIDDEN = (214, 210, 200), (238, 236, 230)
"""Colours of the masks under the silhouettes."""


def main(clip_folder: str, result_folder: str, name: str) -> None:
    """Top: the masks with the silhouettes of the result; below it the hand and the object, and both from the side."""
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
        hand, thing = view.hand(k), view.object(k)
        size = (crops.size, crops.size)
        ground = np.full((*size, 3), 255, np.uint8)
        ground[hidden[k]], ground[visible[k]] = HIDDEN, VISIBLE
        for vertices, faces, colour in ((hand, clip.hand.faces, HAND), (thing, clip.mesh.faces, OBJECT)):
            alone = render_rgb([(vertices, faces, (0.0, 0.0, 0.0))], K[k], size) < 128
            contours, _ = cv2.findContours(alone.any(-1).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(ground, contours, -1, tuple(200.0 * c for c in colour), 3, cv2.LINE_AA)
        both = render_rgb([(hand, clip.hand.faces, HAND), (thing, clip.mesh.faces, OBJECT)], K[k], size)
        seen = np.vstack([ground, both, from_the_side(hand, thing, clip, K[k], size)])
        column = cv2.resize(seen, (SIDE, 3 * SIDE), interpolation=cv2.INTER_AREA)
        iou = "mask in doubt" if np.isnan(result.iou[k]) else f"IOU {result.iou[k]:.2f}"
        words = f"frame {int(clip.frames[k])}, {iou}"
        cv2.putText(column, words, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (70, 70, 70), 1, cv2.LINE_AA)
        columns.append(column)
    Image.fromarray(np.hstack(columns)).quantize(192).save(IMAGES / f"{name}.png", optimize=True)


def from_the_side(hand: ndarray, thing: ndarray, clip: Clip, K: ndarray, size: tuple[int, int]) -> ndarray:
    """The same, turned about the vertical through the object's middle."""
    middle = 0.5 * (thing.min(axis=0) + thing.max(axis=0))
    R = se3.exp_so3(np.array([0.0, TURN, 0.0]))
    at = np.array([0.0, 0.0, middle[2]])
    K = K.copy()
    K[:2, 2] = 0.5 * np.array(size)
    moved = [(x - middle) @ R.T + at for x in (hand, thing)]
    shown = [(moved[0], clip.hand.faces, HAND), (moved[1], clip.mesh.faces, OBJECT)]
    return np.asarray(render_rgb(shown, K, size))


if __name__ == "__main__":
    main(*sys.argv[1:])
