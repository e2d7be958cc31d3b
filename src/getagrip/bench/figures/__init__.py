"""Figures of results.

A new kind is a file here with a subclass of ``FigureKind``, whose fields are its options, and a line in ``FIGURES``.
"""

from getagrip.bench.figures.aligned import Aligned
from getagrip.bench.figures.contact_figure import Contact
from getagrip.bench.figures.gallery import Gallery
from getagrip.bench.figures.ihoi import Ihoi
from getagrip.bench.figures.kind import FigureKind
from getagrip.bench.figures.rows import Hands, Methods
from getagrip.report.pictures.stored_results import StoredResult

FIGURES: dict[str, type[FigureKind]] = {
    "contact": Contact,
    "aligned": Aligned,
    "methods": Methods,
    "hands": Hands,
    "ihoi": Ihoi,
    "gallery": Gallery,
}

__all__ = ["FIGURES", "FigureKind", "StoredResult"]
