"""Results as HTML pages: files that open from disk and ask for nothing else, and the served page of `getagrip view`."""

from getagrip.pages.index import IndexRow, index_row, index_row_without_clip, write_index
from getagrip.pages.report import write_page

__all__ = ["IndexRow", "index_row", "index_row_without_clip", "write_index", "write_page"]
