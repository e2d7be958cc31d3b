"""Score drafts of videos against a person's drawings: masks on held-back frames by polygons, hands by clicked joints.

Polygons and clicked joints are here; the videos are not, and their rows are left out where ``shared/data`` is absent.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from benchmarks.store import ROOT, Table, of_cells
from benchmarks.timing import timed
from getagrip.readers.footage import Footage, VideoFootage
from getagrip.studio.masks.box_prompt import segment_box_by_motion
from getagrip.studio.masks.propagate_clip import propagate_labels
from getagrip.studio.masks.propagate_frame import Hands, Images
from getagrip.studio.masks.stroke_prompt import keyframe_label_maps
from getagrip.studio.store import labels
from getagrip.studio.store.labels import OBJECT_LABEL, FrameLabels, Labels

DATA = ROOT / "shared" / "data"
POLYGONS = Path(__file__).with_name("polygons")
KITCHEN = ROOT / "tests" / "helpers" / "kitchen_plate_labels.json"
KEYS = {"mug": (0, 44, 89), "bottle": (53, 93, 133), "tape": (25, 64, 103), "kitchen_plate": (35, 63, 81, 111)}
"""Key frames whose polygons are inputs, from 0; polygons of other frames are held back."""


HELD_BY_LEFT = ("bottle", "mug", "tape", "umbrella", "kitchen_plate")
"""Videos in which the left hand grasps the object and is in view in every frame."""
RING = (0.0415, 0.049, 0.048)
"""Radii and height of the roll of tape [m]."""
AGAIN = ("drawn again", "IOU with these", "both outlines")
"""Columns of held-back frames that were outlined twice: their number, and the IOU of masks and of first outlines with
the second outlines."""
KEEP = "GETAGRIP_KEEP"
"""Environment variable with a folder for the examples' files, for pictures."""
Rows = list[list[str]]
"""Rows of a table, from one video."""
LabelMaps = Mapping[int, UInt8[ndarray, "H W"]]
"""Label maps by frame."""
CLOSE = 20.0
"""Maximum error of a clicked frame's landmarks to count as close [px]."""


def masks() -> dict[str, Table]:
    """Measure masks from outlines on a few frames."""
    header = ["video", "frames", "drawn", "held back", "mean IOU", "least IOU", *AGAIN, "CPU s/frame"]
    return {"draft-masks": of_cells("The object's masks from outlines on a few frames", header, *_rows(KEYS, _masks))}


def clicks() -> dict[str, Table]:
    """Measure masks from a box or a click on one frame, and from a click on each key frame of ``masks``."""
    header = ["given", "frames", "IOU where given", "held back", "mean IOU", "least IOU"]
    return {"draft-clicks": of_cells("The object's masks from a box, or from clicks", header, *_rows(KEYS, _clicks))}


def landmarks() -> dict[str, Table]:
    """Measure the detected hand."""
    clicked = ["clicked", "within 20 px", "median, px"]
    again = ["within 20 px, clicked again", "median again, px", "both clicks, px"]
    header = ["video", "frames", "with a hand, %", "right side", *clicked, *again, "CPU ms/frame"]
    return {"draft-landmarks": of_cells("The hand's landmarks", header, *_rows(HELD_BY_LEFT, _landmarks))}


def example() -> dict[str, Table]:
    """Time the tutorial's video."""
    header = ["step", "CPU, s", "IOU"]
    return {"draft-example": of_cells("The steps of docs/tape.md", header, *_rows(["tape"], _example))}


def results() -> dict[str, Table]:
    """Reconstruct the other phone videos, with built-in shapes."""
    header = ["video", "frames", "drawn", "IOU", "CPU, s"]
    return {"draft-results": of_cells("From three videos to 3D", header, *_rows(OTHERS, _result))}


class Example(NamedTuple):
    """The object of a video and its marks in ``POLYGONS``."""

    name: str
    mesh: str
    """Name of a built-in shape, or a file."""
    frames: int
    """Number of frames."""
    first: int = 1
    """First frame, from 1."""

    @property
    def last(self) -> int:
        return self.first + self.frames - 1

    @property
    def shown(self) -> Path:
        """Marks of a few frames."""
        return POLYGONS / f"{self.name}-shown.json"


TAPE = Example("tape", "tape.obj", 92)
OTHERS = {"mug": Example("mug", "mug", 90), "bottle": Example("bottle", "bottle", 81, 54)}
OTHERS["umbrella"] = Example("umbrella", "umbrella", 90)


def _example(_: str, video: Path) -> Rows:
    """Run the commands of docs/tape.md; return a row for each step."""
    from trimesh.creation import annulus

    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        annulus(*RING, sections=80).export(folder / "tape.obj")
        return _kept(TAPE, folder, list(made_by(TAPE, video, folder)))


