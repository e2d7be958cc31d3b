"""Make docs/images/video-to-3d.webp: a rendered video, the mug's mask from one box, and hand and mug in 3D, turning.

    python docs/figures/video_to_3d.py OUT

OUT gets the video as ``getagrip synthesise mug --seed 2 --video`` makes it, and what ``getagrip draft`` makes of it
with a box in the first frame. The picture shows the video, then the masks over it, then the posed meshes; beside it the
same meshes from a camera that goes round.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy import ndarray
from PIL import Image, ImageDraw

from getagrip import read_clip, read_masks, read_result
from getagrip.cli import main
from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_rgb
from getagrip.io.images import read_image
from getagrip.synthetic.scene import make_scene
from getagrip.synthetic.scene_options import SceneOptions
from getagrip.synthetic.video import RenderedVideo, write_rendered_video

PICTURE = Path(__file__).resolve().parents[1] / "images" / "video-to-3d.webp"
WIDTH, HEIGHT, QUALITY, STEP = 480, 360, 62, 2
"""Size of each of the two tiles [px], WebP's quality, and every so many frames."""
BOX_FRAMES, MASK_FRAMES = 16, 44
"""Until these frames, the left tile shows the box, the masks; then the meshes."""
CYAN, SKIN, BLUE = np.array([40, 220, 255]), (0.87, 0.66, 0.54), (0.25, 0.45, 0.75)


def draft(out: Path) -> tuple[Path, Path, RenderedVideo]:
    """The folders of the clip and the result, and the video that they were made of."""
    video = write_rendered_video(make_scene("mug", 2, SceneOptions(frames=90)), out / "video", 2, lambda: None)
    words = shlex.split(video.command())[1:]
    assert main([*words, "--out", str(out / "draft")]) == 0
    (clip,) = (path.parent for path in (out / "draft" / "clips").glob("*/clip.json"))
    return clip, out / "draft" / "results" / clip.name, video


def tiles(clip_folder: Path, result_folder: Path, video: RenderedVideo) -> list[Image.Image]:
    """The pictures, two tiles each."""
    clip, (result, *_) = read_clip(clip_folder), read_result(result_folder)
    masks, K = read_masks(clip), np.diag([WIDTH / clip.size[0], HEIGHT / clip.size[1], 1.0]) @ clip.K[0]
    assert result.T_cam_hand is not None
    rows = clip.index_of(result.frames)
    turning = []
    for n in range(0, len(rows), STEP):
        image = read_image(clip_folder / "frames" / f"{clip.frames[rows[n]]}.jpg", clip.size)
        hand = se3.transform(result.T_cam_hand[n], result.hand_scale * clip.hand.vertices[rows[n]])
        thing = se3.transform(result.T_cam_obj[n], result.scale * clip.mesh.vertices)
        meshes = [(hand, clip.hand.faces, SKIN), (thing, clip.mesh.faces, BLUE)]
        if n >= MASK_FRAMES:
            left = render_rgb(
                meshes, K, (WIDTH, HEIGHT), cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
            )
        else:
            if n >= BOX_FRAMES:
                image = with_mask(image, masks.object[rows[n]])
            left = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        turning.append(Image.fromarray(np.concatenate([left, from_around(meshes, n / len(rows))], axis=1)))
        if n < BOX_FRAMES:
            x, y, w, h = (value * WIDTH / clip.size[0] for value in video.box)
            ImageDraw.Draw(turning[-1]).rectangle((x, y, x + w, y + h), outline=tuple(CYAN), width=3)
    return turning


def with_mask(image: ndarray, mask: ndarray) -> ndarray:
    """The image, its mask tinted and outlined."""
    shown = image.astype(float)
    shown[mask] = 0.55 * shown[mask] + 0.45 * CYAN
    edge = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5))).astype(bool) & ~mask
    shown[edge] = CYAN
    return np.asarray(shown, dtype=np.uint8)


def from_around(meshes: list, turn: float) -> ndarray:
    """The meshes from a camera that goes once round them, slightly from above."""
    middle = np.concatenate([vertices for vertices, _, _ in meshes]).mean(axis=0)
    R = se3.exp_so3(np.array([0.45, 0.0, 0.0])) @ se3.exp_so3(np.array([0.0, 2.0 * np.pi * turn, 0.0]))
    placed = [((vertices - middle) @ R.T + [0.0, 0.0, 0.62], faces, colour) for vertices, faces, colour in meshes]
    K = np.array([[2.0 * WIDTH, 0.0, WIDTH / 2], [0.0, 2.0 * WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]])
    return render_rgb(placed, K, (WIDTH, HEIGHT), (0.98, 0.98, 0.97))


if __name__ == "__main__":
    first, *others = tiles(*draft(Path(sys.argv[1])))
    first.save(
        PICTURE, save_all=True, append_images=others, duration=1000 * STEP // 30, loop=0, quality=QUALITY, method=6
    )
