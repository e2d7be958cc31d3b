"""Make docs/images/timeline.webp: a rendered mug from the table into the hand and back, as ``reconstruct`` finds it.

    python docs/figures/timeline_film.py OUT

OUT gets the clip, the result and its film as ``getagrip report RESULT --mp4`` writes it, from which the picture is
made. Hands and masks are exact.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from PIL import Image

from getagrip.clip import Clip, HandTrack, Masks, Segment, Truth, World, read_clip, read_masks, write_clip
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.reconstruct import reconstruct
from getagrip.report.film import write_film
from getagrip.report.pictures.result_view import View
from getagrip.result import write_result
from getagrip.synthetic.scene import ground_truth_masks, make_scene
from getagrip.synthetic.scene_options import SceneOptions
from getagrip.synthetic.video import at_video_size, render_video

PICTURE = Path(__file__).resolve().parents[1] / "images" / "timeline.webp"
WIDTH, QUALITY = 720, 60
"""Of the picture: its width [px], and WebP's quality."""
SEED, LOOK, SIZE = 1, 4, (960, 720)
"""Seeds of a grasp whose forearm stays above the table, and of the colours; size of the rendered images [px]."""
LIES, COMES, HELD, LEAVES, LEFT = 18, 8, 50, 8, 14
"""Frames: the object lies, the hand closes about it, holds it, lets it go, and leaves it."""
COUNT = LIES + COMES + HELD + LEAVES + LEFT
BACK = 0.16
"""The hand comes from so far back [m]."""
LIFTED, ASIDE, TILTED = 0.16, np.array([0.08, -0.06, 0.0]), np.radians(35.0)


def ease(t: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """From 0 to 1, at rest at both ends."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def on_table(T_hand_obj: Float[ndarray, "4 4"], T_world_obj: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"]:
    """The hand that holds an object where it lies."""
    return np.asarray(T_world_obj @ se3.inverse(T_hand_obj))


def timeline() -> tuple[Clip, Masks, list[ndarray]]:
    """A clip with its masks and images; the world's z is up, the table at 0."""
    scene = make_scene("mug", SEED, SceneOptions(frames=HELD, turn_deg=(20.0, 30.0)))
    grasp, truth, mesh = scene.clip, scene.clip.truth, scene.object
    assert truth is not None
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    lies = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 2.5])), np.array([0.0, 0.0, -mesh.vertices[:, 2].min()]))
    left = se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 2.8])), ASIDE - [0.0, 0.0, mesh.vertices[:, 2].min()])
    start, end = on_table(T_hand_obj[0], lies), on_table(T_hand_obj[-1], left)
    share = ease(np.linspace(0.0, 1.0, HELD))[:, None]
    bump = np.sin(np.pi * np.linspace(0.0, 1.0, HELD))[:, None] ** 2
    turn = se3.log_so3(end[:3, :3] @ start[:3, :3].T)
    tilt = se3.exp_so3(TILTED * bump * np.array([1.0, 0.3, 0.0]) / np.hypot(1.0, 0.3))
    R = tilt @ se3.exp_so3(share * turn) @ start[:3, :3]
    # The object's centre moves on an arc, the hand with it.
    centre = se3.transform(T_hand_obj, mesh.centre[None])[:, 0]
    ends = [se3.transform(T, mesh.centre[None])[0] for T in (lies, left)]
    place = ends[0] + share * (ends[1] - ends[0]) + LIFTED * bump * np.array([0.0, 0.0, 1.0])
    held = se3.rigid(R, place - (R @ centre[..., None])[..., 0])
    before, after = LIES + COMES, LEAVES + LEFT
    coming = 1.0 - ease(np.arange(before) / before)
    going = ease((np.arange(after) + 1.0) / after)
    T_world_hand = np.concatenate(
        [backed(start, mesh.centre, lies, coming), held, backed(end, mesh.centre, left, going)]
    )
    T_world_obj = np.concatenate([np.tile(lies, (before, 1, 1)), held @ T_hand_obj, np.tile(left, (after, 1, 1))])
    flat = generic.load("right").with_shape().with_pose(np.zeros((1, 45)))
    opened = np.concatenate([coming, np.zeros(HELD), going])
    opened = ease(opened / 0.5)[:, None, None]
    at_grasp = np.concatenate([np.zeros(before, int), np.arange(HELD), np.full(after, HELD - 1)])
    vertices = (1.0 - opened) * truth.hand_vertices[at_grasp] + opened * flat.vertices
    assert grasp.hand.joints is not None
    joints = (1.0 - opened) * grasp.hand.joints[at_grasp] + opened * flat.joints
    T_world_cam = head()
    T_cam_world = se3.inverse(T_world_cam)
    states = [("static", LIES, None), ("contact", COMES, "right"), ("grasp", HELD, "right"),
              ("contact", LEAVES, "right"), ("static", LEFT, None)]  # fmt: skip
    segments, at = [], 0
    for state, length, side in states:
        segments.append(Segment(state, at, at + length - 1, side))  # type: ignore[arg-type]
        at += length
    hand = HandTrack(vertices, grasp.hand.faces, T_cam_world @ T_world_hand, grasp.hand.regions, joints)
    clip = replace(
        grasp, name="mug-timeline", frames=tuple(f"{n:06d}" for n in range(COUNT)), times=None, mesh=mesh,
        world=World(T_world_cam, np.array([0.0, 0.0, 1.0]), 0.0), segments=tuple(segments), hand=hand,
        K=np.repeat(grasp.K[:1], COUNT, axis=0),
        truth=Truth(T_cam_world @ T_world_obj, 1.0, hand.T_cam_hand, vertices),
        provenance={"source": "synthetic, by getagrip: docs/figures/timeline_film.py"},
    )  # fmt: skip
    scene = at_video_size(replace(scene, clip=clip), SIZE)
    return scene.clip, ground_truth_masks(scene), list(render_video(scene, SIZE, LOOK))


