"""A mesh that is only of the object's kind, as it is given and fitted: ``python docs/figures/fitted_mesh.py OUT.png``.

A synthetic mug of the preset ``measured`` (training split): above with the category's mean mesh, below with the mesh
fitted to the masks: masks and contours of four frames.
"""

from __future__ import annotations

import sys

import cv2
import numpy as np

import getagrip
from getagrip.report.film import draw_caption
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import draw_overlay, smooth_windows
from getagrip.synthetic.categories import clips_of_split

SIDE, FRAMES = 340, (3, 10, 17, 25)
CATEGORY, WHICH = "mug", 2


def main(out: str) -> None:
    """Reconstruct the clip twice, and draw both."""
    category, seed, options = [clip for clip in clips_of_split("train", "measured") if clip[0] == CATEGORY][WHICH]
    clip, masks = getagrip.synthesise(category, seed, options)
    rows = []
    for mesh, words in (("as-given", "mean mesh"), ("fitted", "fitted mesh")):
        view = View.of(getagrip.reconstruct(clip, masks, getagrip.Options(mesh=mesh)), clip, masks)
        crops = smooth_windows(view, SIDE)
        first, *others = (draw_overlay(view, n, crops, n) for n in FRAMES)
        rows.append(np.concatenate([draw_caption(first, words), *others], axis=1))
    cv2.imwrite(out, cv2.cvtColor(np.concatenate(rows), cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    main(sys.argv[1])
