"""``getagrip import hands``: an estimator's hands into a clip that lacks them, or into a file for one to come."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.camera_of_image import doubt
from getagrip.clip.intrinsics import Lens, intrinsics
from getagrip.clip.numbering import renumbered
from getagrip.clip.plausible import check_in_view
from getagrip.clip.provenance import as_arrays, warn_of
from getagrip.clip.reading import OTHER_HAND, ClipHeader, frames_with_hand, read_header
from getagrip.clip.writing import WITHOUT_HAND, without_hand, write_hand, write_hand_at
from getagrip.errors import InputError, UsageError
from getagrip.hands.model import Side
from getagrip.hands.trackers import CHOSEN, HELD, Hands, Request, Tracker, read
from getagrip.io import files
from getagrip.io.terminal import report, say

PREFIX = "other_"
"""Of what a clip's provenance says of the other hand."""
MOST_FRAMES = 20_000
"""Of a hand file."""
DOUBTED = 3
"""Exit status where the hands are written, and something seems to be wrong with them or with the camera."""


@dataclass(frozen=True)
class NewFrames:
    """The frames of a clip that is yet to be made; None for what is not given."""

    side: Side | None
    numbers: tuple[int, int] | None
    """Of the first and the last frame, both included."""
    size: tuple[int, int] | None
    """Width and height of the images [px]."""
    lens: Lens

    @property
    def given(self) -> bool:
        """Whether anything is."""
        return bool(self.side or self.numbers or self.size or self.lens.given)


def import_hands(
    paths: Sequence[Path],
    tracker: Tracker,
    mano: Path | None,
    clip: Path | None,
    out: Path | None,
    new: NewFrames,
    hold_ends: bool,
    other: bool,
    first: int | None,
    overwrite: bool,
) -> int:
    """Add hands to a clip, or write a file of them. Raises ``UsageError`` for options that do not fit.

    ``hold_ends``: with hands in the frames before the first and after the last one (``Hands.held_at_ends``).
    ``other``: the hand of the other side than the clip's. ``first``: the number of the first frame's hand.
    """
    if other and (hold_ends or clip is None):
        given = "--hold-ends" if hold_ends else "no --clip"
        raise UsageError(f"--other-hand: got {given}, expected --clip, and the hand in the frames that have it")
    if not paths:
        raise UsageError("FILE: got none, expected the estimator's files")
    if clip is not None and out is None:
        if new.given:
            raise UsageError("--side, --frames, --size, --K: got some, expected none with --clip, which has them")
        if other:
            return other_into_clip(paths, tracker, mano, clip, first, overwrite)
        return into_clip(paths, tracker, mano, clip, hold_ends, first, overwrite)
    if out is not None and clip is None:
        return into_file(paths, tracker, mano, new, out, hold_ends, first, overwrite)
    raise UsageError(f"--clip, --out: got {'both' if clip else 'neither'}, expected one of them")


def into_clip(
    paths: Sequence[Path],
    tracker: Tracker,
    mano: Path | None,
    folder: Path,
    hold_ends: bool,
    first: int | None,
    overwrite: bool,
) -> int:
    """Add ``hand.npz`` to a clip's folder. Where frames lack a hand it names those that have one.

    The clip keeps its other frames, whose hands may come later. Raises ``UsageError`` where there are hands already.
    """
    header = read_header(folder)
    target = header.folder / "hand.npz"
    if target.exists() and not overwrite:
        raise UsageError(f"{target}: exists already; --overwrite replaces it")
    side: Side = header.fields["side"]
    request = _request(side, header.frames, header.K, header.size, mano, first)
    hands = read(paths, tracker, replace(request, hand_masks=_hand_masks(header)))
    check_in_view(paths[0], hands.track, header.K[list(hands.found)], header.size)
    hands = hands.held_at_ends(header.frames) if hold_ends else hands
    if len(hands.found) < len(header.frames) and (header.folder / "truth.npz").exists():
        missing = len(header.frames) - len(hands.found)
        raise UsageError(f"{folder}: got no hand in {missing} frames, expected one in each, since it has a truth.npz")
    with files.new_file(target) as hand, files.new_file(header.folder / "clip.json") as fields:
        write_hand_at(hands.track, header.frames, hands.found, hand)
        files.write_json(fields, _fields(header, hands))
    _report(hands, header.frames)
    say(str(target))
    return _status(header.K, header.size, _doubts(hands, len(header.frames)))


def other_into_clip(
    paths: Sequence[Path], tracker: Tracker, mano: Path | None, folder: Path, first: int | None, overwrite: bool
) -> int:
    """Add ``other_hand.npz``, in the frames in which it was found. Raises ``UsageError`` where there is one already,
    and ``InputError`` where none of these frames has the clip's own hand."""
    header = read_header(folder)
    target = header.folder / OTHER_HAND
    if target.exists() and not overwrite:
        raise UsageError(f"{target}: exists already; --overwrite replaces it")
    own = frames_with_hand(files.inside(header.folder, "hand.npz", "", "the clip's own hand first"), header.frames)
    side: Side = "left" if header.fields["side"] == "right" else "right"
    hands = read(paths, tracker, _request(side, header.frames, header.K, header.size, mano, first))
    check_in_view(paths[0], hands.track, header.K[list(hands.found)], header.size)
    alone = sorted({*hands.found} - {*own.tolist()})
    if len(alone) == len(hands.found):
        given = f"the {side} hand in {len(alone)} frames, in none of which the clip has its own"
        raise InputError(paths[0], "", given, "some in which it has: frames without it are left out (--hold-ends)")
    known = {key: text for key, text in header.fields["provenance"].items() if not key.startswith(PREFIX)}
    provenance = {PREFIX + key: text for key, text in hands.provenance.items()}
    with files.new_file(target) as hand, files.new_file(header.folder / "clip.json") as fields:
        write_hand_at(hands.track, header.frames, hands.found, hand)
        files.write_json(fields, header.changed({"provenance": known | provenance}))
    for key, text in provenance.items():
        report(warn_of(key, text))
    say(f"{target}: the {side} hand in {len(hands.found)} of {len(header.frames)} frames")
    if alone:
        some = _some(header.frames[row] for row in alone)
        left_out = f"{len(alone)} frames have the {side} hand only and are left out, as all without the clip's own"
        report(f"warning: {left_out}: {some}")
    return _status(header.K, header.size, hands.doubts)


