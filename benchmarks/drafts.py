"""Drafts of videos against what a person drew: masks by polygons of frames that the propagation does not see.

The polygons are here; the videos are not, and their rows are left out where ``shared/data`` is absent.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from benchmarks.store import ROOT, Table, of_cells
from benchmarks.timing import timed
from getagrip.annotate import labels
from getagrip.annotate.carried_masks import Hands, Images
from getagrip.annotate.labels import OBJECT, Labels
from getagrip.annotate.propagated_masks import propagate
from getagrip.annotate.video import Video

DATA = ROOT / "shared" / "data"
POLYGONS = Path(__file__).with_name("polygons")
KITCHEN = ROOT / "tests" / "helpers" / "kitchen_plate_labels.json"
KEYS = {"mug": (0, 44, 89), "bottle": (53, 93, 133), "tape": (25, 64, 103), "kitchen_plate": (35, 63, 81, 111)}
"""Frames whose polygons are given, from 0; those of all others are held back."""


def tables() -> dict[str, Table]:
    """Measure what the videos that are there allow."""
    missing, rows = [], []
    for name, keys in KEYS.items():
        path = DATA / ("egocentric" if name == "kitchen_plate" else "videos") / f"{name}.mp4"
        if not path.is_file():
            missing.append(f"{name}: missing {path.relative_to(ROOT)}")
            continue
        given = labels.read(KITCHEN if name == "kitchen_plate" else POLYGONS / f"{name}.json")
        rows.append([name, *_masks(given, path, keys)])
    header = ["video", "frames", "drawn", "held back", "mean IOU", "least IOU", "CPU s/frame"]
    return {"draft-masks": of_cells("The object's masks from polygons on a few frames", header, rows, missing)}


def _masks(given: Labels, path: Path, keys: tuple[int, ...]) -> list[str]:
    """Return the cells of a video's row."""
    video = Video(path)
    try:
        hand = found_hand(video, given)
        timing, (scores,) = timed(lambda: held_back(given, keys, video.image, hand))
    finally:
        video.close()
    frames, ious = given.last - given.first + 1, list(scores.values())
    counts = [str(frames), str(len(keys)), str(len(ious))]
    return [*counts, f"{np.mean(ious):.3f}", f"{min(ious):.3f}", f"{timing.cpu[0] / frames:.2f}"]


def held_back(given: Labels, keys: tuple[int, ...], image: Images, hand: Hands) -> dict[int, float]:
    """Propagate the masks of ``keys``; return the IOU of each other frame that was drawn."""
    drawn: Mapping[int, UInt8[ndarray, "H W"]] = given.label_maps()
    found = propagate(image, {n: drawn[n] for n in keys}, given.first, given.last, hand=hand)
    return {n: iou(mask == OBJECT, drawn[n] == OBJECT) for n, mask, _ in found if n in drawn and n not in keys}


def iou(one: ndarray, other: ndarray) -> float:
    """Intersection over union."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def found_hand(video: Video, given: Labels) -> Hands:
    """Find the hand in the labels' frames, as ``getagrip draft`` does; nothing is known where there is none."""
    from getagrip.annotate.finding_hands import find_hands
    from getagrip.clip.intrinsics import intrinsics
    from getagrip.errors import GetagripError
    from getagrip.geometry.lens import Lens
    from getagrip.landmarks import hand_mask, load

    try:
        K, camera = intrinsics(Lens(guess_focal=True), video.size)
        found = find_hands(video, (given.first, given.last), load(None), K, camera, given.side)
    except GetagripError:
        return lambda _: None
    points = {found.first + row: found.landmarks.points[row] for row in found.landmarks.rows}
    masks = {n: hand_mask(video.image(n), each) for n, each in points.items()}
    return masks.get
