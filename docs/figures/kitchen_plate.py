"""The measurements of docs/kitchen.md: python docs/figures/kitchen_plate.py VIDEO LABELS CLIP RESULT

Each labelled frame but the first and last is left out in turn, and estimated from the others. The picture shows the
clip and its result, masks, hand and mesh, but no pixel of the footage.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.annotate import labels
from getagrip.annotate.carried_masks import Images
from getagrip.annotate.clicked_hands import ClickedHands, hands_from_clicks
from getagrip.annotate.labels import OBJECT, Labels
from getagrip.annotate.propagated_masks import propagate
from getagrip.annotate.steadied_hands import steadied
from getagrip.annotate.video import Video
from getagrip.clip import Clip, read_clip, read_masks
from getagrip.clip.intrinsics import Lens, intrinsics
from getagrip.geometry import se3
from getagrip.geometry.camera import crops_around, project
from getagrip.geometry.render import render_rgb
from getagrip.result import Reconstruction, read_result

OUT = Path(__file__).parent.parent / "images" / "kitchen-plate.png"
SHOWN = 6
SIDE = 300
HAND, PLATE = (0.91, 0.72, 0.60), (0.45, 0.62, 0.78)
VISIBLE, HIDDEN = (214, 210, 200), (238, 236, 230)
"""Colours of the masks under the silhouettes."""


def main(video: str, labelled: str, clip_folder: str, result_folder: str) -> None:
    picture(read_clip(clip_folder), read_result(result_folder)[0])
    annotation, footage = labels.read(labelled), Video(Path(video))
    joints_left_out(annotation, footage.image)
    polygons_left_out(annotation, footage.image)
    footage.close()


def joints_left_out(annotation: Labels, image: Images) -> None:
    """Distance of the fitted joints from the clicks on frames that were left out."""
    K, _ = intrinsics(Lens(guess_focal=True), annotation.size)
    fit = hands_from_clicks(annotation.clicks, K, annotation.side, annotation.first, annotation.last)
    print(f"clicks on {len(fit.keys)} frames: {np.sqrt(np.nanmean(fit.residuals**2)):.1f} px off, root mean square")
    for n in list(annotation.clicks)[1:-1]:
        others = {key: points for key, points in annotation.clicks.items() if key != n}
        smooth = hands_from_clicks(others, K, annotation.side, annotation.first, annotation.last)
        tracked = steadied(smooth, annotation.first, K, annotation.size, image)
        off = [_off(hands, n - annotation.first, K, annotation.clicks[n]) for hands in (smooth, tracked)]
        gap = min(key for key in others if key > n) - max(key for key in others if key < n)
        print(
            f"frame {n} of a gap of {gap}: joints {off[0]:.0f} px off with smoothing only, {off[1]:.0f} with tracking"
        )


def _off(hands: ClickedHands, row: int, K: Float[ndarray, "3 3"], clicks: Float[ndarray, "21 2"]) -> float:
    assert hands.hand.joints is not None
    uv = project(K, se3.transform(hands.hand.T_cam_hand[row], hands.hand.joints[row]))
    return float(np.nanmean(np.linalg.norm(uv - clicks, axis=1)))


def polygons_left_out(annotation: Labels, image: Images) -> None:
    """IOU of the propagated masks with the polygons of frames that were left out."""
    keys = annotation.label_maps()
    frames = sorted(keys)
    for start, n, end in zip(frames, frames[1:], frames[2:], strict=False):
        for frame, drawn, sure in propagate(image, {start: keys[start], end: keys[end]}, start, end):
            if frame == n:
                a, b = drawn == OBJECT, keys[n] == OBJECT
                score = (a & b).sum() / (a | b).sum()
                print(f"frame {n} of a gap of {end - start}: mask's IOU {score:.3f}, its confidence {sure:.2f}")


def picture(clip: Clip, result: Reconstruction) -> None:
    """Top: the masks with the silhouettes of the result; bottom: the hand and the plate."""
    rows = [clip.frames.index(name) for name in result.frames]
    masks = read_masks(clip.take(np.array(rows)))
    crops = crops_around(masks.object, 1.45, 2 * SIDE)
    K = crops.intrinsics(clip.K[rows])
    visible, hidden = crops.resample(masks.object, False), crops.resample(masks.ignore, False)
    columns = []
    for k in np.linspace(0, len(rows) - 1, SHOWN).round().astype(int):
        n = rows[k]
        hand = se3.transform(clip.hand.T_cam_hand[n], clip.hand.vertices[n])
        T_cam_obj = clip.hand.T_cam_hand[n] @ result.T_hand_obj[k]
        plate = se3.transform(T_cam_obj, result.scale * clip.mesh.vertices)
        size = (crops.size, crops.size)
        ground = np.full((*size, 3), 255, np.uint8)
        ground[hidden[k]], ground[visible[k]] = HIDDEN, VISIBLE
        for vertices, faces, colour in ((hand, clip.hand.faces, HAND), (plate, clip.mesh.faces, PLATE)):
            alone = render_rgb([(vertices, faces, (0.0, 0.0, 0.0))], K[k], size) < 128
            contours, _ = cv2.findContours(alone.any(-1).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(ground, contours, -1, tuple(200.0 * c for c in colour), 3, cv2.LINE_AA)
        both = render_rgb([(hand, clip.hand.faces, HAND), (plate, clip.mesh.faces, PLATE)], K[k], size)
        column = cv2.resize(np.vstack([ground, both]), (SIDE, 2 * SIDE), interpolation=cv2.INTER_AREA)
        words = f"frame {int(clip.frames[n])}, IOU {result.iou[k]:.2f}"
        cv2.putText(column, words, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (70, 70, 70), 1, cv2.LINE_AA)
        columns.append(column)
    cv2.imwrite(str(OUT), np.hstack(columns)[..., ::-1])


if __name__ == "__main__":
    main(*sys.argv[1:])
