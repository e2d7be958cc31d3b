"""Several results of one clip under one another, after the paper's qualitative comparison of methods."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from getagrip.clip import input_sha256
from getagrip.errors import InputError
from getagrip.fitting.methods import method_of
from getagrip.metrics.contact import at_millimetres
from getagrip.pictures.figures.kind import Count, Fail, Kind, Millimetres, about, readable
from getagrip.pictures.figures.rows import Row, draw_rows, numbers
from getagrip.pictures.given import GivenResult, at_common_frames, distinct
from getagrip.pictures.shown import View

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Methods(Kind):
    """Results of several methods for one clip: frames over the image and from the side; IOU, SCA and ADD."""

    frames: Count = 3
    """Frames to draw."""
    contact: Millimetres = 10.0
    """Points of the object within MM of the hand's surface are in contact, in SCA."""
    truth: bool = True
    """Draw the ground truth as the last row, where it is known."""

    def draw(self, results: Sequence[GivenResult], fail: Fail) -> Figure:
        (contact,) = at_millimetres([self.contact])
        read = readable(results, fail)
        views = at_common_frames(read)
        _check_inputs(read)
        labels = [method_of(view.result.method).label for view in views]
        folders = distinct([given for given, _ in read])
        names = [f"{a}\n{b}" if Counter(labels)[a] > 1 else a for a, b in zip(labels, folders, strict=True)]
        rows = [Row(name, numbers(view, contact), view) for name, view in zip(names, views, strict=True)]
        if self.truth and (true := views[0].true()) is not None:
            rows.append(Row("ground truth", numbers(true, contact)[:2], true))
        under = "  ·  ".join([*about(views[0]), f"SCA: {contact.description}"])
        return draw_rows(rows, views[0].clip.name, under, self.frames, self.dpi, with_hand=False)


def _check_inputs(read: Sequence[tuple[GivenResult, View]]) -> None:
    """Refuse results that were made with different hands, masks or meshes."""
    first, clip = read[0][0], read[0][1].clip
    for given, view in read[1:]:
        if view.clip.origin != clip.origin and input_sha256(view.clip.origin) != input_sha256(clip.origin):
            expected = f"those of {first.folder}; the figure hands compares hands"
            raise InputError(given.folder, "", f"a result of other hands or masks, in {view.clip.origin}", expected)
