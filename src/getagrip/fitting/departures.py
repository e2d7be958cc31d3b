"""Where our hinge departs from the paper's method, departure by departure."""

from __future__ import annotations

from dataclasses import dataclass

from getagrip.errors import UsageError


@dataclass(frozen=True)
class Departures:
    """What ``paper`` does our way; nothing, and it is the paper's method to the letter.

    With all of them it is ``one-dof``. Raises ``UsageError`` for a search without its optimiser.

    Attributes:
        scale: push and pull weigh by the area of the masks (``objective.contact_weights``), instead of 0.1 f per
            millimetre.
        push: mean depth of the contact vertices in the object (``PushTerm``), instead of the sum of the depths of the
            object's vertices behind the hand's tangent planes (``PaperPushTerm``).
        pairs: in the paper's pull, the height over the tangent plane of the nearest vertex, as it must be meant,
            instead of the least height over any, as it is printed (``PaperPullTerm``).
        pull: distance to the surface, at most 1 cm (``PullTerm``), instead of the signed height over a tangent plane of
            the object (``PaperPullTerm``).
        axis: axis and angles start from the data, by a coarse static and a coarse relaxed fit (``Search.relax``),
            instead of at the CAD's z-axis and at zero.
        optimiser: Levenberg-Marquardt (``solve.minimise``), instead of Adam (``adam.descend``).
        search: coarse to fine, pruned and rotated (``Search``), instead of every initial pose to its end.
        choice: the least energy, instead of the best IOU.
    """

    scale: bool = False
    push: bool = False
    pairs: bool = False
    pull: bool = False
    axis: bool = False
    optimiser: bool = False
    search: bool = False
    choice: bool = False

    def __post_init__(self) -> None:
        if self.search and not self.optimiser:
            raise UsageError("departures: got search without optimiser, whose stages are Levenberg-Marquardt's")


TO_THE_LETTER = Departures()
"""No departure."""
