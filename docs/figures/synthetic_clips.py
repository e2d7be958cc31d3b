"""Draw docs/images/synthetic-clips.png: one frame of a synthetic clip of every category."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.synthetic.scene import make_scene, render_pictures
from getagrip.synthetic.scene_options import SceneOptions

OUT = Path(__file__).resolve().parents[1] / "images" / "synthetic-clips.png"
OPTIONS = SceneOptions(frames=10, size=(240, 200), focal=280.0)
COLUMNS = 6


def main() -> None:
    tiles = []
    for n, category in enumerate(SYNTHETIC_CATEGORIES):
        scene = make_scene(category, 1, replace(OPTIONS, side=("right", "left")[n % 2]))
        image = render_pictures(replace(scene, clip=scene.clip.take(np.array([6]))))[0]
        cv2.putText(image, category, (10, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (60, 60, 60), 1, cv2.LINE_AA)
        tiles.append(np.pad(image, ((0, 4), (0, 4), (0, 0)), constant_values=255))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.concatenate(tiles[k : k + COLUMNS], axis=1) for k in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(str(OUT), cv2.cvtColor(np.concatenate(rows), cv2.COLOR_RGB2BGR))


if __name__ == "__main__":
    main()
