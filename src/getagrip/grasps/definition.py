"""The definition of a stable grasp, as numbers and names. Light: the command line loads it to show its help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from getagrip.errors import UsageError
from getagrip.io.choices import check_values

Points = Literal["vertices", "area", "fragments"]
Rule = Literal["all-pairs", "first", "consecutive", "touch"]
"""Which frames are tested: all pairs (Eq. 2), pairs as in the authors' codes, or none, see ``stable.stable_grasps``."""
RULES: tuple[Rule, ...] = get_args(Rule)
FEWEST = 2
"""Frames of the shortest grasp that can be a clip: one silhouette says nothing about a motion."""


@dataclass(frozen=True)
class Definition:
    """The definition of a stable grasp.

    Attributes:
        tau: every pair of frames has a contact IOU above this.
        contact: points of the object are in contact within this signed distance of the hand's surface [m].
        points: points of the object whose contact counts.
        rule: which pairs of frames are compared.
        shortest: number of frames of the shortest grasp.
    """

    tau: float = 0.5
    contact: float = 0.0
    points: Points = "vertices"
    rule: Rule = "all-pairs"
    shortest: int = 20

    def __post_init__(self) -> None:
        check_values(self)
        if not 0.0 <= self.tau < 1.0:
            raise UsageError(f"tau must be at least 0 and below 1 (got {self.tau:g})")
        if not 0.0 <= self.contact <= 0.05:
            raise UsageError(f"contact must be 0 to 50 mm (got {1e3 * self.contact:g} mm)")
        if self.shortest < 1:
            raise UsageError(f"shortest must be 1 frame or more (got {self.shortest})")

    @property
    def description(self) -> str:
        """In words: "vertices within 10 mm, IOU above 0.3, all-pairs, 2 frames or more"."""
        tested = "any contact" if self.rule == "touch" else f"IOU above {self.tau:g}, {self.rule}"
        return f"{self.points} within {1e3 * self.contact:g} mm, {tested}, {self.shortest} frames or more"
