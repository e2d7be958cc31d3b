"""What is written in the documentation: links, headings, commands and Python.

What a picture shows: its words, its parts, its pixels of a known colour.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from markdown_it import MarkdownIt
from markdown_it.token import Token
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

from helpers.environment import ROOT

PAGES = (*sorted((ROOT / "docs").glob("*.md")), *sorted(ROOT.glob("*.md")), ROOT / "examples" / "README.md")


@cache
def tokens(page: Path) -> tuple[Token, ...]:
    """The blocks of a page, and what is in their lines."""
    return tuple(MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8")))


@cache
def blocks(page: Path) -> tuple[Token, ...]:
    """The blocks of a page alone, several times as quick."""
    markdown = MarkdownIt("commonmark").enable("table").disable("inline")
    return tuple(markdown.parse(page.read_text(encoding="utf-8")))


def targets(page: Path) -> Iterator[str]:
    """Where a page's links and pictures lead."""
    inline = (child for token in tokens(page) for child in token.children or ())
    yield from (str(token.attrs.get("href") or token.attrs.get("src")) for token in inline if token.attrs)


@cache
def anchors(page: Path) -> frozenset[str]:
    """The anchors of a page's headings, as GitHub and the site name them."""
    found: list[str] = []
    for heading, content in zip(tokens(page), tokens(page)[1:], strict=False):
        if heading.type == "heading_open":
            words = "".join(child.content for child in content.children or ()).strip().lower()
            slug = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
            found.append(f"{slug}-{found.count(slug)}" if slug in found else slug)
    return frozenset(found)


def python(page: Path, info: str = "") -> list[str]:
    """A page's Python; with ``info`` only what is marked so."""
    if "```python" not in page.read_text(encoding="utf-8"):  # as every process that collects tests asks
        return []
    return [
        token.content
        for token in blocks(page)
        if token.type == "fence" and token.info.startswith("python") and token.info.endswith(info)
    ]


def commands(page: Path, section: str) -> list[list[str]]:
    """The words of each command in the indented blocks of a section; the section's page stops at the next heading."""
    lines, here = [], False
    for token, content in zip(blocks(page), (*blocks(page)[1:], None), strict=True):
        if token.type == "heading_open":
            here = content is not None and content.content == section
        elif token.type == "code_block" and here:
            lines += token.content.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def read_picture(path: Path) -> np.ndarray:
    """The picture as (H, W, 3) RGB."""
    picture = cv2.imread(str(path))
    assert picture is not None
    return picture[..., ::-1]


def pixels_of(picture: np.ndarray, colour: str) -> int:
    """The number of pixels that have nearly this colour."""
    near = np.ones(picture.shape[:2], dtype=bool)
    for channel, value in zip(np.moveaxis(picture, -1, 0), to_rgb(colour), strict=True):
        near &= (np.abs(np.arange(256) / 255.0 - value) < 0.06)[channel]
    return int(near.sum())


def texts(figure: Figure) -> set[str]:
    """All that is written in a figure."""
    return {text.get_text() for text in figure.findobj(Text)} - {""}


def pixels(figure: Figure) -> np.ndarray:
    """The figure as (H, W, 3) RGB."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]


def panel(picture: np.ndarray, axes: Axes) -> np.ndarray:
    """The part of the picture that some axes take."""
    height, width, _ = picture.shape
    box = axes.get_position()
    rows = slice(int((1.0 - box.y1) * height), int((1.0 - box.y0) * height))
    return picture[rows, int(box.x0 * width) : int(box.x1 * width)]
