"""Figures of results: one file for each subclass of ``FigureKind``, whose fields are its options; table ``FIGURES``."""

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
