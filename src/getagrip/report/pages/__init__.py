"""HTML pages of results: self-contained files, and the page that `getagrip view` serves."""

from getagrip.report.pages.index_page import IndexRow, index_row, index_row_without_clip, write_index
from getagrip.report.pages.result_page import write_page

__all__ = ["IndexRow", "index_row", "index_row_without_clip", "write_index", "write_page"]
