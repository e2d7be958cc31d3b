"""The documentation as a site: ``make docs`` builds it into ``site/`` from these pages, as they are.

Nothing is fetched, neither when it is built nor when it is read. Pages are completed here: ``cli.md`` by the help of
every command, ``api.md`` by the docstrings of the public names.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "src"), str(ROOT / "scripts")]

import explorer  # noqa: E402
import reference  # noqa: E402

import getagrip  # noqa: E402
import hatch_build  # noqa: E402

project = "getagrip"
copyright = "the authors of getagrip, MIT licence"
version = release = getagrip.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4
highlight_language = "none"  # blocks without a language are commands or files
smartquotes = False  # it makes a dash of --out
toc_object_entries = False
autodoc_preserve_defaults = True
napoleon_use_ivar = True
napoleon_attr_annotations = False  # the signature has the types
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "inherited-members": False, "exclude-members": "__init__, __new__"}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
add_module_names = False

html_baseurl = hatch_build.site()  # links within the site are relative, with or without it
html_theme = "furo"
html_title = f"getagrip {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_search_summary = False  # it would fetch pages, which a browser refuses from disk
html_show_sphinx = False


def complete(_: Sphinx, page: str, text: list[str]) -> None:
    """Fill in what is generated in the place of a page's marker."""
    if explorer.MARKER in text[0]:
        text[0] = text[0].replace(explorer.MARKER, explorer.explorer())
    if page in reference.GENERATED:
        before, after = text[0].split(reference.MARKER)
        text[0] = before + reference.GENERATED[page]() + after


def linked(_app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Make links of the pages that a docstring names."""
    lines[:] = [re.sub(r"(?<!`)docs/([a-z-]+)\.md", r":doc:`\1`", line) for line in lines]


def plain(
    _app: Sphinx, _what: str, _name: str, _obj: object, _options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Write defaults that are made anew for each instance as Python can be written."""
    return signature and signature.replace("<factory>", "..."), returns


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", complete)
    app.connect("autodoc-process-docstring", linked)
    app.connect("autodoc-process-signature", plain)
