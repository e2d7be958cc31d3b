"""What a small clip is made of, a video, masks, hands and a mesh, and the commands that make one of them.

The ground truth of a clip as a result.

A small clip with ground truth, and a result of it that has a right and a wrong candidate.

A result of a small clip, to export.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np
from numpy import ndarray

from getagrip.clip import Clip, Masks, World
from getagrip.clip.write import write_hand
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from getagrip.report.pictures.result_view import View
from getagrip.result import Axis, Candidates, Reconstruction, Status
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import box, small_clip
from helpers.scenes import scene_with_axis


def true_result(clip: Clip, axis: Axis | None) -> Reconstruction:
    """A result of ``one-dof``; without an axis, of ``static``. Its IOU is made up."""
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    return Reconstruction(
        clip=clip.name,
        method="static" if axis is None else "one-dof",
        frames=clip.frames,
        T_hand_obj=T,
        scale=clip.truth.scale,
        iou=np.linspace(0.5, 1.0, len(clip)),
        axis=axis,
        candidates=Candidates(T[None], np.ones(1), np.ones(1)),
        energy={"total": 1.0},
        status=Status.CONVERGED,
        ambiguous=True,
        seconds={"total": 0.5},
    )


SMALL = SceneOptions(frames=5, size=(160, 120), focal=150.0)
OFF = 0.03
"""The wrong candidate is so far off [m]."""


@cache
def two_candidates() -> tuple[Reconstruction, Clip, Masks]:
    """The ground truth, and the same moved by ``OFF`` and turned, at a higher energy."""
    clip, masks, axis = scene_with_axis("mug", 0, SMALL)
    true = true_result(clip, axis)
    wrong = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 0.8])), np.array([OFF, 0.0, 0.0])) @ true.T_hand_obj
    poses = np.stack([true.T_hand_obj, wrong])
    candidates = Candidates(poses, np.full(2, true.scale), np.array([100.0, 150.0]))
    return replace(true, candidates=candidates), clip, masks


def view() -> View:
    """The same as pictures show it."""
    return View.of(*two_candidates())


TURN = np.array([[0.0, 0.1, 3.0], [0.0, 0.2, 3.1], [0.0, 0.3, 3.2]])
"""Rotation vectors that go through half a turn, where quaternions change their signs."""


def result_and_clip() -> tuple[Reconstruction, Clip]:
    """The result is of the last three of five frames."""
    clip, _ = small_clip(5)
    turned = se3.rigid(se3.exp_so3(np.array([[0.1 * n, 2.0, 0.3] for n in range(5)])), np.array([[1.0, 2.0, 3.0]] * 5))
    clip = replace(clip, times=np.array([7.0, 7.1, 7.2, 7.3, 7.5]), world=World(turned, np.array([0.0, 1.0, 0.0])))
    T = se3.rigid(se3.exp_so3(TURN), np.array([[0.01, 0.02, 0.03]] * 3))
    result = Reconstruction(
        clip=clip.name,
        method="soft-hinge",
        frames=clip.frames[2:],
        T_hand_obj=T,
        scale=1.25,
        iou=np.array([0.9, 0.8, np.nan]),
        frame_kind=("sampled", "fitted", "interpolated"),
        axis=Axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.1, 0.2])),
        candidates=Candidates(T[None], np.array([1.25]), np.array([2.0])),
        energy={"total": 2.0},
        status=Status.CONVERGED,
        ambiguous=False,
        seconds={"total": 0.1},
        notes=("the scale is a guess",),
    )
    return result, clip


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
