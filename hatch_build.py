"""A step of the build: README and addresses of the package, as an index shows them.

There, links of README lead nowhere unless they are absolute. The repository is the one of the continuous integration
that builds (``GITHUB_REPOSITORY``), or ``GETAGRIP_REPOSITORY``. Without either, links within the repository become
their text, and its pictures are left out. ``GETAGRIP_SITE`` is the address of the documentation's site, if it has one:
pages are linked there, and docs/conf.py gives it to the pages as their own.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

PAPER = "https://arxiv.org/abs/2312.15719"
IMAGE = re.compile(r"!\[([^\]]*)\]\((?!https?://)([^)\s]+)\)\n*")
PAGE = re.compile(r"(?<!!)\[([^\]]*)\]\(docs/([\w-]+)\.md(#[^)\s]*)?\)")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!https?://|#)([^)\s]+)\)")
COMMENT = re.compile(r"^ *<!--.*?-->\n|<!--.*?-->", re.DOTALL | re.MULTILINE)


class CustomMetadataHook(MetadataHookInterface):
    """Fills in the readme and the addresses."""

    def update(self, metadata: dict) -> None:
        """Add both to the metadata of the package."""
        version = re.search(r'__version__ = "(.+)"', (Path(self.root) / "src/getagrip/__init__.py").read_text("utf-8"))
        assert version is not None
        home, pages, text = repository(), site(), (Path(self.root) / "README.md").read_text("utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": for_index(text, home, f"v{version[1]}", pages)}
        metadata["urls"] = addresses(home, pages)


def repository() -> str:
    """Return the address of the repository; empty where it is not known."""
    name = os.environ.get("GITHUB_REPOSITORY")
    server = os.environ.get("GITHUB_SERVER_URL")
    return os.environ.get("GETAGRIP_REPOSITORY") or (f"{server}/{name}" if server and name else "")


def site() -> str:
    """Return the address of the documentation's site, without a slash at its end; empty where it has none."""
    address = os.environ.get("GETAGRIP_SITE", "").rstrip("/")
    if address and not re.fullmatch(r"https?://[^\s()]+", address):
        raise ValueError(f"GETAGRIP_SITE must be the address of a site, https://... (got {address!r})")
    return address


def addresses(home: str, pages: str = "") -> dict[str, str]:
    """Make the table of addresses."""
    documentation = {"Documentation": f"{pages}/"} if pages else {}
    own = {"Source": home, "Issues": f"{home}/issues", "Changelog": f"{home}/blob/main/CHANGELOG.md"} if home else {}
    return {**documentation, **own, "Paper": PAPER}


def for_index(text: str, home: str, tag: str, pages: str = "") -> str:
    """Rewrite README: absolute links and pictures at the ``tag``, code fences as other programs know them.

    Links of pages of the documentation lead to the site ``pages``, where it has one.
    """
    if pages:
        text = PAGE.sub(lambda found: f"[{found[1]}]({pages}/{found[2]}.html{found[3] or ''})", text)
    text = COMMENT.sub("", text).replace("```python run", "```python")
    if not home:
        return LINK.sub(r"\1", IMAGE.sub("", text))
    text = IMAGE.sub(lambda found: f"![{found[1]}]({home}/raw/{tag}/{found[2]})\n\n", text)
    return LINK.sub(lambda found: f"[{found[1]}]({home}/blob/{tag}/{found[2]})", text)
