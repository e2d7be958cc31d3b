"""The options by which sequences are cut to stable grasps: the same for every importer, ``segment`` and ``study``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.grasps.definition import Definition, Points, Rule
from getagrip.io.arguments import OptionalFile

if TYPE_CHECKING:
    from getagrip.grasps.cut import Cut


def _distance(value: str) -> str:
    """Return the text that help shows for a distance that was not given."""
    return f"(default: {'0, or 10 with --from-masks' if value == 'None' else value})"


@dataclass(frozen=True, kw_only=True)
class GraspOptions:
    """The definition of a stable grasp, or a list of the grasps."""

    tau: float = 0.5
    """In a stable grasp, the contacts of any two frames have an intersection over union (IOU) above this."""
    contact_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint=_distance)] = None
    """Points of the object at most this far from the hand's surface, or inside it, are in contact."""
    points: Points = "vertices"
    """Contact is a set of vertices, of points sampled evenly over the object's surface, or of patches."""
    rule: Rule = "all-pairs"
    """Frames that are compared: all (the paper's definition), all with the first, or neighbours (two weaker tests);
    touch: none, a grasp is an uninterrupted contact."""
    shortest: Annotated[int, arg(metavar="N")] = 20
    """Frames of the shortest grasp."""
    listed: Annotated[OptionalFile, arg(name="list", aliases=("--intervals",))] = None
    """Use the grasps of this list instead of tau, rule and shortest: one by import, segment, study or annotate, your
    own (docs/formats.md), or the authors' hot3d_hit.json."""

    def definition(self, contact_mm: float = 0.0) -> Definition:
        """Return the definition of a stable grasp, within ``contact_mm`` where nothing is said.

        Raises ``UsageError``.
        """
        within = contact_mm if self.contact_mm is None else self.contact_mm
        return Definition(self.tau, within / 1e3, self.points, self.rule, self.shortest)

    def cut(self, note: Callable[[str], None]) -> Cut:
        """Return the rule for cutting sequences; the list is read. Raises ``UsageError`` and ``InputError``."""
        from getagrip.grasps import lists
        from getagrip.grasps.cut import Cut

        return Cut(self.definition(), None if self.listed is None else lists.read(self.listed, note))
