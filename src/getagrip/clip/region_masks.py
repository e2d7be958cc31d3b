"""Masks from regions with labels, as annotators and trackers list them: polygons or run lengths.

A region is chosen by its label. Where there are several things of one label, as two cups, a thing is chosen by its own
number: ``cup:7``; ``cup:all`` takes them together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip.data import FrameMasks
from getagrip.clip.mask_request import MaskReader, MaskRequest, combine_hand_object_masks
from getagrip.clip.naming import MAX_NAMES_IN_ERROR
from getagrip.clip.segments import check_region_count, decode_region, drop_flat_polygons, run_length_size, union
from getagrip.errors import InputError
from getagrip.io import files

ALL_INSTANCES = "all"
ZERO_AREA_NOTE = "polygons without area were left out"


@dataclass(frozen=True, eq=False)
class Region:
    """A region of a thing in a frame."""

    key: str
    """Place in the file."""
    labels: tuple[str, ...]
    """By which it can be chosen; it is called by the first."""
    thing: str
    """Which of the things of that label it is of, in every frame; empty where the file does not say."""
    content: object
    """Polygons, run lengths or a picture."""
    size: tuple[int, int] | None = None
    """Width and height of its image; None for the clip's images'."""
    path: Path | None = None
    """Its file, where there are several."""

    @property
    def name(self) -> str:
        """Its label, and which thing of that label it is."""
        return f"{self.labels[0]}:{self.thing}" if self.thing else self.labels[0]

    def is_of(self, chosen: Sequence[str]) -> bool:
        """Return whether it is named."""
        return bool({*self.labels} & {*chosen}) or self.is_named_apart(chosen)

    def is_named_apart(self, chosen: Sequence[str]) -> bool:
        """Return whether it is named as itself, or as one of all."""
        return any({f"{label}:{self.thing}", f"{label}:{ALL_INSTANCES}"} & {*chosen} for label in self.labels)


def region_masks(path: Path, request: MaskRequest, regions: Mapping[int, Sequence[Region]]) -> MaskReader:
    """Open a reader of the regions of some frames.

    Raises ``InputError`` where it is not clear which are the object's.
    """
    frames = {n: _FrameRegions.of(of_frame, request) for n, of_frame in regions.items()}
    labels = {one.labels[0] for frame in frames.values() for one in frame.object}
    if not request.object and len(labels) > 1:
        raise InputError(path, "categories", f"several, {_join_label_names(labels)}", "one, or --object names it")
    warnings = (
        *_describe_label_ambiguity("--object", request.object, [frame.object for frame in frames.values()]),
        *_describe_label_ambiguity("--hand", request.hand, [frame.hand for frame in frames.values()]),
    )
    notes = Counter[str]()

    def drawn(found: Sequence[Region]) -> Bool[ndarray, "H W"]:
        check_region_count(path, "annotations", len(found), request.size)
        return union(_pixels(found), request.size)

    def _pixels(found: Sequence[Region]) -> Iterator[Bool[ndarray, "H W"]]:
        for one in found:
            content = drop_flat_polygons(one.content)
            if isinstance(one.content, list) and isinstance(content, list) and len(content) < len(one.content):
                notes[ZERO_AREA_NOTE] += len(one.content) - len(content)
            size = request.check_size(one.path or path, one.key, run_length_size(content) or one.size or request.size)
            yield request.resized(decode_region(one.path or path, one.key, content, size, notes), notes)

    def read(n: int) -> FrameMasks:
        frame = frames[n]
        return combine_hand_object_masks(
            drawn(frame.object), drawn(frame.ignore), drawn(frame.hand) if request.hand else None
        )

    chosen = {"--object": request.object, "--ignore": request.ignore, "--hand": request.hand}
    every = [one for of_frame in regions.values() for one in of_frame]
    unmet = {
        f"{option} {word}"
        for option, words in chosen.items()
        for word in words
        if not any(one.is_of([word]) for one in every)
    }
    everything = {one.name for one in every}
    return MaskReader(path, read, frames.keys(), {*sorted(everything)[:MAX_NAMES_IN_ERROR]}, unmet, notes, warnings)


@dataclass(frozen=True)
class _FrameRegions:
    """The regions of a frame that count, by what they are."""

    object: Sequence[Region]
    ignore: Sequence[Region]
    hand: Sequence[Region]

    @staticmethod
    def of(regions: Sequence[Region], request: MaskRequest) -> _FrameRegions:
        kinds: dict[str, list[Region]] = {"object": [], "ignore": [], "hand": []}
        chosen = {"hand": request.hand, "ignore": request.ignore, "object": request.object}
        for one in regions:
            kind = next((kind for kind, words in chosen.items() if one.is_of(words)), "")
            if kind or not request.object:
                kinds[kind or "object"].append(one)
        return _FrameRegions(**kinds)


def _describe_label_ambiguity(option: str, chosen: Sequence[str], frames: Sequence[Sequence[Region]]) -> Iterator[str]:
    """Say which labels several things are chosen by, and how to choose one."""
    by_label: dict[str, list[list[Region]]] = {}
    for of_frame in frames:
        here: dict[str, list[Region]] = {}
        for one in of_frame:
            if not one.is_named_apart(chosen):
                here.setdefault(one.labels[0], []).append(one)
        for label, found in here.items():
            by_label.setdefault(label, []).append(found)
    for label, each in by_label.items():
        things = {one.thing for found in each for one in found}
        counts = [sum(not one.thing for one in found) + len({one.thing for one in found} - {""}) for found in each]
        if len(things) < 2 and max(counts) < 2:
            continue
        name, several = files.printable(label), sum(count > 1 for count in counts)
        where = f"{max(counts)} regions in {several} of {len(frames)} frames" if several else "one in each frame"
        names = sorted(f"{label}:{one}" for one in things - {""})[:MAX_NAMES_IN_ERROR]
        way = (
            f"{option} chooses one: {' or '.join(map(files.printable, names))}"
            if names
            else "a track_id tells them apart"
        )
        yield (
            f"several things are called {name}, {where}, and were taken together; {way}; "
            f"{option} {name}:{ALL_INSTANCES} if all are meant"
        )


def _join_label_names(names: set[str]) -> str:
    return ", ".join(map(files.printable, sorted(names)[:MAX_NAMES_IN_ERROR]))
