"""The ways to reconstruct a timeline that a benchmark compares."""

from __future__ import annotations

from collections.abc import Callable

from getagrip.clip import Clip, Masks
from getagrip.fitting.options import Options
from getagrip.timelines.baselines import grasp_only, propagate, static_only
from getagrip.timelines.footage import Footage
from getagrip.timelines.joint import joint
from getagrip.timelines.motion import Motion

VARIANTS: dict[str, Callable[[Footage], Motion]] = {
    "grasp only": grasp_only,
    "static only": static_only,
    "propagate": propagate,
    "joint": lambda footage: joint(footage, support=False),
    "joint + plane": joint,
}
"""The last is what ``getagrip reconstruct`` does."""


def reconstruct_with(variant: str, clip: Clip, masks: Masks, options: Options) -> Motion:
    """An object's motion in a clip of known scale, found one of the ways. Raises as that way does."""
    return VARIANTS[variant](Footage.of(clip.light(), masks, options))