def _result(name: str, video: Path) -> Rows:
    """Return the cells of a video: frames, frames with a person's drawings, IOU, and CPU time up to the result."""
    it = OTHERS[name]
    with TemporaryDirectory() as temporary:
        steps = _kept(it, Path(temporary), list(islice(made_by(it, video, Path(temporary)), 5)))  # without a report
    drawn, cpu = len(labels.read_label_file(it.shown).frames), sum(float(row[1]) for row in steps)
    return [[name, str(it.frames), str(drawn), steps[-1][2], f"{cpu:.0f}"]]


def _kept(it: Example, folder: Path, rows: Rows) -> Rows:
    """Copy a folder to the folder of the variable ``KEEP``."""
    if KEEP in os.environ:
        shutil.copytree(folder, Path(os.environ[KEEP]) / it.name)
    return rows


def made_by(it: Example, video: Path, folder: Path) -> Iterator[list[str]]:
    """Run the steps from a video to a report in a folder; yield a row for each."""
    interval = ("--interval", it.first, it.last)
    made = folder / "draft" / f"draft-{it.name}-{it.first}-{it.last}-left"
    shown = ("--side", "left", "--mesh", it.mesh, "--hands", made / "hand.npz", "--masks", made / "masks")
    labels_of = ("--import-labels", it.shown, "--annotator", "draft")
    for step, words in {
        "the hand": ("draft", video, "--object", it.mesh, *interval, "--out", "draft", "--no-page"),
        "the outlines": ("annotate", video, "--out", "draft", *labels_of),
        "all masks": ("annotate", video, "--out", "draft", "--export"),
        "the clip": (
            *("clip", "new", video, *interval, *shown),
            *("--object", 1, "--ignore", 2, "--hand", 3, "--out", f"clips/{it.name}"),
        ),
        "the reconstruction": ("reconstruct", f"clips/{it.name}", "--out", "results"),
        "the report": ("report", f"results/{it.name}"),
    }.items():
        before = getrusage(RUSAGE_CHILDREN).ru_utime
        call = [sys.executable, "-m", "getagrip", *map(str, words)]
        subprocess.run(call, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        seconds, iou_of = getrusage(RUSAGE_CHILDREN).ru_utime - before, ""
        if step == "the reconstruction":
            with np.load(folder / "results" / it.name / "result.npz") as result:
                iou_of = f"{np.nanmean(result['iou']):.3f}"
        yield [step, f"{seconds:.0f}", iou_of]


def _rows(names: Iterable[str], measure: Callable[[str, Path], Rows]) -> tuple[list[list[str]], list[str]]:
    """Measure some videos; return their rows, and the missing videos."""
    rows: list[list[str]] = []
    missing = []
    for name in names:
        path = DATA / ("egocentric" if name == "kitchen_plate" else "videos") / f"{name}.mp4"
        if path.is_file():
            rows += measure(name, path)
        else:
            missing.append(f"{name}: missing {path.relative_to(ROOT)}")
    return rows, missing


def _labels(name: str) -> Labels:
    return labels.read_label_file(KITCHEN if name == "kitchen_plate" else POLYGONS / f"{name}.json")


def _again(name: str) -> Labels:
    """Return a second drawing and clicks of some frames, made independently of the first."""
    return labels.read_label_file(POLYGONS / f"{name}-again.json")


def _landmarks(name: str, path: Path) -> Rows:
    """Return the cells of a video's row: rate of detection of the left hand, and its distance from clicked joints."""
    from getagrip.studio.hands import load_models
    from getagrip.studio.hands.detect_hands import find_landmarks

    nets, video = load_models(None), VideoFootage(path)
    images = [video.image(n) for n in range(video.frames)]  # decoding is not measured
    video.close()
    footage = cast(Footage, SimpleNamespace(image=images.__getitem__, name=str))
    timing, (found,) = timed(lambda: find_landmarks(footage, (0, len(images) - 1), nets))
    errors = [""] * 6
    if name == "kitchen_plate":
        clicks, again = _labels(name).clicks, _again(name).clicks
        found_in = dict(enumerate(found.points))
        off, then, both = _apart(found_in, clicks), _apart(found_in, again), _apart(clicks, again)
        counted = [(str(sum(each <= CLOSE for each in some)), f"{np.nanmedian(some):.0f}") for some in (off, then)]
        errors = [str(len(off)), *counted[0], *counted[1], f"{np.median(both):.0f}"]
    rate, speed = 100.0 * len(found.rows) / len(images), 1e3 * timing.cpu[0] / len(images)
    right_side = "yes" if found.side == "left" else "no"
    return [[name, str(len(images)), f"{rate:.1f}", right_side, *errors, f"{speed:.0f}"]]


def _apart(one: Mapping[int, Float[ndarray, "21 2"]], other: Mapping[int, Float[ndarray, "21 2"]]) -> list[float]:
    """Return the median distance of joints in each frame of ``other`` [px]."""
    return [float(np.nanmedian(np.linalg.norm(one[n] - at, axis=-1))) for n, at in other.items()]


def _masks(name: str, path: Path) -> Rows:
    """Return the cells of a video's row."""
    given, keys, video = _labels(name), KEYS[name], VideoFootage(path)
    try:
        hand = found_hand(path)
        timing, (found,) = timed(lambda: held_back(given, keys, video.image, hand))
    finally:
        video.close()
    drawn, frames = given.label_maps(), given.last - given.first + 1
    second = _again(name).label_maps()
    counts = [str(frames), str(len(keys)), str(len(found))]
    again = [str(len(second)), f"{np.mean(ious(found, second)):.3f}", f"{np.mean(ious(drawn, second)):.3f}"]
    first = f"{np.mean(ious(found, drawn)):.3f}", f"{min(ious(found, drawn)):.3f}"
    return [[name, *counts, *first, *again, f"{timing.cpu[0] / frames:.2f}"]]


def _clicks(name: str, path: Path) -> Rows:
    """Return the cells of a video's rows: the outline's box, and a click at its innermost pixel."""
    import cv2

    given, keys, video = _labels(name), KEYS[name], VideoFootage(path)
    drawn, rows, middle = given.label_maps(), [], keys[len(keys) // 2]
    try:
        hand = found_hand(path)
        box = cv2.boundingRect((drawn[middle] == OBJECT_LABEL).astype(np.uint8))
        found = segment_box_by_motion(video.image, middle, (given.first, given.last), box, hand(middle)) == OBJECT_LABEL
        cuts = {"a box": {middle: np.where(found, np.uint8(OBJECT_LABEL), np.uint8(0))}}
        for some in ((middle,), keys):
            clicked = {n: FrameLabels(on=(_deepest(drawn[n] == OBJECT_LABEL)[None],)) for n in some}
            shown = f"{len(some)} click{'s' * (len(some) > 1)}"
            cuts[shown] = keyframe_label_maps(replace(given, frames=clicked), video.image, hand)
        for shown, cut in cuts.items():
            scores = ious(held_back(given, keys, video.image, hand, cut), drawn)
            counts = f"{given.last - given.first + 1}", f"{np.mean(ious(cut, drawn)):.3f}", str(len(scores))
            rows.append([f"{name}: {shown}", *counts, f"{np.mean(scores):.3f}", f"{min(scores):.3f}"])
    finally:
        video.close()
    return rows


def _deepest(mask: Bool[ndarray, "H W"]) -> Float[ndarray, "2"]:
    """Return the middle of the pixel farthest from a mask's border [px]."""
    import cv2

    far = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    return np.array(np.unravel_index(far.argmax(), far.shape))[::-1] + 0.5


def held_back(
    given: Labels, keys: tuple[int, ...], image: Images, hand: Hands, shown: LabelMaps | None = None
) -> dict[int, UInt8[ndarray, "H W"]]:
    """Propagate the masks ``shown`` (default: drawings of ``keys``); return the masks of the other drawn frames."""
    drawn = given.label_maps()
    shown = {n: drawn[n] for n in keys} if shown is None else shown
    found = propagate_labels(image, shown, given.first, given.last, hand=hand)
    return {n: mask for n, mask, _ in found if n in drawn and n not in keys}


def ious(one: LabelMaps, other: LabelMaps) -> list[float]:
    """Compute the object's intersection over union in each common frame."""
    both = [(one[n] == OBJECT_LABEL, other[n] == OBJECT_LABEL) for n in sorted(one.keys() & other.keys())]
    return [float((a & b).sum() / max((a | b).sum(), 1)) for a, b in both]


@cache
def found_hand(path: Path) -> Hands:
    """Find the hand in a video as ``getagrip draft`` does, once for all tables; empty without a hand."""
    from getagrip.errors import GetagripError
    from getagrip.studio.hands import hand_mask, load_models
    from getagrip.studio.hands.detect_hands import find_landmarks

    given, video = _labels(path.stem), VideoFootage(path)
    try:
        found = find_landmarks(video, (given.first, given.last), load_models(None), given.side)
        there = ((given.first + row, found.points[row]) for row in found.rows)
        return {n: hand_mask(video.image(n), points) for n, points in there}.get
    except GetagripError:
        return lambda _: None
    finally:
        video.close()
