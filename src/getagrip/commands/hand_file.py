"""A hand file that ``import hands --out`` writes and ``clip new --hands`` takes: hands of a clip to come."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.intrinsics import compute_intrinsics
from getagrip.clip.naming import check_frame_numbers, number_of, renumber_frames
from getagrip.clip.plausible import check_intrinsics
from getagrip.clip.reading_arrays import read_hand
from getagrip.errors import InputError
from getagrip.geometry.lens import Lens
from getagrip.hands.model import Side
from getagrip.hands.trackers import TrackedHands
from getagrip.io import arrays, numbers
from getagrip.provenance import Source, is_provenance_key, measured, provenance_from_arrays

HAND_FIRST_OPTION = "--hand-first"


@dataclass(frozen=True)
class HandFile:
    """A ``hand.npz`` that may also hold frame numbers, a side and a camera."""

    path: Path
    numbers: tuple[int, ...] | None
    K: Float[ndarray, "3 3"] | None
    side: str | None
    provenance: dict[str, Source]
    """Sources of its hands."""

    @staticmethod
    def of(path: Path) -> HandFile:
        """Read a hand file; raise ``InputError`` for a malformed one."""
        stored = arrays.read(path, lambda key: key in {"frames", "K", "side"} or is_provenance_key(key))
        side = str(stored["side"]) if "side" in stored and stored["side"].dtype.kind == "U" else None
        K = arrays.floats(path, stored, "K", (3, 3)) if "K" in stored else None
        return HandFile(path, arrays.frame_numbers(path, stored), K, side, provenance_from_arrays(path, stored))

    def at(self, frames: tuple[str, ...], side: Side, first: int | None) -> TrackedHands:
        """Return the hands of those frames that have one.

        ``first`` is the number of the first frame's hand, where hands are counted from another start. Raises
        ``InputError``, and ``UsageError`` where hands seem to be counted from another start.
        """
        with numbers.convert_to_input_errors(self.path):
            return self._at(frames, side, first)

    def _at(self, frames: tuple[str, ...], side: Side, first: int | None) -> TrackedHands:
        if self.side not in (None, side):
            raise InputError(self.path, "side", f"a {self.side} hand", f"a {side} hand, as --side says")
        sources = {"hands": f"from {self.path.name}", **self.provenance}
        sources.pop("camera", None)
        if self.numbers is None:
            return TrackedHands(read_hand(self.path, len(frames)), tuple(range(len(frames))), sources)
        track = read_hand(self.path, len(self.numbers))
        names = frames if first is None else renumber_frames(frames, first, HAND_FIRST_OPTION)
        check_frame_numbers(
            names, map(str, self.numbers), self.path, "hand", HAND_FIRST_OPTION if first is None else ""
        )
        place = {number: row for row, number in enumerate(self.numbers)}
        at = [None if number is None else place.get(number) for number in map(number_of, names)]
        rows = tuple(row for row, there in enumerate(at) if there is not None)
        if len(rows) < 2:
            got = f"hands in {len(rows)} frames of the interval"
            expected = f"hands in frames {number_of(names[0])} to {number_of(names[-1])}"
            raise InputError(self.path, "frames", got, expected)
        picked = track.take(np.array([there for there in at if there is not None]))
        return TrackedHands(picked, rows, sources)


def camera_of(lens: Lens, hands: HandFile | None, size: tuple[int, int]) -> tuple[Float[ndarray, "3 3"], Source]:
    """Return the command's camera or, without one, the hand file's. Raises ``UsageError`` and ``InputError``."""
    if lens.is_set or hands is None or hands.K is None:
        return compute_intrinsics(lens, size)
    check_intrinsics(hands.path, hands.K[None], size)
    known = hands.provenance.get("camera", measured("it does not say from where"))
    return hands.K, replace(known, text=f"the hand file's: {known}")
