"""Results of one clip with the hands of several estimators, after the paper's figure of HaMeR and FrankMocap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from getagrip.errors import UsageError
from getagrip.metrics.contact import at_millimetres
from getagrip.pictures.figures.kind import Count, Fail, Kind, Millimetres, readable, summary
from getagrip.pictures.figures.rows import Row, draw_rows, numbers
from getagrip.pictures.given import GivenResult, at_common_frames, distinct

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Hands(Kind):
    """Results for one clip with the hands of several estimators: the given hand and the object that was found with it.

    Each result is of its own clip folder; these have the same clip's name and frames, and hands of their own. Rows are
    called after what tells the results' folders apart.
    """

    frames: Count = 3
    """Frames to draw."""
    contact: Millimetres = 10.0
    """Points of the object within MM of the hand's surface are in contact, in SCA."""

    def draw(self, results: Sequence[GivenResult], fail: Fail) -> Figure:
        (contact,) = at_millimetres([self.contact])
        read = readable(results, fail)
        views = at_common_frames(read)
        methods = {view.result.method for view in views}
        if len(methods) > 1:
            raise UsageError(f"RESULT must be of one method (got {' and '.join(sorted(methods))}); see methods")
        names = distinct([given for given, _ in read])
        rows = [Row(name, numbers(view, contact), view) for name, view in zip(names, views, strict=True)]
        under = "  ·  ".join([summary(views[0]), f"SCA: {contact.description}"])
        return draw_rows(rows, views[0].clip.name, under, self.frames, self.dpi, with_hand=True)
