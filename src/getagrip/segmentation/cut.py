"""The stable grasps that were found in an uncut clip, each as a clip of its own."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from getagrip.clip import Clip, Masks
from getagrip.clip.writing import fill_folder
from getagrip.grasps.cut import as_listed
from getagrip.grasps.lists import BETWEEN
from getagrip.io import files
from getagrip.segmentation.found import Found, FoundSegment


def write_grasps(clip: Clip, masks: Masks, found: Found, folder: Path) -> list[Path]:
    """Write each stable grasp into ``folder/<clip>--<n>``, n from 1, and return these folders.

    Images are copied where the clip's folder has them. Folders of an earlier call are replaced.
    """
    grasps = [one for one in found.segments if one.segment.state == "grasp"]
    return [
        _write(clip, masks, found, one, folder / f"{clip.name}{BETWEEN}{n}") for n, one in enumerate(grasps, start=1)
    ]


def _write(clip: Clip, masks: Masks, found: Found, one: FoundSegment, folder: Path) -> Path:
    """One of them."""
    segment, images = one.segment, [clip.image_file(int(n)) for n in one.segment.rows]
    provenance = {
        **clip.provenance,
        "grasp": as_listed(clip, segment.first, segment.last).row(),
        "found": f"in the masks of {clip.name}, {one.margin:.0f} nats before the next best",
        **{f"assumed {n}": note for n, note in enumerate(found.notes, start=1)},
    }
    part = replace(clip.take(segment.rows), name=folder.name, segments=(), provenance=provenance)
    with files.new_folder(folder, ("clip.json",) if folder.exists() else ()) as new:
        fill_folder(new, part, masks.take(segment.rows), None)
        if all(images):
            (new / "frames").mkdir()
            for image in images:
                assert image is not None
                shutil.copyfile(image, new / "frames" / image.name)
    return folder
