"""The hands of a result that were not the clip's, kept beside it: what ``bench --hands`` compares exists in no clip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from getagrip.clip import Clip, input_sha256
from getagrip.clip.reading_arrays import read_hand
from getagrip.clip.writing import write_hand
from getagrip.errors import InputError
from getagrip.io import arrays, files

RESULT_HANDS_FILE = "hand.npz"
RESULT_HANDS_KEYS = ("names", "K", "clip_sha256")
"""Its arrays beside those of a hand: names of the frames, the camera of each, the checksum of the clip without it."""


def write_result_hands(clip: Clip, result: Path, clip_sha256: str) -> None:
    """Write the hands that a clip had into the folder of its result."""
    with files.new_file(result / RESULT_HANDS_FILE) as part:
        write_hand(
            clip.hand,
            part,
            dict(zip(RESULT_HANDS_KEYS, (np.array(clip.frames), clip.K, np.array(clip_sha256)), strict=True)),
        )


def with_result_hands(clip: Clip, result: Path) -> Clip | None:
    """Return the clip with the hands beside a result, in their frames; None where the result keeps none.

    Raises ``InputError`` for a malformed file, and where the clip has changed since.
    """
    path = result / RESULT_HANDS_FILE
    if not path.is_file():
        return None
    stored = arrays.read(path, RESULT_HANDS_KEYS.__contains__)
    for key in RESULT_HANDS_KEYS:
        if key not in stored:
            raise InputError(path, key, "nothing", "hands that bench --hands kept")
    if str(stored["clip_sha256"]) != input_sha256(clip.origin):
        raise InputError(path, "clip_sha256", f"another: {clip.name} has changed", "the clip's checksum; do it again")
    names = tuple(map(str, np.atleast_1d(stored["names"]).tolist()))
    K = arrays.floats(path, stored, "K", (len(names), 3, 3))
    return replace(clip.take(clip.index_of(names)), hand=read_hand(path, len(names)), K=K)
