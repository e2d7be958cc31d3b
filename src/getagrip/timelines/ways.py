"""The ways to reconstruct a timeline that a benchmark compares."""

from __future__ import annotations

from collections.abc import Callable

from getagrip.clip import Clip, Masks
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_hand
from getagrip.timelines.baselines import grasp_only, propagate, static_only
from getagrip.timelines.footage import Footage
from getagrip.timelines.joint import best_hypotheses, in_every_frame
from getagrip.timelines.motion import Motion

WAYS: dict[str, Callable[[Footage], Motion]] = {
    "grasp only": grasp_only,
    "static only": static_only,
    "propagate": propagate,
    "joint": lambda footage: in_every_frame(footage, best_hypotheses(footage, support=False)),
    "joint + plane": lambda footage: in_every_frame(footage, best_hypotheses(footage, support=True)),
}
"""The last is what ``getagrip reconstruct`` does."""


def moved(way: str, clip: Clip, masks: Masks, options: Options) -> Motion:
    """An object's motion in a clip of known scale, found one of the ways. Raises as that way does."""
    return WAYS[way](Footage.of(repair_hand(clip, masks, options)))
