"""``getagrip import masks``: masks from files into a clip that lacks them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.clip.mask_request import MaskReader, MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.clip.naming import renumber_frames
from getagrip.clip.reading import read_header
from getagrip.commands.command import Command, FirstNumber, Labels
from getagrip.commands.import_many import import_many
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.arguments import Flag
from getagrip.io.images import write_mask
from getagrip.io.terminal import format_count, print_result, warn

MIN_VISIBLE_FRAMES = 2
"""Frames that show the object."""


@dataclass(frozen=True, kw_only=True)
class ImportMasks(Command):
    """Add masks from files to a clip.

    Formats: a folder of PNG (labels, palettes as of SAM 2, colours), of .npy or of LabelMe's .json; .json of COCO,
    YouTube-VIS or SA-V; .npz and .npy; and SAM 2's video_segments (.pkl, .npy).
    """

    path: Annotated[Positional[Path], arg(metavar="PATH")]
    """The folder or file; images are named like the clip's frames, or by the same numbers."""
    clip: Annotated[Path | None, arg(metavar="CLIP", help_behavior_hint="")] = None
    """The clip's folder."""
    clips: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """A folder of clips: into each what PATH, a folder, has under the clip's name. Clips with masks are done."""
    object: Labels = ()
    """Labels of the object: values, #rrggbb, or names of COCO's categories. If there are several cups, cup:7 selects
    one by its track_id and cup:all takes all. Not needed if there is only one label."""
    ignore: Labels = ()
    """Labels of whatever hides the object: other hands, other things in front."""
    hand: Labels = ()
    """Labels of the hand that holds the object. Its pixels are ignored as well, and the clip's hands are refined
    against them."""
    first: FirstNumber = None
    """The number that the masks give to the first frame, if they count from another start."""
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder (take1) or pattern of names (cam1_*) of the images to use, if there are several for a frame."""
    stretched: Flag = False
    """The masks are of images that were stretched to another shape, as Roboflow's resize does."""
    overwrite: Flag = False
    """Replace masks that are there already."""

    def run(self) -> int:
        """Add ``masks/`` to a clip's folder; return 0, or 3 with a warning about them.

        Raises ``InputError``, and ``UsageError`` where there are masks already.
        """
        if self.clip is None and self.clips is None:
            raise UsageError("missing --clip or --clips")
        if self.clips is not None:
            if self.clip is not None:
                raise UsageError("--clip cannot be used with --clips")

            def of_clip(source: Path, clip: Path) -> ImportMasks:
                return replace(self, path=source, clip=clip, clips=None)

            return import_many(self.path, self.clips, "masks", self.overwrite, of_clip, self.debug)
        assert self.clip is not None
        header = read_header(self.clip)
        target = header.folder / "masks"
        if target.exists() and not self.overwrite:
            raise UsageError(f"{target}: exists already; --overwrite replaces it")
        names = header.frames
        if self.first is not None:
            names = renumber_frames(names, self.first, "--first")
        ask_first = "--first" if self.first is None else ""
        labels = self.object, self.ignore, self.hand
        counted_by = ask_first, self.first is not None
        request = MaskRequest(names, header.size, *labels, *counted_by, self.images, stretched=self.stretched)
        reader = open_masks(self.path, request)
        whence = header.fields["provenance"] | {"masks": masks_provenance(self.path, *labels, self.images)}
        with files.new_folder(target, ("object",) if self.overwrite else ()) as new:
            visible = write_reader_masks(reader, header.frames, new)
            with files.new_file(header.folder / "clip.json") as part:
                files.write_json(part, header.changed({"provenance": whence}))
        print_result(f"{target}: the object is visible in {visible} of {len(names)} frames")
        return report_masks(reader, header.frames, visible)


def report_masks(reader: MaskReader, frames: tuple[str, ...], visible: int) -> int:
    """Say which frames have no masks and what was made of others; returns 3 with a warning about them, else 0."""
    for note, count in reader.notes.items():
        warn(f"{reader.source}: {note}: {count}")
    if missing := [name for n, name in enumerate(frames) if n not in reader.known]:
        some = f"no mask of {len(missing)} of {len(frames)} frames (first: {missing[0]})"
        warn(f"{reader.source}: {some}; reconstruct interpolates their poses")
    if visible < MIN_VISIBLE_FRAMES:
        seen = f"the object is visible in {format_count(visible, 'frame')}; reconstruct needs {MIN_VISIBLE_FRAMES}"
        warn(f"{reader.source}: {seen}")
    for warning in (*reader.warnings, *(f"no frame has a pixel of {named}" for named in sorted(reader.unmet))):
        warn(f"{reader.source}: {warning}")
    amiss = [named for named in reader.unmet if not named.startswith("--hand")]  # a hand may be hidden throughout
    return 3 if reader.warnings or amiss or visible < MIN_VISIBLE_FRAMES else 0


def write_reader_masks(reader: MaskReader, frames: tuple[str, ...], folder: Path) -> int:
    """Write the masks of the frames that have some, one at a time in memory; returns in how many the object is visible.

    Raises ``InputError`` where it is visible in none.
    """
    visible = 0
    for n, name in enumerate(frames):
        masks = reader(n)
        if masks is None:
            continue
        for kind, mask in masks._asdict().items():
            if mask is not None:
                write_mask(files.folder_inside(folder, kind) / f"{name}.png", mask)
        visible += int(masks.object.any())
    if not visible:
        there = f"; there are {', '.join(sorted(reader.others))}" if reader.others else ""
        raise InputError(reader.source, "", f"masks without a pixel of the object{there}", "masks that show it")
    return visible


def masks_provenance(
    source: Path, objects: tuple[str, ...], ignore: tuple[str, ...], hand: tuple[str, ...], images: str = ""
) -> str:
    """Return the source of masks, for a clip's provenance."""
    named = (("images", (images,) * bool(images)), ("object", objects), ("ignored", ignore), ("hand", hand))
    labels = "".join(f", {what} {', '.join(names)}" for what, names in named if names)
    return f"from {source.name}{labels}" + ("" if ignore or hand else ", nothing ignored")
