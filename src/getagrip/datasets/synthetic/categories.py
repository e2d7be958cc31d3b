"""What synthetic clips can hold: for each category the object and the ways to take it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from getagrip.datasets.synthetic import appliances, shapes
from getagrip.datasets.synthetic.grasp import Grip
from getagrip.geometry.mesh import Mesh


@dataclass(frozen=True)
class Kind:
    """A category: how to make the object, and the ways to take it."""

    make: Callable[[], Mesh]
    grips: tuple[Grip, ...]
    rarer: tuple[Grip, ...] = ()
    """Further ways, for clips whose grasps are to vary."""


_ROUND = Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, 1))
_ROUND_THUMB_DOWN = Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, -1))
_BAR = Grip("palm", (0, 0, 0), (0, 0.5, -1), (-1, 0, 0))
_BAR_FROM_BELOW = Grip("palm", (0, 0, 0), (0, -0.6, 1), (-1, 0, 0))


def _rim(radius: float, height: float) -> Grip:
    """By the rim of a vessel, the thumb inside."""
    return Grip("pinch", (radius, 0, height), (-0.25, 0, -1), (1, 0, 0))


CATEGORIES: dict[str, Kind] = {
    "bottle": Kind(
        shapes.bottle,
        (Grip("palm", (0, 0, -0.02), (1, 0, 0), (0, 0, 1)),),
        (Grip("palm", (0, 0, 0.06), (1, 0, 0), (0, 0, 1)), Grip("palm", (0, 0, 0.03), (1, 0, 0), (0, 0, -1))),
    ),
    "bowl": Kind(shapes.bowl, (Grip("pinch", (0.072, 0, 0.055), (-0.25, 0, -1), (1, 0, 0)),)),
    "can": Kind(shapes.can, (_ROUND,), (_ROUND_THUMB_DOWN,)),
    "cup": Kind(
        shapes.cup,
        (Grip("pinch", (0.058, 0, 0.042), (-1, 0, 0), (0, -1, 0)),),
        (Grip("pinch", (0, -0.042, 0.055), (0, 0.25, -1), (0, -1, 0)),),  # by the rim
    ),
    "glass": Kind(shapes.glass, (_ROUND,), (_ROUND_THUMB_DOWN, _rim(0.036, 0.055))),
    "mug": Kind(
        shapes.mug,
        (
            Grip("palm", (0.077, 0, 0.05), (-1, 0, 0), (0, 0, 1)),  # by the handle
            Grip("palm", (0, 0, 0.05), (0.3, 1, 0), (0, 0, 1)),  # round the body, the handle beyond the fingers
        ),
        (Grip("pinch", (0, -0.039, 0.085), (0, 0.25, -1), (0, -1, 0)),),  # by the rim
    ),
    "pan": Kind(shapes.pan, (_BAR,), (_BAR_FROM_BELOW,)),
    "plate": Kind(shapes.plate, (Grip("pinch", (0.09, 0, 0.016), (-1, 0, 0), (0, 0, -1)),)),
    "saucepan": Kind(shapes.saucepan, (_BAR,), (_BAR_FROM_BELOW,)),
    "box": Kind(
        shapes.box,
        (Grip("palm", (0, -0.06, 0), (0, 1, 0), (0, 0, 1)),),
        (Grip("palm", (0, 0, 0.085), (0, 0, -1), (0, 1, 0)),),  # from above
    ),
    "capsule_machine": Kind(appliances.capsule_machine, (Grip("palm", (-0.03, 0, 0), (1, 0, 0), (0, 0, 1)),)),
    "espresso_machine": Kind(
        appliances.espresso_machine,
        (
            Grip("palm", (0.145, 0, 0.013), (0, 0.5, -1), (-1, 0, 0)),  # by the filter's handle
            Grip("palm", (-0.055, 0, -0.01), (1, 0, 0), (0, 0, 1)),  # by the column
        ),
    ),
    "kettle": Kind(shapes.kettle, (Grip("palm", (0.127, 0, 0.085), (-1, 0, 0), (0, 0, 1)),)),
    "ketchup": Kind(shapes.ketchup, (Grip("palm", (0, 0, 0.02), (1, 0, 0), (0, 0, 1)),)),
    "laptop": Kind(shapes.laptop, (Grip("pinch", (0.1, 0, 0), (-1, 0, 0), (0, 0, -1)),)),
    "microwave": Kind(appliances.microwave, (Grip("palm", (0.151, 0.078, 0), (-1, -0.35, 0), (0, 0, 1)),)),
    "mixer": Kind(appliances.mixer, (Grip("palm", (0, 0, 0.084), (0, 0.5, -1), (1, 0, 0)),)),
    "notebook": Kind(appliances.notebook, (Grip("pinch", (0.055, 0, 0), (-1, 0, 0), (0, 0, -1)),)),
    "phone": Kind(shapes.phone, (Grip("palm", (0, -0.01, 0), (0, 0, 1), (0, 1, 0)),)),
    "scissors": Kind(shapes.scissors, (Grip("pinch", (-0.095, 0, 0), (1, 0, 0), (0, 0, -1)),)),
    "spoon": Kind(shapes.spoon, (Grip("pinch", (-0.06, 0, 0.009), (1, 0, 0), (0, 0, -1)),)),
    "waffle_iron": Kind(appliances.waffle_iron, (_BAR,), (_BAR_FROM_BELOW,)),
}
"""The nine categories of EPIC-Grasps, then those of ARCTIC and others."""