def into_file(
    paths: Sequence[Path],
    tracker: Tracker,
    mano: Path | None,
    new: NewFrames,
    out: Path,
    hold_ends: bool,
    first_hand: int | None,
    overwrite: bool,
) -> int:
    """Write a hand file for ``clip new`` and ``import epic``: a ``hand.npz`` with ``frames`` (T,) and ``K`` (3, 3)."""
    if new.side is None or new.numbers is None or new.size is None:
        asked = (("side", new.side), ("frames", new.numbers), ("size", new.size))
        missing = next(name for name, value in asked if value is None)
        raise UsageError(f"--{missing}: got nothing, expected it with --out")
    if out.suffix != ".npz":
        raise UsageError(f"--out: got {out}, expected a file *.npz")
    if out.exists() and not overwrite:
        raise UsageError(f"{out}: exists already; --overwrite replaces it")
    first, last = new.numbers
    if not 0 <= first <= last < first + MOST_FRAMES or min(new.size) < 1:
        raise UsageError(
            f"--frames, --size: got {first} {last}, {new.size[0]} {new.size[1]}, expected the numbers of the first and "
            f"the last frame, at most {MOST_FRAMES}, and a size in pixels"
        )
    K, camera = intrinsics(new.lens, new.size)
    numbers = np.arange(first, last + 1)
    names = tuple(f"{n:06d}" for n in numbers)
    many = np.tile(K, (len(names), 1, 1))
    hands = read(paths, tracker, _request(new.side, names, many, new.size, mano, first_hand))
    check_in_view(paths[0], hands.track, many[list(hands.found)], new.size)
    hands = hands.held_at_ends(names) if hold_ends else hands
    provenance = hands.provenance | {"camera": camera}
    extra = {"frames": numbers[list(hands.found)], "K": K, "side": np.array(new.side)}
    extra |= as_arrays(provenance)
    with files.new_file(out) as part:
        write_hand(hands.track, part, extra)
    _report(replace(hands, provenance=provenance), names)
    print(out)
    return _status(many, new.size, _doubts(hands, len(names)))


def _request(
    side: Side,
    frames: tuple[str, ...],
    K: Float[ndarray, "T 3 3"],
    size: tuple[int, int],
    mano: Path | None,
    first: int | None,
) -> Request:
    """What is asked for; ``first`` is the number of the first frame's hand, where hands are counted differently."""
    if first is None:
        return Request(side, frames, K, size, mano)
    return Request(side, renumbered(frames, first, "--first"), K, size, mano, ask_first="")


def _fields(header: ClipHeader, hands: Hands) -> dict[str, object]:
    """What ``clip.json`` says with the hands: where they come from, and which frames have none."""
    old = (WITHOUT_HAND, HELD, CHOSEN)
    known = {key: text for key, text in header.fields["provenance"].items() if key not in old}
    return header.changed({"provenance": known | hands.provenance | without_hand(header.frames, hands.found)})


def _report(hands: Hands, frames: Sequence[str]) -> None:
    """Print where the hands come from, with a warning for what is guessed or missing."""
    for key, text in hands.provenance.items():
        report(warn_of(key, text))
    missing = [name for n, name in enumerate(frames) if n not in hands.found]
    if missing:
        report(f"warning: no hand in {len(missing)} of {len(frames)} frames, skipped: {_some(missing)}")


def _doubts(hands: Hands, frames: int) -> tuple[str, ...]:
    """What may be wrong with hands, in words, that most frames lack included."""
    most = 2 * len(hands.found) < frames
    return (*hands.doubts, f"only {len(hands.found)} of {frames} frames have a hand") if most else hands.doubts


def _status(K: Float[ndarray, "T 3 3"], size: tuple[int, int], doubts: tuple[str, ...]) -> int:
    """0, or ``DOUBTED`` with warnings where the hands seem to be wrong, or the camera to be of other images."""
    camera = doubt(K, size)
    texts = [*(f"hands: {text}" for text in doubts), *([f"camera: {camera}"] if camera else [])]
    for text in texts:
        report(f"warning: {text}")
    return DOUBTED if texts else 0


def _hand_masks(header: ClipHeader) -> tuple[Path | None, ...]:
    """The clip's masks of its hand; None for frames without one."""
    images = [f"masks/hand/{frame}.png" for frame in header.frames]
    there = [(header.folder / image).is_file() for image in images]
    return tuple(
        files.inside(header.folder, image, "", "a mask of the hand") if known else None
        for image, known in zip(images, there, strict=True)
    )


def _some(names: Iterable[str]) -> str:
    """The first few of them."""
    given = list(names)
    return ", ".join(given[:5]) + (", ..." if len(given) > 5 else "")
