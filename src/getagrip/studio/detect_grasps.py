"""The grasps in a draft: as ``segment --from-masks`` finds them by masks and hand, or all frames but the reach.

The frames in which a hand and an object move together, without the reach before them and the release after them.

While the hand reaches for the object, or leaves it, the object rests: it stays at its place on the ground, which the
camera may move over, and the hand moves over the ground and over the object. Such frames at either end are no grasp.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import takewhile
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip import read_clip
from getagrip.geometry.camera import Lens
from getagrip.io import files
from getagrip.io.terminal import format_count
from getagrip.readers.footage import Footage
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, HandDetectionFiles
from getagrip.studio.jobs import CLIPS_FOLDER, BackgroundJob, RequestedMesh, run_command
from getagrip.studio.masks.box_prompt import MIN_BOX_CORRELATION, Box, downscale_image, track_box
from getagrip.studio.masks.propagate_clip import propagate_labels
from getagrip.studio.masks.propagate_frame import Hands, Images
from getagrip.studio.store.export_clip import clip_arguments, write_labelled_clip_files
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels, Polygons
from getagrip.timelines.detect.detect_segments import find_segments

MAX_GROUND_IMAGE_PX = 480.0
"""Longer side of the images in which the ground's motion is measured, at most [px]."""
MAX_GROUND_CORNERS, MIN_GROUND_CORNERS = 200, 8
"""Corners of the ground that are followed, and the fewest by which its motion is known."""
MIN_CORNER_QUALITY, GROUND_MARGIN_PX = 1e-3, 8
"""Least quality of a corner, as a share of the best, and its least distance from hand and object [px]."""
REST_TOLERANCE = 0.1
"""An object that is farther from its place on the ground than this share of its longer side does not rest."""
REACH_START_DISTANCE, ARRIVAL_DISTANCE = 0.3, 0.15
"""A hand that comes from farther than ``REACH_START_DISTANCE`` has reached; it has arrived from ``ARRIVAL_DISTANCE`` on [palm sizes]."""
MIN_REST_FRAMES = 5
"""Fewest frames in which an object rests."""
PALM_CENTRE_JOINTS = (0, 5, 9, 13, 17)
"""Joints of the palm."""

Placed = tuple[int, Box]
"""A frame and the object's box in it [px]."""


def track_visible_box(images: Images, box: Box, first: int, last: int) -> Iterator[Placed]:
    """Follow the object's box from the first frame on, as long as it shows what it showed there."""
    boxes = takewhile(lambda each: each[1] >= MIN_BOX_CORRELATION, track_box(images, box, first, last))
    for n, (at, _) in enumerate(boxes, start=first):
        yield n, at


def boxes_of_polygons(shapes: Mapping[int, Polygons]) -> dict[int, Box]:
    """Return the boxes of polygons, by frame; frames without one are left out."""
    points = {n: np.concatenate(each) for n, each in sorted(shapes.items()) if each}
    return {n: (*each.min(axis=0).tolist(), *np.ptp(each, axis=0).tolist()) for n, each in points.items()}


def find_arrival(
    images: Images, boxes: Iterable[Placed], joints: Mapping[int, Float[ndarray, "21 2"]], end: int
) -> int | None:
    """Return the first frame in which the hand has come to an object that rests; None where it does not come to it.

    ``boxes`` go forwards, or backwards for a release: then it is the last frame. An object that rests up to the frame
    ``end`` is not held at all. ``joints`` are the hand's [px].
    """
    apart: dict[int, Float[ndarray, "21 2"]] = {}
    sizes, place, before = [], None, None
    image = lru_cache(maxsize=2)(images)
    for n, (x, y, w, h) in boxes:
        middle = np.array([x + 0.5 * w, y + 0.5 * h])
        palm = joints[n][list(PALM_CENTRE_JOINTS)] if n in joints else None
        if before is not None and place is not None:
            step = _ground_motion(image(before[0]), image(n), before[1:])
            if step is None:
                return None
            place = step[:, :2] @ place + step[:, 2]
            if np.linalg.norm(middle - place) > REST_TOLERANCE * max(w, h):
                break
        else:
            place = middle
        if palm is not None:
            sizes.append(2.0 * np.sqrt(np.mean(np.sum((palm - palm.mean(axis=0)) ** 2, axis=1))))
            apart[n] = joints[n] - middle
        around = np.array([[x, y], [x + w, y + h], *joints.get(n, ())])
        before = n, around.min(axis=0), around.max(axis=0)
    else:
        if before is None or before[0] == end:
            return None
    return _arrival_frame(apart, float(np.median(sizes or [1.0])))