def backed(
    T: Float[ndarray, "4 4"], centre: Float[ndarray, "3"], lies: Float[ndarray, "4 4"], share: Float[ndarray, "n"]
) -> Float[ndarray, "n 4 4"]:
    """A hand that is so far away from an object, in shares of ``BACK``, backwards and up."""
    away = T[:3, 3] - se3.transform(lies, centre[None])[0]
    away = away / np.linalg.norm(away) + [0.0, 0.0, 0.5]
    return np.asarray(se3.rigid(None, BACK * share[:, None] * away / np.linalg.norm(away)) @ T)


def head() -> Float[ndarray, "T 4 4"]:
    """A camera that looks down on the table and sways."""
    t = np.linspace(0.0, 2.0 * np.pi, COUNT)
    at = np.stack([0.02 * np.sin(t), -0.62 + 0.02 * np.cos(1.3 * t), 0.5 + 0.015 * np.sin(1.7 * t)], axis=1)
    forward = np.array([0.05, -0.03, 0.12]) - at
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=2)
    return np.asarray(se3.rigid(R, at))


def main(out: Path) -> None:
    clip, masks, images = timeline()
    folder = out / "clips" / clip.name
    if not folder.exists():
        write_clip(clip, masks, folder, images)
    given = read_clip(folder)
    result = reconstruct(given, read_masks(given), Options())
    if not (out / clip.name).exists():
        write_result(result, out / clip.name)
    film = write_film(View.of(result, given, read_masks(given)), out / "timeline.mp4")
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        rate = stream.average_rate or Fraction(30)
        frames = [frame.to_image() for frame in container.decode(stream)][::2]
    height = round(WIDTH * frames[0].height / frames[0].width)
    small = [frame.resize((WIDTH, height), Image.Resampling.LANCZOS) for frame in frames]
    small[0].save(
        PICTURE, save_all=True, append_images=small[1:], duration=round(2000 / float(rate)), loop=0, quality=QUALITY,
        method=6,
    )  # fmt: skip
    print(PICTURE, PICTURE.stat().st_size)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
