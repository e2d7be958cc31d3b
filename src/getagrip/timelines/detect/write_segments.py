"""Clips from an uncut clip's segments: the whole clip as a timeline, or one clip per stable grasp."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.read import SegmentList, add_segments
from getagrip.clip.write import write_clip_contents
from getagrip.io import files
from getagrip.provenance import assumed
from getagrip.stable_grasps.find import as_listed
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR
from getagrip.timelines.detect.detect_segments import STATIC_CAMERA_NOTE, DetectedSegment, DetectedSegments


def detected_segment_list(clip: Clip, found: DetectedSegments) -> SegmentList:
    """Return the segments with their provenance."""
    least = min(one.margin for one in found.segments)
    source = f"found in masks and hands, each at least {least:.0f} nats before the next best"
    still = STATIC_CAMERA_NOTE if clip.world is None else None
    return SegmentList.of(clip, [one.segment for one in found.segments], source, still)


def write_timeline(clip: Clip, masks: Masks, found: DetectedSegments, folder: Path) -> list[Path]:
    """Write the whole clip with its segments into ``folder/<clip>``; return this folder, in a list.

    Images of the clip's folder are copied. The folder of an earlier call is replaced.
    """
    whole = add_segments(clip, detected_segment_list(clip, found))
    return [_write_clip_part(whole, masks, clip, np.arange(len(clip)), folder / clip.name)]


def write_grasps(clip: Clip, masks: Masks, found: DetectedSegments, folder: Path) -> list[Path]:
    """Write each stable grasp into ``folder/<clip>--<n>``, n from 1; return these folders.

    Images of the clip's folder are copied. Folders of an earlier call are replaced.
    """
    grasps = [one for one in found.segments if one.segment.state == "grasp"]
    stem = f"{clip.name}{CLIP_NAME_SEPARATOR}"
    return [_write_grasp(clip, masks, found, one, folder / f"{stem}{n}") for n, one in enumerate(grasps, 1)]


def _write_grasp(clip: Clip, masks: Masks, found: DetectedSegments, one: DetectedSegment, folder: Path) -> Path:
    segment = one.segment
    by = clip.with_side(segment.side)
    assert by is not None
    if by is not clip:
        masks = replace(masks, hand=None)
    rows = segment.rows[clip.hand_known(segment.side)[segment.rows]]
    provenance = {
        **clip.provenance,
        "grasp": as_listed(by, segment.first, segment.last).row(),
        "found": f"in the masks of {clip.name}, {one.margin:.0f} nats before the next best",
        **{f"assumed {n}": assumed(note) for n, note in enumerate(found.notes, start=1)},
    }
    alone = replace(by, name=folder.name, segments=(), other_hand=None, provenance=provenance)
    return _write_clip_part(alone.take(rows), masks.take(rows), clip, rows, folder)


def _write_clip_part(part: Clip, masks: Masks, clip: Clip, rows: Int[ndarray, "n"], folder: Path) -> Path:
    images = [clip.image_file(int(n)) for n in rows]
    with files.new_folder(folder, ("clip.json",) if folder.exists() else ()) as new:
        write_clip_contents(new, part, masks, None)
        if all(images):
            (new / "frames").mkdir()
            for image in images:
                assert image is not None
                shutil.copyfile(image, new / "frames" / image.name)
    return folder
