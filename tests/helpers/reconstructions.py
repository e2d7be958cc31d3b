"""Reconstructions of synthetic clips that several tests look at, made once in each process."""

from __future__ import annotations

from functools import cache

from getagrip.fitting.options import Options
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import SMALL, scene

DEFAULT = Options(inits=16)


@cache
def found(category: str, seed: int, clip_options: SceneOptions = SMALL, options: Options = DEFAULT) -> Reconstruction:
    return reconstruct(*scene(category, seed, clip_options), options)
