"""``getagrip import``: clips from other people's layouts."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from getagrip.clip import write_clip
from getagrip.errors import UsageError
from getagrip.run.batch import progress_bar


def import_hot3d(root: Path, out: Path) -> int:
    """Write the holds of HOT3D recordings as ``out/<clip name>/``; 1 if a clip is there already, else 0.

    Raises ``InputError`` for files that are missing or malformed, when all else is done.
    """
    from getagrip.datasets import hot3d

    say: Callable[[str], None] = lambda words: print(words, file=sys.stderr)  # noqa: E731
    failures = 0
    with progress_bar() as bar:
        task = bar.add_task(f"clips of {root}", total=None)
        for clip, masks in hot3d.read(root, note=say):
            try:
                print(write_clip(clip, masks, out / clip.name))
            except UsageError as error:
                say(f"failed: {error}")
                failures += 1
            bar.advance(task)
    return 1 if failures else 0
