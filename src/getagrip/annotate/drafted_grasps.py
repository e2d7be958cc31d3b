"""The stable grasps in a draft, found from the masks and the hand as ``segment --from-masks`` finds them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.annotate.background import BackgroundJob
from getagrip.annotate.footage import Footage
from getagrip.annotate.found_hands import FOLDER, FoundHands
from getagrip.annotate.labelled import clip_words, make
from getagrip.annotate.labels import FRONT, HAND, OBJECT, FrameLabels, Labels
from getagrip.annotate.reconstruction import CLIPS, Shape, run_command
from getagrip.clip import read_clip
from getagrip.clip.mask_request import MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.terminal import counted
from getagrip.segmentation.found import find_segments

Extent = tuple[int, int]
"""First and last frame, from 0, both included."""
WHOLE = "whole"
"""Name of the clip of the interval that is searched."""


@dataclass(frozen=True)
class DraftedGrasps:
    """The grasps of a draft."""

    labels: Labels
    """The object in every frame."""
    extents: list[Extent]
    said: str
    """Which they are, in words."""


def find_grasps(labels: Labels, video: Path, footage: Footage, out: Path, shape: Shape) -> DraftedGrasps:
    """Find the grasps in the frames of labels, by a clip of all of them (``out/clips/whole``).

    Raises ``GetagripError`` where no clip can be made.
    """
    made, clip = files.folder_inside(out, FOLDER).parent / WHOLE, files.folder_inside(out, CLIPS) / WHOLE
    make(
        labels, footage.image, Lens(guess_focal=True), made,
        overwrite=True, found=FoundHands(out / FOLDER), name=footage.name,
    )  # fmt: skip
    words = clip_words(labels, made, str(video))
    run_command([*words, *shape.options, "--out", str(clip), "--overwrite"], BackgroundJob("files"))
    read = read_clip(clip)
    found = find_segments(read)
    names = [footage.name(n) for n in range(labels.first, labels.last + 1)]
    extents = [
        (labels.first + names.index(read.frames[a]), labels.first + names.index(read.frames[b]))
        for a, b in found.grasps
    ]
    which = ", ".join(f"frames {a + 1} to {b + 1}" for a, b in extents)
    said = f"{counted(len(extents), 'stable grasp')} found: {which}; --interval FIRST LAST overrules this"
    if not extents:
        said = "warning: no stable grasp found; the whole interval is marked: --interval FIRST LAST says where it is"
    if found.notes:
        said += f" ({'; '.join(found.notes)})"
    request = MaskRequest(tuple(names), labels.size, (str(OBJECT),), (str(FRONT),), (str(HAND),))
    return DraftedGrasps(replace(labels, frames=_every_frame(made / "masks", request, labels)), extents, said)


def _every_frame(path: Path, request: MaskRequest, labels: Labels) -> dict[int, FrameLabels]:
    """Return the masks of all frames as polygons; those of frames that were labelled stay as they are."""
    from getagrip.annotate.drafting import traced

    reader, frames = open_masks(path, request), dict(labels.frames)
    for row in range(len(request.frames)):
        masks, n = reader(row), labels.first + row
        if masks is not None and n not in frames:
            frames[n] = FrameLabels(object=tuple(traced(masks.object)))
    return frames