def _arrival_frame(apart: Mapping[int, Float[ndarray, "21 2"]], size: float) -> int | None:
    """Return the frame from which on the hand stays beside the object, from where it is at last."""
    if len(apart) < MIN_REST_FRAMES:
        return None
    frames, where = [*apart], np.array([*apart.values()]) / size
    half = MIN_REST_FRAMES // 2
    smooth = np.array([np.median(where[max(0, n - half) : n + half + 1], axis=0) for n in range(len(where))])
    off = np.sqrt(np.mean(np.sum((smooth - np.median(where[-MIN_REST_FRAMES:], axis=0)) ** 2, axis=-1), axis=-1))
    if off.max() < REACH_START_DISTANCE:
        return None
    return frames[min(int(np.flatnonzero(off > ARRIVAL_DISTANCE).max()) + 1, len(frames) - 1)]


def _ground_motion(
    one: UInt8[ndarray, "H W 3"],
    other: UInt8[ndarray, "H W 3"],
    hidden: tuple[Float[ndarray, "2"], Float[ndarray, "2"]],
) -> Float[ndarray, "2 3"] | None:
    """Return where points of the ground are in another image [px]; None where too little of it is followed.

    ``hidden`` is a box, lower and upper corner, about object and hand, beside which the ground is looked at.
    """
    import cv2

    scale = min(1.0, MAX_GROUND_IMAGE_PX / max(one.shape))
    a, b = (cv2.cvtColor(downscale_image(image, scale), cv2.COLOR_RGB2GRAY) for image in (one, other))
    free = np.full(a.shape, 255, np.uint8)
    low, high = (np.clip(np.round(scale * corner).astype(int), 0, a.shape[::-1]) for corner in hidden)
    free[
        max(0, low[1] - GROUND_MARGIN_PX) : high[1] + GROUND_MARGIN_PX,
        max(0, low[0] - GROUND_MARGIN_PX) : high[0] + GROUND_MARGIN_PX,
    ] = 0
    corners = cv2.goodFeaturesToTrack(a, MAX_GROUND_CORNERS, MIN_CORNER_QUALITY, 5, mask=free)
    if corners is None or len(corners) < MIN_GROUND_CORNERS:
        return None
    there, found, _ = cv2.calcOpticalFlowPyrLK(a, b, corners, np.zeros_like(corners))
    kept = found[:, 0] > 0
    if kept.sum() < MIN_GROUND_CORNERS:
        return None
    step, inliers = cv2.estimateAffinePartial2D(corners[kept], there[kept], ransacReprojThreshold=1.0)
    if step is None or inliers.sum() < MIN_GROUND_CORNERS:
        return None
    return np.column_stack([step[:, :2], step[:, 2] / scale])


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
    from getagrip.studio.masks.polygon_drafts import trace_polygons

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
    from getagrip.studio.masks.polygon_drafts import trace_polygons

    reader, frames = open_masks(path, request), dict(labels.frames)
    for row in range(len(request.frames)):
        masks, n = reader(row), labels.first + row
        if masks is not None and n not in frames:
            frames[n] = FrameLabels(object=tuple(trace_polygons(masks.object)))
    return frames
