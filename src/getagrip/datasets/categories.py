"""What made-up clips can hold: for each category the object and the ways to take it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from getagrip.datasets import shapes
from getagrip.datasets.grasp import Grip
from getagrip.mesh import Mesh


@dataclass(frozen=True)
class Kind:
    """A category: how to make the object, and the ways to take it."""

    make: Callable[[], Mesh]
    grips: tuple[Grip, ...]


CATEGORIES: dict[str, Kind] = {
    "bottle": Kind(shapes.bottle, (Grip("palm", (0, 0, -0.02), (1, 0, 0), (0, 0, 1)),)),
    "bowl": Kind(shapes.bowl, (Grip("pinch", (0.072, 0, 0.055), (-0.25, 0, -1), (1, 0, 0)),)),
    "can": Kind(shapes.can, (Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, 1)),)),
    "cup": Kind(shapes.cup, (Grip("pinch", (0.058, 0, 0.042), (-1, 0, 0), (0, -1, 0)),)),
    "glass": Kind(shapes.glass, (Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, 1)),)),
    "mug": Kind(
        shapes.mug,
        (
            Grip("palm", (0.077, 0, 0.05), (-1, 0, 0), (0, 0, 1)),  # by the handle
            Grip("palm", (0, 0, 0.05), (0.3, 1, 0), (0, 0, 1)),  # round the body, the handle beyond the fingers
        ),
    ),
    "pan": Kind(shapes.pan, (Grip("palm", (0, 0, 0), (0, 0.5, -1), (-1, 0, 0)),)),
    "plate": Kind(shapes.plate, (Grip("pinch", (0.09, 0, 0.016), (-1, 0, 0), (0, 0, -1)),)),
    "saucepan": Kind(shapes.saucepan, (Grip("palm", (0, 0, 0), (0, 0.5, -1), (-1, 0, 0)),)),
    "box": Kind(shapes.box, (Grip("palm", (0, -0.06, 0), (0, 1, 0), (0, 0, 1)),)),
    "kettle": Kind(shapes.kettle, (Grip("palm", (0.127, 0, 0.085), (-1, 0, 0), (0, 0, 1)),)),
    "ketchup": Kind(shapes.ketchup, (Grip("palm", (0, 0, 0.02), (1, 0, 0), (0, 0, 1)),)),
    "laptop": Kind(shapes.laptop, (Grip("pinch", (0.1, 0, 0), (-1, 0, 0), (0, 0, -1)),)),
    "phone": Kind(shapes.phone, (Grip("palm", (0, -0.01, 0), (0, 0, 1), (0, 1, 0)),)),
    "scissors": Kind(shapes.scissors, (Grip("pinch", (-0.095, 0, 0), (1, 0, 0), (0, 0, -1)),)),
    "spoon": Kind(shapes.spoon, (Grip("pinch", (-0.06, 0, 0.009), (1, 0, 0), (0, 0, -1)),)),
}
"""The nine categories of EPIC-Grasps, then others."""
