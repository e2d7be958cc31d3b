"""A step of the build: README and addresses of the package, as an index shows them.

There, links of README lead nowhere unless they are absolute. The repository is the one of the continuous integration
that builds (``GITHUB_REPOSITORY``), or ``GETAGRIP_REPOSITORY``. Without either, links within the repository become
their text, and its pictures are left out.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

PAPER = "https://arxiv.org/abs/2312.15719"
IMAGE = re.compile(r"!\[([^\]]*)\]\((?!https?://)([^)\s]+)\)\n*")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!https?://|#)([^)\s]+)\)")
COMMENT = re.compile(r"^ *<!--.*?-->\n|<!--.*?-->", re.DOTALL | re.MULTILINE)


class CustomMetadataHook(MetadataHookInterface):
    """Fills in the readme and the addresses."""

    def update(self, metadata: dict) -> None:
        """Add both to the metadata of the package."""
        version = re.search(r'__version__ = "(.+)"', (Path(self.root) / "src/getagrip/__init__.py").read_text("utf-8"))
        assert version is not None
        home, text = repository(), (Path(self.root) / "README.md").read_text("utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": for_index(text, home, f"v{version[1]}")}
        metadata["urls"] = addresses(home)


def repository() -> str:
    """Return the address of the repository; empty where it is not known."""
    name = os.environ.get("GITHUB_REPOSITORY")
    server = os.environ.get("GITHUB_SERVER_URL")
    return os.environ.get("GETAGRIP_REPOSITORY") or (f"{server}/{name}" if server and name else "")


def addresses(home: str) -> dict[str, str]:
    """Make the table of addresses."""
    own = {"Source": home, "Issues": f"{home}/issues", "Changelog": f"{home}/blob/main/CHANGELOG.md"} if home else {}
    return {**own, "Paper": PAPER}


def for_index(text: str, home: str, tag: str) -> str:
    """Rewrite README: absolute links and pictures at the ``tag``, code fences as other programs know them."""
    text = COMMENT.sub("", text).replace("```python run", "```python")
    if not home:
        return LINK.sub(r"\1", IMAGE.sub("", text))
    text = IMAGE.sub(lambda found: f"![{found[1]}]({home}/raw/{tag}/{found[2]})\n\n", text)
    return LINK.sub(lambda found: f"[{found[1]}]({home}/blob/{tag}/{found[2]})", text)
