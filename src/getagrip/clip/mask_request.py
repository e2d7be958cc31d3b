"""Masks that are looked for in other programs' files: in which frames, of which labels; and their reader."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.naming import check_numbers, frames_of, stem_of
from getagrip.errors import InputError, UsageError
from getagrip.io import files, numbers

MOST_NAMED = 12
"""Labels that an error lists."""


def without_object(
    visible: Bool[ndarray, "H W"], hidden: Bool[ndarray, "H W"], hand: Bool[ndarray, "H W"] | None
) -> FrameMasks:
    """Combine the masks of a frame: the object's pixels take precedence, and the hand is ignored as well."""
    if hand is None:
        return FrameMasks(visible, hidden & ~visible)
    return FrameMasks(visible, (hidden | hand) & ~visible, hand & ~visible)


@dataclass(frozen=True)
class MaskReader:
    """The masks of a frame, by its index; None for a frame that has none. Calling it raises ``InputError``."""

    source: Path
    read: Callable[[int], FrameMasks]
    known: Collection[int]
    """The frames that have masks."""
    others: set[str] = field(default_factory=set)
    """Labels that were met so far in frames without the object, for an error about a label that is nowhere."""
    notes: dict[str, int] = field(default_factory=dict)
    """Notes on how unusual content was read, with counts."""
    warnings: tuple[str, ...] = ()
    """Warnings about content that is probably not what was meant."""

    def __call__(self, n: int) -> FrameMasks | None:
        with numbers.guarded(self.source):
            return self.read(n) if n in self.known else None


@dataclass(frozen=True)
class MaskRequest:
    """A request for the masks of a clip's frames."""

    frames: tuple[str, ...]
    """Names, or numbers, of the frames."""
    size: tuple[int, int]
    """Width and height of the images [px]."""
    object: tuple[str, ...] = ()
    """Labels of the object; where none is named, there may be one only."""
    ignore: tuple[str, ...] = ()
    """Labels of what hides it."""
    hand: tuple[str, ...] = ()
    """Those of the things that are the grasping hand; it need not be among the others."""
    ask_first: str = ""
    """The option that states the number of the first frame's mask, where it was not used."""
    images: str = ""
    """Which of the images are meant, where there are several of a frame: a folder, or a pattern of their names."""
    ask_images: str = "--images"
    """The option that says so."""

    def check_numbers(self, source: Path, names: Iterable[str]) -> None:
        """Raise ``UsageError`` where masks seem to be counted from another start than frames."""
        check_numbers(self.frames, names, source, "mask", self.ask_first)

    def places(self, source: Path, names: Sequence[str]) -> dict[int, int]:
        """Match images to frames by their file names, for the frames that have one.

        Raises ``UsageError`` where they seem to be counted from another start, and ``InputError`` where a frame has
        two, or none has one.
        """
        chosen = [k for k, name in enumerate(names) if self._is_meant(name)]
        if names and not chosen:
            some = f"a folder of {source}'s images or a pattern of their names, as {files.plain(names[0])}"
            raise UsageError(f"{self.ask_images} must be {some} (got {self.images!r})")
        self.check_numbers(source, (stem_of(names[k]) for k in chosen))
        found: dict[int, list[int]] = {}
        for k, n in zip(chosen, frames_of((stem_of(names[k]) for k in chosen), self.frames), strict=True):
            if n is not None:
                found.setdefault(n, []).append(k)
        several = next((n for n in sorted(found) if len(found[n]) > 1), None)
        if several is not None:
            first, second = (files.plain(names[k]) for k in found[several][:2])
            alternatives = sorted(_alternatives([names[k] for of_frame in found.values() for k in of_frame]))[
                :MOST_NAMED
            ]
            choice = (
                f"; {self.ask_images} chooses: {' or '.join(map(files.plain, alternatives))}"
                if len(alternatives) > 1
                else ""
            )
            got = f"a second mask of frame {files.plain(self.frames[several])}, {second} beside {first}"
            raise InputError(source, "", got, f"one{choice}")
        if not found:
            raise self.nothing(source, names)
        return {n: of_frame[0] for n, of_frame in found.items()}

    def nothing(self, source: Path, names: Sequence[str]) -> InputError:
        """Make the error that there is no mask of any frame."""
        some = ", ".join(map(files.plain, names[:2])) + (", ..." if len(names) > 2 else "")
        got = f"no mask of any of {len(self.frames)} frames" + (f" among {some}" if names else "")
        return InputError(source, "", got, f"masks named like the frames, as {files.plain(self.frames[0])}")

    def _is_meant(self, name: str) -> bool:
        name, folder = name.replace("\\", "/"), self.images.strip("/")
        parent = str(PurePosixPath(name).parent)
        return not folder or f"/{folder}/" in f"/{parent}/" or fnmatchcase(name, self.images)


def _alternatives(names: Sequence[str]) -> set[str]:
    """Folders, suffixes or beginnings of names, whichever tell images of one frame apart."""
    paths = [PurePosixPath(name.replace("\\", "/")) for name in names]
    for alternatives in (
        {str(path.parent) for path in paths},
        {f"*{path.suffix}" for path in paths},
        {str(path.with_name(f"{path.stem.rstrip('0123456789')}*")) for path in paths},
    ):
        if len(alternatives) > 1:
            return alternatives
    return set()
