"""A synthetic timeline: an object lies, a hand comes, and carries it away."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from getagrip.clip import Clip, HandTrack, Masks, OtherHand, Segment, Truth, World
from getagrip.geometry import se3
from getagrip.geometry.rasterize import true_masks
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import SMALL, scene

LIES, COMES = 5, 2
"""Frames in which the object lies, and of these at the end, in which the hand is near."""


@cache
def timeline(category: str = "mug", seed: int = 0, options: SceneOptions = SMALL) -> tuple[Clip, Masks]:
    """A grasp of 8 frames; before it, the object lies still as it is grasped, the hand 20 cm aside, then nearer."""
    grasp, masks = scene(category, seed, options)
    assert grasp.world is not None
    assert grasp.truth is not None
    before = np.zeros(LIES + COMES, dtype=int)
    clip = grasp.take(np.concatenate([before, np.arange(len(grasp))]))
    hand = clip.hand.T_cam_hand.copy()
    aside = np.concatenate([np.full(LIES, 0.2), np.linspace(0.15, 0.05, COMES)])
    hand[: len(before), 0, 3] += aside if grasp.side == "right" else -aside
    truth = Truth(clip.truth.T_cam_obj, grasp.truth.scale, hand, clip.truth.hand_vertices)  # type: ignore[union-attr]
    frames = tuple(f"{n:06d}" for n in range(len(clip)))
    lowest = se3.transform(grasp.world.T_world_cam[0] @ grasp.truth.T_cam_obj[0], grasp.mesh.vertices)[:, 2].min()
    world = World(clip.world.T_world_cam, np.array([0.0, 0.0, 1.0]), float(lowest))  # type: ignore[union-attr]
    segments = (
        Segment("static", 0, LIES - 1),
        Segment("contact", LIES, LIES + COMES - 1, grasp.side),
        Segment("grasp", LIES + COMES, len(clip) - 1, grasp.side),
    )
    clip = replace(
        clip, hand=replace(clip.hand, T_cam_hand=hand), truth=truth, frames=frames, times=None, world=world,
        segments=segments,
    )  # fmt: skip
    seen, ignored = [], []
    for n in range(len(before)):
        body = se3.transform(truth.T_cam_obj[n], grasp.mesh.vertices), grasp.mesh.faces
        arm = se3.transform(hand[n], clip.hand.vertices[n]), clip.hand.faces
        visible, ignore, _ = true_masks(body, [arm], [], clip.K[n], clip.size)
        seen.append(visible)
        ignored.append(ignore)
    return clip, Masks(
        np.concatenate([np.stack(seen), masks.object]), np.concatenate([np.stack(ignored), masks.ignore])
    )


def by_other_hand() -> tuple[Clip, Masks]:
    """The same, but the clip's own hand is the other one, which stands 30 cm aside; that which grasps is not known in
    the first two frames, nor in one within the grasp."""
    clip, masks = timeline()
    assert clip.truth is not None
    assert clip.hand.joints is not None
    mirror = np.array([-1.0, 1.0, 1.0])
    T = np.repeat(clip.hand.T_cam_hand[:1], len(clip), axis=0)
    T[:, 0, 3] -= 0.3
    own = HandTrack(
        mirror * clip.hand.vertices, clip.hand.faces[:, ::-1], T, clip.hand.regions, mirror * clip.hand.joints
    )
    known = np.setdiff1d(np.arange(len(clip)), [0, 1, len(clip) - 3])
    return replace(
        clip, side="left", hand=own, other_hand=OtherHand.at(clip.hand.take(known), known, len(clip)),
        truth=replace(clip.truth, T_cam_hand=T, hand_vertices=own.vertices),
    ), masks  # fmt: skip
