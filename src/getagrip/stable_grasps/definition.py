"""The definition of a stable grasp, and its options. A light import: the command line loads it for its help."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from tyro.conf import arg

from getagrip.errors import UsageError
from getagrip.io.options import OptionalFile, check_values

if TYPE_CHECKING:
    from getagrip.stable_grasps.find import CutRules

Points = Literal["vertices", "area", "fragments"]
Rule = Literal["all-pairs", "first", "consecutive", "touch"]
"""Pairs of frames that are compared: all (Eq. 2), some as in the authors' codes, or none (``find.stable_grasps``)."""
GRASP_RULES: tuple[Rule, ...] = get_args(Rule)
MIN_GRASP_FRAMES = 2
"""Minimum number of frames of a grasp that becomes a clip: a single silhouette shows no motion."""


@dataclass(frozen=True)
class Definition:
    """The definition of a stable grasp.

    Attributes:
        tau: every pair of frames has a contact IOU above this.
        contact: points of the object are in contact within this signed distance of the hand's surface [m].
        points: points of the object that are tested for contact.
        rule: pairs of frames that are compared.
        shortest: minimum number of frames of a grasp.
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
        """The definition in words: "vertices within 10 mm, IOU above 0.3, all-pairs, 2 frames or more"."""
        tested = "any contact" if self.rule == "touch" else f"IOU above {self.tau:g}, {self.rule}"
        return f"{self.points} within {1e3 * self.contact:g} mm, {tested}, {self.shortest} frames or more"


def _distance_help(value: str) -> str:
    return f"(default: {'0, or 10 with --from-masks' if value == 'None' else value})"


@dataclass(frozen=True, kw_only=True)
class GraspOptions:
    """The definition of a stable grasp, or a list of the grasps."""

    tau: float = 0.5
    """In a stable grasp, the contacts of any two frames have an intersection over union (IOU) above this."""
    contact_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint=_distance_help)] = None
    """Points of the object at most this far from the hand's surface, or inside it, are in contact."""
    points: Points = "vertices"
    """Points of the object that are tested for contact: its vertices, points sampled evenly over its surface (area), or
    patches of it (fragments)."""
    rule: Rule = "all-pairs"
    """Pairs of frames whose contacts are compared. all-pairs: the paper's definition; first (each frame with the first)
    and consecutive (neighbours) are weaker; touch compares none: a grasp is an uninterrupted contact."""
    shortest: Annotated[int, arg(metavar="N")] = 20
    """Number of frames of the shortest grasp."""
    listed: Annotated[OptionalFile, arg(name="list", aliases=("--intervals",))] = None
    """Use the grasps of this list instead of --tau, --rule and --shortest: a list written by import, segment, study or
    annotate, your own (docs/formats.md), or the authors' hot3d_hit.json."""

    def definition(self, contact_mm: float = 0.0) -> Definition:
        """Return the definition; ``contact_mm`` is the contact distance unless the options have one.

        Raises ``UsageError``.
        """
        within = contact_mm if self.contact_mm is None else self.contact_mm
        return Definition(self.tau, within / 1e3, self.points, self.rule, self.shortest)

    def cut(self, note: Callable[[str], None]) -> CutRules:
        """Return the rules for cutting sequences, with the list read. Raises ``UsageError`` and ``InputError``."""
        from getagrip.stable_grasps.find import CutRules
        from getagrip.stable_grasps.grasp_lists import read_listed_grasps

        return CutRules(self.definition(), None if self.listed is None else read_listed_grasps(self.listed, note))
