"""Figures of results.

A new kind is a file here with a subclass of ``FigureKind``, whose fields are its options, and a line in ``FIGURES``.
"""

from getagrip.pictures.figures.aligned import Aligned
from getagrip.pictures.figures.contact import Contact
from getagrip.pictures.figures.gallery import Gallery
from getagrip.pictures.figures.ihoi import Ihoi
from getagrip.pictures.figures.kind import FigureKind
from getagrip.pictures.figures.rows import Hands, Methods
from getagrip.pictures.stored_results import StoredResult

FIGURES: dict[str, type[FigureKind]] = {
    "contact": Contact,
    "aligned": Aligned,
    "methods": Methods,
    "hands": Hands,
    "ihoi": Ihoi,
    "gallery": Gallery,
}

__all__ = ["FIGURES", "FigureKind", "StoredResult"]
