"""A dataset whose parts have clips of every kind, which other processes can read, too.

Where the checkout is, and the folder of data beside it that only some machines have.

Libraries that few tests use. Only those tests import them: what a file of tests imports, every process imports.

Packages of other people, installed into a folder.

The type of the fixture ``run``.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from getagrip.clip import Clip, Masks
from getagrip.errors import InputError
from getagrip.readers.datasets.dataset import Dataset, Draft, Missing, Note
from helpers.clips import small_clip

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where some of ``DATA`` is absent."""
    return pytest.mark.skipif(not path.exists(), reason=f"needs {path.relative_to(ROOT.parent)} beside the checkout")


def folder_of(variable: str) -> pytest.MarkDecorator:
    """Give a test the ``folder`` that an environment variable names; skip it where none is named."""
    named = os.environ.get(variable)
    reason = f"needs {variable}, the folder of a dataset (CONTRIBUTING.md)"
    return pytest.mark.parametrize(
        "folder", [pytest.param(Path(named or "."), marks=pytest.mark.skipif(named is None, reason=reason))], ids=[""]
    )


def import_path() -> dict[str, str]:
    """The environment of a Python that imports this package and the tests' helpers, wherever it runs."""
    return os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT / "src"), str(ROOT / "tests")))}


def needs_library(library: str, extra: str | None = None) -> pytest.MarkDecorator:
    """Skip where a library is absent, which an extra of the package brings."""
    advice = f": pip install -e '.[{extra}]'" if extra else ""
    return pytest.mark.skipif(find_spec(library) is None, reason=f"{library} is not installed{advice}")


@dataclass(frozen=True)
class Shelf:
    """A part with four clips: the second is damaged, of the third nothing is left. "endless" takes a minute."""

    name: str
    handless: bool = False

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        if self.name == "endless":
            time.sleep(60.0)
        for n in range(4):
            name = f"{self.name}-{n}"
            if missing(name, with_hands=not self.handless):
                yield Draft(name, partial(self.make, n, name, note))
        if self.name == "torn":
            raise InputError(self.name, "", "half a file", "a whole one")

    def make(self, n: int, name: str, note: Note) -> tuple[Clip, Masks | None] | None:
        clip, masks = small_clip()
        if n == 1:
            raise InputError(name, "", "a damaged file", "a whole one")
        if n == 2:
            note(f"{name}: nothing is visible: skipped")
            return None
        if self.handless:
            clip = replace(
                clip, hand=replace(clip.hand, vertices=clip.hand.vertices[:, :0], faces=clip.hand.faces[:0], regions={})
            )
        return replace(clip, name=name), masks


@dataclass(frozen=True, kw_only=True)
class Library(Dataset):
    parts_are = "shelves"

    shelves: tuple[Shelf, ...]

    def parts(self, note: Note) -> tuple[Shelf, ...]:
        return self.shelves

    def advice(self, made: object, handless: int) -> Iterator[str]:
        yield f"{handless} handless"


def write_package(folder: Path, name: str, version: str, code: str, **entries: str) -> Path:
    """Install a package of one module, with the lines of each group of its entry points; returns the module's file."""
    about = folder / f"{name}-{version}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8")
    groups = "".join(f"[getagrip.{group}]\n{lines}\n" for group, lines in entries.items())
    (about / "entry_points.txt").write_text(groups, encoding="utf-8")
    file = folder / f"{name}.py"
    file.write_text(code, encoding="utf-8")
    return file


Run = Callable[..., tuple[int, str, str]]
"""Call the command line with some arguments; returns the exit status, stdout and stderr."""
