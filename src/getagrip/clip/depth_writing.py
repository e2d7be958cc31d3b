"""Depth images of other programs into a clip's folder, as 16-bit PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from getagrip.clip.depth import DEPTH, DepthSource
from getagrip.clip.depth_files import check_shape, depth_file, source_fields
from getagrip.clip.depth_sources import DepthReader
from getagrip.clip.reading import ClipHeader
from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.images import write_depth

LARGEST = 65534
"""Largest number of a 16-bit image that is a distance."""
MIDDLE = 16384
"""Numbers with fractions are written so that the first image's median is this."""


def add_depth(
    header: ClipHeader,
    reader: DepthReader,
    source: DepthSource,
    said: str,
    unit: float | None = None,
    overwrite: bool = False,
) -> None:
    """Write ``depth/`` of a clip, and what it is and where it is from into its ``clip.json``. Raises ``InputError``.

    ``unit`` is that of the files, where the user states it [m].
    """
    older = (depth_file(header.folder, frame) for frame in header.frames if overwrite)
    there = tuple(Path(name).name for name in older if name is not None)
    whence = header.fields["provenance"] | {DEPTH: said}
    with files.new_folder(header.folder / DEPTH, there) as new:
        found = _write(reader, header.frames, header.size, unit, new)
        with files.new_file(header.folder / "clip.json") as part:
            stored = source_fields(replace(source, unit=found))
            files.write_json(part, header.changed({DEPTH: stored, "provenance": whence}))


def _write(
    reader: DepthReader, frames: Sequence[str], size: tuple[int, int], stated: float | None, folder: Path
) -> float:
    """Write the images, one at a time in memory, and return the unit of their numbers. Raises ``InputError``.

    Whole numbers stay as they are.
    """
    unit, written, path = 0.0, 0.0, folder
    for n in reader.known:
        path, image, one = reader.read(n)
        check_shape(path, image, size)
        one = one if stated is None else stated
        if not unit:
            whole = bool(np.all(image == np.floor(image))) and image.max() <= LARGEST
            middle = float(np.median(image[image > 0.0])) if image.any() else 0.0
            unit = one if whole or not middle else one * middle / MIDDLE
        numbers = np.rint(image * (one / unit))
        numbers[numbers > LARGEST] = 0.0  # farther than anything near a hand
        written += float(numbers.sum())
        write_depth(folder / f"{frames[n]}.png", numbers.astype(np.uint16))
    if not written:
        raise InputError(path, "", "0 in all images", "distances, 0 for none")
    return unit
