"""Find the grasps in a draft: stable grasps by masks and hand, or else all frames without reach and release.

While the hand reaches for the object, or leaves it, the object rests: it stays at its place on the ground, over which
the camera may move, and the hand moves relative to both. Such frames at either end are not part of the grasp.
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
from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.terminal import format_count
from getagrip.readers.footage import Footage
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, HandDetectionFiles
from getagrip.studio.hands.hand_tracking import PALM_LANDMARKS
from getagrip.studio.jobs import CLIPS_FOLDER, RequestedMesh, RunCall
from getagrip.studio.masks.box_prompt import MIN_BOX_CORRELATION, Box, downscale_image, track_box
from getagrip.studio.masks.propagate_clip import propagate_labels
from getagrip.studio.masks.propagate_frame import Hands, Images
from getagrip.studio.store.export_clip import new_clip_call, write_labelled_clip_files
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels, Polygons
from getagrip.timelines.detect.detect_segments import find_segments

MAX_GROUND_IMAGE_PX = 480.0
"""Maximum of the longer side of the images in which the ground's motion is measured [px]."""
MAX_GROUND_CORNERS, MIN_GROUND_CORNERS = 200, 8
"""Maximum and minimum number of tracked corners of the ground."""
MIN_CORNER_QUALITY, GROUND_MARGIN_PX = 1e-3, 8
"""Minimum quality of a corner, as a fraction of the best, and its minimum distance from hand and object [px]."""
REST_TOLERANCE = 0.1
"""Largest distance of a resting object from its place on the ground, as a fraction of its longer side."""
REACH_START_DISTANCE, ARRIVAL_DISTANCE = 0.3, 0.15
"""Distance of the hand's joints from their final places beside the object: above the first number the hand has reached
for it, below the second it has arrived [palm sizes]."""
MIN_REST_FRAMES = 5
"""Minimum number of frames in which an object rests."""
Placed = tuple[int, Box]
"""A frame and the object's box in it [px]."""
Extent = tuple[int, int]
"""First and last frame, from 0, both included."""
WHOLE_CLIP_NAME = "whole"
"""Name of the clip of the interval that is searched."""


@dataclass(frozen=True)
class DraftedGrasps:
    """The grasps of a draft."""

    labels: Labels
    """Labels with the object in every frame."""
    extents: list[Extent]
    said: str
    """Description of the grasps."""


def track_visible_box(images: Images, box: Box, first: int, last: int) -> Iterator[Placed]:
    """Track the object's box from the frame ``first`` on, as long as its content is recognised."""
    boxes = takewhile(lambda each: each[1] >= MIN_BOX_CORRELATION, track_box(images, box, first, last))
    for n, (at, _) in enumerate(boxes, start=first):
        yield n, at


def boxes_of_polygons(shapes: Mapping[int, Polygons]) -> dict[int, Box]:
    """Return the bounding boxes of polygons by frame [px], without frames that have none."""
    points = {n: np.concatenate(each) for n, each in sorted(shapes.items()) if each}
    return {n: (*each.min(axis=0).tolist(), *np.ptp(each, axis=0).tolist()) for n, each in points.items()}


def find_arrival(
    images: Images, boxes: Iterable[Placed], joints: Mapping[int, Float[ndarray, "21 2"]], end: int
) -> int | None:
    """Return the first frame in which the hand has arrived at a resting object; None without such a reach.

    ``boxes`` are the object's, forwards, or backwards for a release: then the last frame is returned. An object that
    rests up to the frame ``end`` is not grasped. ``joints`` are the hand's [px].
    """
    apart: dict[int, Float[ndarray, "21 2"]] = {}
    sizes, place, before = [], None, None
    image = lru_cache(maxsize=2)(images)
    for n, (x, y, w, h) in boxes:
        middle = np.array([x + 0.5 * w, y + 0.5 * h])
        palm = joints[n][PALM_LANDMARKS] if n in joints else None
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
    """Return the frame from which on the joints, relative to the object, stay near their final places."""
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
    """Return the similarity of the ground from one image to another [px]; None with too few corners.

    ``hidden`` are the lower and upper corner of a box around object and hand, outside which the ground is visible.
    """
    import cv2

    scale = min(1.0, MAX_GROUND_IMAGE_PX / max(one.shape))
    a, b = (cv2.cvtColor(downscale_image(image, scale), cv2.COLOR_RGB2GRAY) for image in (one, other))
    free = np.full(a.shape, 255, np.uint8)
    low, high = (np.clip(np.round(scale * corner).astype(int), 0, a.shape[::-1]) for corner in hidden)
    low, high = np.maximum(0, low - GROUND_MARGIN_PX), high + GROUND_MARGIN_PX
    free[low[1] : high[1], low[0] : high[0]] = 0
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


