"""``getagrip import depth``: depth images of a sensor or a network into a clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, get_args

import numpy as np
from numpy import ndarray
from tyro.conf import Positional, arg

from getagrip.clip.depth import DEPTH_KEY
from getagrip.clip.depth_files import check_depth_shape
from getagrip.clip.depth_sources import (
    DEPTH_FORMATS,
    DepthReader,
    add_depth,
    check_depth_direction,
    check_focal_length,
    open_depth,
    select_depth_source,
)
from getagrip.clip.naming import renumber_frames
from getagrip.clip.reading import ClipHeader, read_header
from getagrip.clip.soft_edges import sample_frames
from getagrip.commands.command import Command, FirstNumber
from getagrip.errors import UsageError
from getagrip.io.arguments import Flag, one_of
from getagrip.io.images import read_png
from getagrip.io.terminal import print_result, warn

WARNING_EXIT_STATUS = 3
"""Exit status where depth is written, and something seems to be wrong with it."""
Scale = Literal["metric", "clip", "frame"]
if TYPE_CHECKING:
    Format: TypeAlias = str
else:  # the choices of --from, as the table has them
    TAKES = "; ".join(f"{name}: {form.takes}" for name, form in DEPTH_FORMATS.items())
    Format = Annotated[
        Literal[tuple(DEPTH_FORMATS)], arg(name="from", help=f"Program or format of the files. {TAKES}.")
    ]


@dataclass(frozen=True, kw_only=True)
class ImportDepth(Command):
    """Add depth images to a clip: distances of what each pixel shows, which reconstruct uses beside the masks.

    Files are named like the clip's frames, or by the same numbers; they may be smaller than its images, but neither
    cropped nor turned.
    """

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The folder or file: 16-bit PNG, .npy, .npz or .exr."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder."""
    source: Format
    scale: Annotated[Scale | None, one_of(*get_args(Scale)), arg(help_behavior_hint="(default: as its program)")] = None
    """Measure of the numbers: metres; metres times a factor of the clip, or of each frame."""
    unit: Annotated[float | None, arg(metavar="M", help_behavior_hint="(default: as its program)")] = None
    """Metres that 1 in the files stands for."""
    error: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="(default: by its kind)")] = None
    """Error of distances, the factor apart, as a share of the distance."""
    first: FirstNumber = None
    """The number that the files give to the first frame, if they count from another start."""
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder or pattern of names (cam1_*) of the files to use, if there are several for a frame."""
    overwrite: Flag = False
    """Replace depth that is there already."""

    def run(self) -> int:
        """Add ``depth/`` to a clip's folder; return 0, or 3 with a warning about it.

        Raises ``InputError``, and ``UsageError`` where there is depth already.
        """
        header = read_header(self.clip)
        target = header.folder / DEPTH_KEY
        if target.exists() and not self.overwrite:
            raise UsageError(f"{target}: exists already; --overwrite replaces it")
        frames = header.frames if self.first is None else renumber_frames(header.frames, self.first, "--first")
        ask_first, counted = ("--first", False) if self.first is None else ("", True)
        reader = open_depth(self.path, self.source, frames, ask_first, self.images, counted)
        source = select_depth_source(self.source, self.scale, self.unit, self.error)
        check_depth_shape(*reader.read(reader.known[0])[:2], header.size)
        order = check_depth_direction(reader, _read_depth_masks(header, reader), source)
        said = f"from {self.path.name}, {self.source}"
        add_depth(header, reader, source, said, unit=self.unit, overwrite=self.overwrite)
        print_result(f"{target}: depth of {len(reader.known)} of {len(frames)} frames")
        warnings = [*filter(None, [check_focal_length(reader, source, header.K, header.size[0]), order])]
        if len(reader.known) < len(frames):
            missing = [name for n, name in enumerate(header.frames) if n not in reader.known]
            warn(f"no depth in {len(missing)} of {len(frames)} frames (first: {missing[0]})")
        for warning in warnings:
            warn(f"{self.path}: {warning}")
        return WARNING_EXIT_STATUS if warnings else 0


def _read_depth_masks(header: ClipHeader, reader: DepthReader) -> dict[int, tuple[ndarray, ndarray]]:
    """Read the masks of the object, and of what hides it, in some frames that have both these and depth."""
    found = dict[int, tuple[ndarray, ndarray]]()
    there = [n for n in reader.known if (header.folder / f"masks/object/{header.frames[n]}.png").is_file()]
    for n in sample_frames(there):
        seen, others = (
            read_png(header.folder / name, header.size) > 0 if (header.folder / name).is_file() else None
            for name in (f"masks/{kind}/{header.frames[n]}.png" for kind in ("object", "ignore"))
        )
        if seen is not None:
            found[n] = seen, np.zeros_like(seen) if others is None else others
    return found
