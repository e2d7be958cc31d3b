"""Figures of results, a file for each kind.

A new kind is a file here with a subclass of ``Kind``, whose fields are its options, and a line in ``FIGURES``.
"""

from getagrip.view.figures.aligned import Aligned
from getagrip.view.figures.contact import Contact
from getagrip.view.figures.gallery import Gallery
from getagrip.view.figures.hands import Hands
from getagrip.view.figures.kind import Kind
from getagrip.view.figures.methods import Methods
from getagrip.view.given import GivenResult

FIGURES: dict[str, type[Kind]] = {
    "contact": Contact,
    "aligned": Aligned,
    "methods": Methods,
    "hands": Hands,
    "gallery": Gallery,
}

__all__ = ["FIGURES", "GivenResult", "Kind"]