def trim_reach(
    labels: Labels,
    image: Images,
    joints: Mapping[int, Float[ndarray, "21 2"]],
    hand: Hands,
    box: tuple[int, Box] | None = None,
) -> DraftedGrasps:
    """Return the frames in which hand and object move together, as one grasp.

    ``joints`` are the hand's [px], ``hand`` returns its visible pixels, ``box`` is the object's in a frame before the
    grasp.
    """
    shapes: dict[int, Polygons] = {n: frame.object for n, frame in labels.frames.items() if frame.object}
    drawn = boxes_of_polygons(shapes)
    if shapes and max(shapes) < labels.last:
        shapes |= _propagate_polygons(labels, image, hand, max(shapes))
    known = boxes_of_polygons(shapes)
    ahead = drawn.items() if box is None else track_visible_box(image, box[1], box[0], labels.last)
    first = find_arrival(image, ahead, joints, labels.last)
    last = find_arrival(image, [*known.items()][::-1], joints, labels.first)
    extent = (labels.first if first is None else first, labels.last if last is None else last)
    if not labels.first <= extent[0] < extent[1] <= labels.last or extent == (labels.first, labels.last):
        return DraftedGrasps(labels, [(labels.first, labels.last)], "")
    why = {"reaches for it before": first, "leaves it after": last}
    moves = " and ".join(words for words, frame in why.items() if frame is not None)
    taken = f"frames {extent[0] + 1} to {extent[1] + 1} are used, in which hand and object move together"
    if not any(extent[0] <= n <= extent[1] for n in drawn) and extent[0] in shapes:
        labels = replace(labels, frames=labels.frames | {extent[0]: FrameLabels(object=tuple(shapes[extent[0]]))})
    return DraftedGrasps(labels, [extent], f"{taken}: the hand {moves}; --all-frames uses all")


def _propagate_polygons(labels: Labels, image: Images, hand: Hands, key: int) -> dict[int, Polygons]:
    """Return the polygons of the object in the frames after a key frame, to the last or to where it is lost."""
    from getagrip.studio.masks.polygon_drafts import trace_polygons

    propagated = propagate_labels(image, {key: labels.label_maps()[key]}, key, labels.last, hand=hand)
    kept = takewhile(lambda each: each.confidence > 0.0, propagated)
    found = {each.frame: tuple(trace_polygons(each.labels == OBJECT_LABEL)) for each in kept}
    return {n: shapes for n, shapes in found.items() if shapes and n > key}


def find_grasps(
    labels: Labels,
    video: Path,
    footage: Footage,
    out: Path,
    shape: RequestedMesh,
    joints: Mapping[int, Float[ndarray, "21 2"]],
    run: RunCall,
) -> DraftedGrasps:
    """Find the stable grasps in the frames of labels, by a clip of all frames (``out/clips/whole``) made by ``run``.

    Without a stable grasp, the frames in which hand and object move together are returned. Raises ``GetagripError`` if
    no clip can be made.
    """
    hands = HandDetectionFiles(files.folder_inside(out, DETECTED_HANDS_FOLDER))
    made, clip = out / WHOLE_CLIP_NAME, files.folder_inside(out, CLIPS_FOLDER) / WHOLE_CLIP_NAME
    lens = Lens(guess_focal=True)
    write_labelled_clip_files(labels, footage.image, lens, made, overwrite=True, found=hands, name=footage.name)
    new_clip = new_clip_call(labels, made, str(video))
    run(replace(new_clip, mesh=shape.mesh, size_mm=shape.size_mm, out=clip, overwrite=True))
    read = read_clip(clip)
    found = find_segments(read)
    names = [footage.name(n) for n in range(labels.first, labels.last + 1)]
    places = {name: labels.first + n for n, name in enumerate(names)}
    extents = [(places[read.frames[a]], places[read.frames[b]]) for a, b in found.grasps]
    which = ", ".join(f"frames {a + 1} to {b + 1}" for a, b in extents)
    request = MaskRequest(tuple(names), labels.size, (str(OBJECT_LABEL),), (str(OCCLUDER_LABEL),), (str(HAND_LABEL),))
    labels = replace(labels, frames=_masks_to_labels(made / "masks", request, labels))
    said = f"{format_count(len(extents), 'stable grasp')} found: {which}; --interval FIRST LAST overrules this"
    if not extents:
        trimmed = trim_reach(labels, footage.image, joints, hands.mask)
        extents, taken = trimmed.extents, trimmed.said or "the whole interval is marked"
        said = f"warning: no stable grasp found; {taken}; --interval FIRST LAST says where it is"
    if found.notes:
        said += f" ({'; '.join(found.notes)})"
    return DraftedGrasps(labels, extents, said)


def _masks_to_labels(path: Path, request: MaskRequest, labels: Labels) -> dict[int, FrameLabels]:
    """Return labels of all frames, with polygons of the masks where there were no labels."""
    from getagrip.studio.masks.polygon_drafts import trace_polygons

    reader, frames = open_masks(path, request), dict(labels.frames)
    for row in range(len(request.frames)):
        masks, n = reader(row), labels.first + row
        if masks is not None and n not in frames:
            frames[n] = FrameLabels(object=tuple(trace_polygons(masks.object)))
    return frames
