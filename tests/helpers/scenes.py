"""Synthetic clips that several tests look at, made once in each process. Nothing may be changed in them."""

from __future__ import annotations

from functools import cache

from getagrip.clip import Clip, Masks
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions

SMALL = SceneOptions(frames=8, size=(320, 240), focal=300.0)
SHORT = SceneOptions(frames=4, size=(320, 240), focal=300.0)


@cache
def scene(category: str, seed: int, options: SceneOptions = SMALL) -> tuple[Clip, Masks]:
    return synthesise(category, seed, options)
