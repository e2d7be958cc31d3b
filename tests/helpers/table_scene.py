"""A synthetic clip that is not cut: an object lies while a hand comes, and is carried away before a moving head."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from getagrip.clip import Clip, HandTrack, Masks, Truth, World
from getagrip.geometry import se3
from getagrip.geometry.rasterize import true_masks
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import scene

LYING, HOLDING = 18, 24
COMES_FROM = 0.15
"""How far away the hand is at first [m]."""


@cache
def from_table(category: str = "bottle", seed: int = 1) -> tuple[Clip, Masks]:
    """``LYING`` frames in which the object lies and the hand comes near, then ``HOLDING`` in which it is held."""
    held, _ = scene(category, seed, SceneOptions(frames=HOLDING, size=(320, 240), focal=300.0))
    truth, world = held.truth, held.world
    assert truth is not None
    assert world is not None
    back = np.r_[np.arange(LYING, 0, -1), np.arange(HOLDING)]  # the head moves as it will, in reverse
    first = np.r_[np.zeros(LYING, int), np.arange(HOLDING)]  # the hand grips before it comes
    away = np.r_[np.linspace(1.0, 0.1, LYING), np.zeros(HOLDING)]
    T_world_cam = world.T_world_cam[back]
    T_world_hand = (world.T_world_cam @ truth.T_cam_hand)[first]
    T_world_hand[:, :3, 3] += away[:, None] * [0.0, 0.0, COMES_FROM]
    T_cam_world = se3.inverse(T_world_cam)
    T_cam_hand, T_cam_obj = T_cam_world @ T_world_hand, T_cam_world @ (world.T_world_cam @ truth.T_cam_obj)[first]
    hand = HandTrack(truth.hand_vertices[first], held.hand.faces, T_cam_hand, held.hand.regions)
    clip = replace(
        held, frames=(), times=None, K=held.K[first], hand=hand, world=World(T_world_cam, world.up), folder=None,
        truth=Truth(T_cam_obj, truth.scale, T_cam_hand, hand.vertices), name="from-table",
    )  # fmt: skip
    clip = replace(clip, frames=tuple(f"{n:06d}" for n in range(len(T_world_cam))))
    pairs = [
        true_masks(
            (se3.transform(T_cam_obj[n], truth.scale * held.mesh.vertices), held.mesh.faces),
            [(se3.transform(T_cam_hand[n], hand.vertices[n]), hand.faces)], [], clip.K[n], clip.size,
        )
        for n in range(len(clip))
    ]  # fmt: skip
    return clip, Masks(np.stack([p[0] for p in pairs]), np.stack([p[1] for p in pairs]))
