"""``getagrip import masks``: masks from files into a clip that lacks them."""

from __future__ import annotations

from pathlib import Path

from getagrip.clip.mask_request import MaskReader, MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.clip.numbering import renumbered
from getagrip.clip.reading import read_header
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.images import write_mask
from getagrip.io.terminal import say


def into_clip(
    source: Path,
    objects: tuple[str, ...],
    ignore: tuple[str, ...],
    hand: tuple[str, ...],
    first: int | None,
    folder: Path,
    overwrite: bool,
) -> int:
    """Add ``masks/`` to a clip's folder.

    ``first`` is the number in the name of the first frame's mask, where masks are counted differently. Raises
    ``InputError``, and ``UsageError`` where there are masks already.
    """
    header = read_header(folder)
    target = header.folder / "masks"
    if target.exists() and not overwrite:
        raise UsageError(f"{target}: exists already; --overwrite replaces it")
    names = header.frames
    if first is not None:
        names = renumbered(names, first, "--first")
    ask_first = "--first" if first is None else ""
    reader = open_masks(source, MaskRequest(names, header.size, objects, ignore, hand, ask_first))
    whence = header.fields["provenance"] | {"masks": provenance(source, objects, ignore, hand)}
    with files.new_folder(target, ("object",) if overwrite else ()) as new:
        visible = write_masks(reader, header.frames, new)
        with files.new_file(header.folder / "clip.json") as part:
            files.write_json(part, header.fields | {"provenance": whence})
    say(f"{target}: the object is visible in {visible} of {len(names)} frames")
    return 0


def write_masks(reader: MaskReader, frames: tuple[str, ...], folder: Path) -> int:
    """Write the masks of all frames, one at a time in memory; returns in how many the object is visible.

    Raises ``InputError`` where it is visible in none.
    """
    visible = 0
    for n, name in enumerate(frames):
        masks = reader(n)
        for kind, mask in masks._asdict().items():
            if mask is not None:
                write_mask(files.folder_inside(folder, kind) / f"{name}.png", mask)
        visible += int(masks.object.any())
    if not visible:
        there = f"; there are {', '.join(sorted(reader.others))}" if reader.others else ""
        raise InputError(reader.source, "", f"masks without a pixel of the object{there}", "masks that show it")
    return visible


def provenance(source: Path, objects: tuple[str, ...], ignore: tuple[str, ...], hand: tuple[str, ...]) -> str:
    """Where masks come from, for a clip's provenance."""
    named = (("object", objects), ("ignored", ignore), ("hand", hand))
    labels = "".join(f", {what} {', '.join(names)}" for what, names in named if names)
    return f"from {source.name}{labels}" + ("" if ignore or hand else ", nothing ignored")
