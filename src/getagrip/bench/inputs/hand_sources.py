"""Hands of several estimators for the same clips, at the frames that all of them have (the paper's Table 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.bench.inputs.perturbations import Change
from getagrip.clip import Clip, HandTrack, Masks, read_clip
from getagrip.clip.read_arrays import check_in_view, check_intrinsics, read_hand
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.io.files import is_portable_name, shorten_value

MIN_COMMON_FRAMES = 2
"""Minimum number of frames that all sources must have."""


@dataclass(frozen=True)
class HandSource:
    """A folder of hands by clip name: as clips ``NAME/``, or as hand files ``NAME.npz``."""

    name: str
    folder: Path

    @staticmethod
    def of(text: str) -> HandSource:
        """Parse ``NAME=FOLDER``. Raises ``UsageError``."""
        name, equals, folder = text.partition("=")
        if not (equals and folder and is_portable_name(name)):
            raise UsageError(f"--hands must be NAME=FOLDER (got {text!r})")
        if not Path(folder).is_dir():
            raise UsageError(f"--hands must be a folder with clips, or with a .npz for each (got {text!r})")
        return HandSource(name, Path(folder))

    def file(self, clip: str) -> Path:
        """Return the file with the hands of a clip. Raises ``InputError`` where it is missing."""
        for path in (self.folder / clip / "hand.npz", self.folder / f"{clip}.npz"):
            if path.is_file():
                return path
        raise InputError(self.folder, "", f"no {clip}/hand.npz and no {clip}.npz", f"{self.name}'s hands of the clip")

    def read(self, clip: Clip) -> SourceHands:
        """Read the hands of a clip. Raises ``InputError`` where they are missing or of another clip."""
        path = self.file(clip.name)
        if path.name == "hand.npz":
            other = read_clip(path.parent)
            for key in ("side", "size"):
                got, expected = getattr(other, key), getattr(clip, key)
                if got != expected:
                    raise InputError(path.parent / "clip.json", key, shorten_value(got), f"{expected}")
            return SourceHands(path, other.hand, other.frames, other.K)
        about = arrays.read(path, {"frames", "K", "side"}.__contains__)
        side = about.get("side")
        if side is not None and str(side) != clip.side:
            raise InputError(path, "side", shorten_value(side.tolist()), clip.side)
        numbers, K = arrays.frame_numbers(path, about), None
        frames = clip.frames if numbers is None else _frame_names(numbers, clip)
        if "K" in about:
            K = np.tile(arrays.floats(path, about, "K", (3, 3)), (len(frames), 1, 1))
            check_intrinsics(path, K, clip.size)
        return SourceHands(path, read_hand(path, len(frames)), frames, K)


@dataclass(frozen=True)
class SourceHands:
    """The hands of a clip by one source."""

    file: Path
    track: HandTrack
    frames: Sequence[str]
    """Names of the frames."""
    K: Float[ndarray, "T 3 3"] | None
    """Intrinsics of the hands' camera; None: the clip's."""

    def in_clip(self, clip: Clip) -> Clip:
        """Return the clip with these hands instead of its own. Raises ``InputError`` where they do not match it."""
        if clip.truth is not None and not np.array_equal(clip.hand.faces, self.track.faces):
            expected = "the ground truth's hand, whose vertices define true contact"
            raise InputError(self.file, "faces", f"a hand of {self.track.vertices.shape[1]} vertices", expected)
        rows = np.array([self.frames.index(name) for name in clip.frames])
        hand = self.track.take(rows)
        K = clip.K if self.K is None else self.K[rows]
        check_in_view(self.file, hand, K, clip.size)
        return replace(clip, hand=hand, K=K)


@dataclass(frozen=True)
class WithHands(Change):
    """Replaces the hands by those of a source, at the frames that all sources have."""

    other_hands: ClassVar[bool] = True
    source: HandSource
    sources: tuple[HandSource, ...]

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        found = {source: source.read(clip) for source in self.sources}
        common = reduce(set.intersection, ({*hands.frames} for hands in found.values()), {*clip.frames})
        if len(common) < MIN_COMMON_FRAMES:
            got = f"{len(common)} of the {len(clip)} frames of {clip.name} in {' and '.join(s.name for s in found)}"
            expected = f"at least {MIN_COMMON_FRAMES} frames that all of them have"
            raise InputError(found[self.source].file, "frames", got, expected)
        index = np.array([n for n, name in enumerate(clip.frames) if name in common])
        return found[self.source].in_clip(clip.take(index)), masks.take(index)

    def inputs(self, clip: str) -> Mapping[str, Path]:
        return {source.name: source.file(clip) for source in self.sources}


def _frame_names(numbers: tuple[int, ...], clip: Clip) -> tuple[str, ...]:
    """Return the clip's names of the numbered frames of a hand file; frames outside the clip keep their numbers."""
    name_of = {int(name): name for name in clip.frames if name.isdecimal()}
    return tuple(name_of.get(number, f"{number}") for number in numbers)
