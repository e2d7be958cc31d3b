"""``getagrip import hands``: an estimator's hands into a clip that lacks them, or into a file for one to come."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.clip.intrinsics import Lens, intrinsics
from getagrip.clip.plausible import check_in_view
from getagrip.clip.reading import ClipHeader, read_header
from getagrip.clip.writing import write_hand
from getagrip.errors import UsageError
from getagrip.hands.fit import JointOrder
from getagrip.hands.model import Side
from getagrip.hands.trackers import Hands, Reading, Source, read
from getagrip.hands.trackers.plain import Encoding, Mean
from getagrip.io import files

MOST_FRAMES = 20_000
"""Of a hand file."""


@dataclass(frozen=True)
class Told:
    """What a command says of files that do not say it themselves; see ``estimates.Reading``."""

    mano: Path | None = None
    pose: Encoding | None = None
    mean: Mean | None = None
    order: JointOrder | None = None
    focal: float | None = None
    """The focal length that the estimator was run with [px]."""
    first: int = 1
    """Number of the first image that the estimator was run on, where it counts them from 0."""


NewFrames = tuple[Side | None, tuple[int, int] | None, tuple[int, int] | None, Lens]
"""Of a clip to come: side, numbers of the first and last frame, size of the images [px], camera."""


def import_hands(
    paths: Sequence[Path],
    source: Source,
    told: Told,
    clip: Path | None,
    out: Path | None,
    new: NewFrames,
    overwrite: bool,
) -> int:
    """Add hands to a clip, or write a file of them. Raises ``UsageError`` for options that do not fit."""
    if not paths:
        raise UsageError("FILE: got none, expected the estimator's files")
    if (clip is None) == (out is None):
        raise UsageError(f"--clip, --out: got {'both' if clip else 'neither'}, expected one of them")
    side, numbers, size, lens = new
    empty = Reading(side or "right", (), np.zeros((0, 3, 3)), size or (0, 0), **vars(told))
    if clip is not None:
        if side or numbers or size or lens.given:
            raise UsageError("--side, --frames, --size, --K: got some, expected none with --clip, which has them")
        return into_clip(paths, source, empty, clip, overwrite)
    if side is None or numbers is None or size is None or out is None:
        missing = next(name for name, value in (("side", side), ("frames", numbers), ("size", size)) if value is None)
        raise UsageError(f"--{missing}: got nothing, expected it with --out")
    return into_file(paths, source, empty, Frames(side, *numbers, size, lens), out, overwrite)


@dataclass(frozen=True)
class Frames:
    """The frames of a clip to come."""

    side: Side
    first: int
    last: int
    """Their numbers, the last included."""
    size: tuple[int, int]
    lens: Lens


def into_clip(paths: Sequence[Path], source: Source, given: Reading, folder: Path, overwrite: bool) -> int:
    """Add ``hand.npz`` to a clip's folder; frames without a hand are left out of ``clip.json``.

    Of ``given``, side, frames and camera are the clip's. Raises ``UsageError`` where there are hands already.
    """
    header = read_header(folder)
    target = header.folder / "hand.npz"
    if target.exists() and not overwrite:
        raise UsageError(f"{target}: exists already; --overwrite replaces it")
    side: Side = header.fields["side"]
    wanted = replace(given, side=side, frames=header.frames, K=header.K, size=header.size)
    hands = read(paths, source, wanted)
    check_in_view(paths[0], hands.track, header.K[list(hands.found)], header.size)
    if len(hands.found) < len(header.frames) and (header.folder / "truth.npz").exists():
        missing = len(header.frames) - len(hands.found)
        raise UsageError(f"{folder}: got no hand in {missing} frames, expected one in each, since it has a truth.npz")
    with files.new_file(target) as hand, files.new_file(header.folder / "clip.json") as fields:
        write_hand(hands.track, hand)
        files.write_json(fields, _fields(header, hands))
    _say(hands, header.frames)
    print(target)
    return 0


def into_file(paths: Sequence[Path], source: Source, given: Reading, frames: Frames, out: Path, overwrite: bool) -> int:
    """Write a hand file for ``clip new`` and ``import epic``: a ``hand.npz`` with ``frames`` (T,) and ``K`` (3, 3)."""
    if out.suffix != ".npz":
        raise UsageError(f"--out: got {out}, expected a file *.npz")
    if out.exists() and not overwrite:
        raise UsageError(f"{out}: exists already; --overwrite replaces it")
    if not 0 <= frames.first <= frames.last < frames.first + MOST_FRAMES or min(frames.size) < 1:
        raise UsageError(
            f"--frames, --size: got {frames.first} {frames.last}, {frames.size[0]} {frames.size[1]}, "
            f"expected the numbers of the first and the last frame, at most {MOST_FRAMES}, and a size in pixels"
        )
    K, camera = intrinsics(frames.lens, frames.size)
    numbers = np.arange(frames.first, frames.last + 1)
    names = tuple(f"{n:06d}" for n in numbers)
    many = np.tile(K, (len(names), 1, 1))
    hands = read(paths, source, replace(given, side=frames.side, frames=names, K=many, size=frames.size))
    check_in_view(paths[0], hands.track, many[list(hands.found)], frames.size)
    told = hands.provenance | {"camera": camera}
    extra = {"frames": numbers[list(hands.found)], "K": K, "side": np.array(frames.side)}
    extra |= {f"provenance_{key}": np.array(text) for key, text in told.items()}
    with files.new_file(out) as part:
        write_hand(hands.track, part, extra)
    _say(replace(hands, provenance=told), names)
    print(out)
    return 0


def _fields(header: ClipHeader, hands: Hands) -> dict[str, object]:
    """What ``clip.json`` says with the hands: where they come from, and which frames have one."""
    fields = dict(header.fields)
    left_out = [name for n, name in enumerate(header.frames) if n not in hands.found]
    fields["provenance"] = dict(fields["provenance"]) | hands.provenance
    if left_out:
        fields["frames"] = [header.frames[n] for n in hands.found]
        fields["provenance"]["frames_without_hand"] = f"left out: {', '.join(left_out)}"
        if np.ndim(fields["camera"]["K"]) == 3:
            fields["camera"] = {"K": header.K[list(hands.found)]}
    return fields


def _say(hands: Hands, frames: Sequence[str]) -> None:
    """Tell what was made up, and what is missing."""
    for key, text in hands.provenance.items():
        mark = "warning: " if "guess" in text else ""
        print(f"{mark}{key}: {text}", file=sys.stderr)
    missing = [name for n, name in enumerate(frames) if n not in hands.found]
    if missing:
        some = ", ".join(missing[:5]) + (", ..." if len(missing) > 5 else "")
        print(f"warning: no hand in {len(missing)} of {len(frames)} frames, left out: {some}", file=sys.stderr)
