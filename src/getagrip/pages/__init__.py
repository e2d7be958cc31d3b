"""Results as HTML pages that open from disk: each is one file, which asks for nothing else."""

from getagrip.pages.index import IndexRow, row, row_without_clip, write_index
from getagrip.pages.report import write_page

__all__ = ["IndexRow", "row", "row_without_clip", "write_index", "write_page"]
