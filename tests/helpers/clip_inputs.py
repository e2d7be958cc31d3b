"""What a small clip is made of, a video, masks, hands and a mesh, and the commands that make one of them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy import ndarray

from getagrip.clip.write import write_hand
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from helpers.clips import box

SIZE = (64, 48)
K = ("60", "60", "32", "24")
FRAMES = 12
AHEAD = np.array([0.0, 0.0, 0.4])


def write_video(path: Path, frames: int = FRAMES) -> Path:
    """A video each of whose frames has as many white bars as its number, from 1."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for n in range(1, frames + 1):
            image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
            for bar in range(n):
                image[:, 4 * bar + 1 : 4 * bar + 4] = 255
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def bars(image: ndarray) -> int:
    """How many bars an image has: the number of its frame."""
    bright = image.mean(axis=(0, 2))[2::4] > 128
    return int(np.count_nonzero(bright))


def write_inputs(folder: Path) -> Path:
    """A folder with a video, masks of it, a mesh in a generator's unit, and hands in some of its frames."""
    write_video(folder / "video.mp4")
    (folder / "masks").mkdir()
    for n in range(1, FRAMES + 1):
        mask = np.zeros(SIZE[::-1], np.uint8)
        mask[20:30, 10 + n : 30 + n] = 1
        mask[30:40, 10:30] = 2
        cv2.imwrite(str(folder / "masks" / f"{n:05d}.png"), mask)
    write_mesh(box(1.0, 0.6, 0.5), folder / "unit.obj")
    hand = generic.load("right").with_shape().with_pose()
    T = np.tile(se3.rigid(None, AHEAD), (6, 1, 1))
    write_hand(hand_track(hand, T), folder / "six.npz")
    return folder


def new(made: Path, *more: str) -> list[str]:
    return ["clip", "new", str(made / "video.mp4"), "--out", str(made / "cup"), *more]


def everything(made: Path) -> list[str]:
    return [
        "--interval", "3", "8", "--side", "right", "--mesh", str(made / "unit.obj"), "--size-mm", "120",
        "--masks", str(made / "masks"), "--object", "1", "--ignore", "2", "--K", *K,
    ]  # fmt: skip
