"""A clip with two further views in a folder, images and masks of each, and its ground truth as a result."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.bench.inputs.added_views import AddedViews
from getagrip.bench.inputs.perturbations import Unchanged
from getagrip.clip import Clip, Masks, input_sha256, read_clip, read_masks, write_clip
from getagrip.clip.views import views_of
from getagrip.io.images import write_image
from getagrip.result import Reconstruction, write_result
from getagrip.synthetic.scene_options import SceneOptions
from helpers.results import true_result
from helpers.scenes import scene_with_axis

NAMES = "view2", "view3"
GREY = {"camera": 40, "view2": 120, "view3": 200}
"""Colour of the images of each camera."""
LACKED = 1
"""The frame without an image in the last view."""


def write_viewed_clip(folder: Path) -> tuple[Reconstruction, Clip, Masks]:
    """Write a clip of three frames, and return the truth as its result, and the clip and its masks as read."""
    clip, masks, axis = scene_with_axis("mug", 0, SceneOptions(frames=3, size=(160, 120), focal=150.0))
    clip, masks = AddedViews(3, Unchanged())(clip, masks, 0)

    def image(name: str) -> np.ndarray:
        return np.full((120, 160, 3), GREY[name], np.uint8)

    write_clip(clip, masks, folder, [image("camera")] * len(clip))
    for view in views_of(clip):
        (frames := folder / "views" / view.name / "frames").mkdir()
        for n, name in enumerate(clip.frames):
            if (view.name, n) != (NAMES[-1], LACKED):
                write_image(frames / f"{name}.png", image(view.name))
    stored = read_clip(folder)
    return true_result(stored, axis), stored, read_masks(stored)


def write_viewed_result(folder: Path) -> Path:
    """Write the same clip and result into a folder, and return the result's."""
    result, clip, _ = write_viewed_clip(folder / "clip")
    return write_result(result, folder / "result", input_sha256(clip.origin), clip_folder=clip.folder)
