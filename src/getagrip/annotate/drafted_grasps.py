"""The grasps in a draft: as ``segment --from-masks`` finds them by masks and hand, or all frames but the reach."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from numpy import ndarray

from getagrip.annotate.background import BackgroundJob
from getagrip.annotate.boxes import Box
from getagrip.annotate.carried_masks import Hands, Images
from getagrip.annotate.footage import Footage
from getagrip.annotate.found_hands import DETECTED_HANDS_FOLDER, HandDetectionFiles
from getagrip.annotate.labelled import clip_arguments, write_labelled_clip_files
from getagrip.annotate.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels
from getagrip.annotate.propagated_masks import propagate_labels
from getagrip.annotate.reach import boxes_of_polygons, find_arrival, track_visible_box
from getagrip.annotate.reconstruction import CLIPS_FOLDER, RequestedMesh, run_command
from getagrip.clip import read_clip
from getagrip.clip.mask_request import MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.terminal import format_count
from getagrip.segmentation.found import find_segments

Extent = tuple[int, int]
"""First and last frame, from 0, both included."""
WHOLE_CLIP_NAME = "whole"
"""Name of the clip of the interval that is searched."""


@dataclass(frozen=True)
class DraftedGrasps:
    """The grasps of a draft."""

    labels: Labels
    """The object in every frame."""
    extents: list[Extent]
    said: str
    """Which they are, in words."""


def trim_reach(
    labels: Labels,
    image: Images,
    joints: Mapping[int, Float[ndarray, "21 2"]],
    hand: Hands,
    box: tuple[int, Box] | None = None,
) -> DraftedGrasps:
    """Return the frames in which hand and object move together (``reach``), as one grasp.

    ``joints`` are the hand's [px], ``hand`` is where it is visible, ``box`` the object's in a frame before it is held.
    """
    known = boxes_of_polygons({n: frame.object or () for n, frame in labels.frames.items()})
    ahead = known.items() if box is None else track_visible_box(image, box[1], box[0], labels.last)
    first = find_arrival(image, ahead, joints, labels.last)
    last = find_arrival(image, [*known.items()][::-1], joints, labels.first)
    extent = (labels.first if first is None else first, labels.last if last is None else last)
    if not labels.first <= extent[0] < extent[1] <= labels.last or extent == (labels.first, labels.last):
        return DraftedGrasps(labels, [(labels.first, labels.last)], "")
    why = {"reaches for it before": first, "leaves it after": last}
    moves = " and ".join(words for words, frame in why.items() if frame is not None)
    taken = f"frames {extent[0] + 1} to {extent[1] + 1} are taken, in which hand and object move together"
    if not any(extent[0] <= n <= extent[1] for n in known) and known:
        labels = replace(labels, frames=_add_propagated_labels(labels, image, hand, max(known), extent[0]))
    return DraftedGrasps(labels, [extent], f"{taken}: the hand {moves}; --all-frames takes all")


def _add_propagated_labels(labels: Labels, image: Images, hand: Hands, key: int, to: int) -> dict[int, FrameLabels]:
    """Return the labels, and those of a key carried to a later frame."""
    from getagrip.annotate.drafting import trace_polygons

    *_, last = propagate_labels(image, {key: labels.label_maps()[key]}, key, to, hand=hand)
    found = FrameLabels(object=tuple(trace_polygons(last.labels == OBJECT_LABEL)))
    return labels.frames | {to: found} if found.object else dict(labels.frames)


def find_grasps(
    labels: Labels,
    video: Path,
    footage: Footage,
    out: Path,
    shape: RequestedMesh,
    joints: Mapping[int, Float[ndarray, "21 2"]],
) -> DraftedGrasps:
    """Find the grasps in the frames of labels, by a clip of all of them (``out/clips/whole``).

    Where none is stable, the frames in which hand and object move together are taken. Raises ``GetagripError`` where no
    clip can be made.
    """
    made, clip = (
        files.folder_inside(out, DETECTED_HANDS_FOLDER).parent / WHOLE_CLIP_NAME,
        files.folder_inside(out, CLIPS_FOLDER) / WHOLE_CLIP_NAME,
    )
    write_labelled_clip_files(
        labels, footage.image, Lens(guess_focal=True), made,
        overwrite=True, found=HandDetectionFiles(out / DETECTED_HANDS_FOLDER), name=footage.name,
    )  # fmt: skip
    words = clip_arguments(labels, made, str(video))
    run_command([*words, *shape.options, "--out", str(clip), "--overwrite"], BackgroundJob("files"))
    read = read_clip(clip)
    found = find_segments(read)
    names = [footage.name(n) for n in range(labels.first, labels.last + 1)]
    extents = [
        (labels.first + names.index(read.frames[a]), labels.first + names.index(read.frames[b]))
        for a, b in found.grasps
    ]
    which = ", ".join(f"frames {a + 1} to {b + 1}" for a, b in extents)
    request = MaskRequest(tuple(names), labels.size, (str(OBJECT_LABEL),), (str(OCCLUDER_LABEL),), (str(HAND_LABEL),))
    labels = replace(labels, frames=_masks_to_labels(made / "masks", request, labels))
    said = f"{format_count(len(extents), 'stable grasp')} found: {which}; --interval FIRST LAST overrules this"
    if not extents:
        held = trim_reach(labels, footage.image, joints, HandDetectionFiles(out / DETECTED_HANDS_FOLDER).mask)
        extents = held.extents
        taken = held.said or "the whole interval is marked"
        said = f"warning: no stable grasp found; {taken}; --interval FIRST LAST says where it is"
    if found.notes:
        said += f" ({'; '.join(found.notes)})"
    return DraftedGrasps(labels, extents, said)


def _masks_to_labels(path: Path, request: MaskRequest, labels: Labels) -> dict[int, FrameLabels]:
    """Return the masks of all frames as polygons; those of frames that were labelled stay as they are."""
    from getagrip.annotate.drafting import trace_polygons

    reader, frames = open_masks(path, request), dict(labels.frames)
    for row in range(len(request.frames)):
        masks, n = reader(row), labels.first + row
        if masks is not None and n not in frames:
            frames[n] = FrameLabels(object=tuple(trace_polygons(masks.object)))
    return frames
