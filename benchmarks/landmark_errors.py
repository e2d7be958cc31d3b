"""Measure the landmark networks' errors: ``python -m benchmarks.landmark_errors MMPOSE``.

MMPOSE is a checkout of open-mmlab/mmpose, whose ``tests/data`` holds a few real images of four datasets with annotated
joints. They show hands alone, hands that hold something and two hands; which joints are hidden is not annotated, and no
two images are of one clip. Only sums are written: ``results/landmark-errors.json``. Errors are in shares of the larger
side of the annotated joints' box.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import store
from benchmarks.timing import circumstances
from getagrip.landmarks import crops
from getagrip.landmarks.models import load
from getagrip.landmarks.nets import Nets

ANNOTATIONS = {
    "FreiHAND": "freihand/test_freihand.json",
    "OneHand10K": "onehand10k/test_onehand10k.json",
    "Panoptic": "panoptic/test_panoptic.json",
}
ORDER = [20, *(4 * f + k for f in range(5) for k in (3, 2, 1, 0))]
"""InterHand2.6M's joints in our order; theirs go from the tips to the palm, the wrist last."""
GROUPS = {"wrist": [0], "knuckles": [1, 5, 9, 13, 17], "middle joints": [2, 3, 6, 7, 10, 11, 14, 15, 18, 19]}
GROUPS["tips"] = [4, 8, 12, 16, 20]
GROSS = 0.15
"""Median error of a hand that is another one, or missed."""
HEADER = ("of", "hands", "by the palm, %", "gross, %", "error, %", "shift, %", "rest, %", "beyond 3, %")


class Hand(NamedTuple):
    """A hand of an image: joints [px], and which are annotated."""

    dataset: str
    image: Path
    points: Float[ndarray, "21 2"]
    known: Bool[ndarray, "21"]


def hands(data: Path) -> Iterator[Hand]:
    """Read the annotated hands."""
    for dataset, name in ANNOTATIONS.items():
        record = json.loads((data / name).read_text(encoding="utf-8"))
        files = {image["id"]: image["file_name"] for image in record["images"]}
        for one in record["annotations"]:
            points = np.array(one["keypoints"], dtype=float).reshape(21, 3)
            yield Hand(dataset, (data / name).parent / files[one["image_id"]], points[:, :2], points[:, 2] > 0.0)
    yield from _interhand(data / "interhand2.6m")


def _interhand(folder: Path) -> Iterator[Hand]:
    """Project InterHand2.6M's joints, which are in its world [mm]."""
    record, cameras, joints = (
        json.loads((folder / f"test_interhand2.6m_{part}.json").read_text(encoding="utf-8"))
        for part in ("data", "camera", "joint_3d")
    )
    for image, one in zip(record["images"], record["annotations"], strict=True):
        camera, which = cameras[str(image["capture"])], image["camera"]
        world = np.array(joints[str(image["capture"])][str(image["frame_idx"])]["world_coord"])
        X = (world - camera["campos"][which]) @ np.array(camera["camrot"][which]).T
        uv = X[:, :2] / X[:, 2:] * camera["focal"][which] + camera["princpt"][which]
        valid = np.array(one["joint_valid"]).ravel() > 0
        for side in (slice(0, 21), slice(21, 42)):
            if valid[side].any():
                yield Hand("InterHand2.6M", folder / image["file_name"], uv[side][ORDER], valid[side][ORDER])


def errors_of(hand: Hand, nets: Nets) -> tuple[Float[ndarray, "21 2"], bool]:
    """Return the errors of the landmarks [shares of the box], NaN where unknown, and whether the palm was detected.

    As a hand is followed through a clip: the landmarks of a first square give the square of the second. Where no palm
    is detected near the hand, the first square is that of the annotation.
    """
    image = cv2.cvtColor(cv2.imread(str(hand.image)), cv2.COLOR_BGR2RGB)
    true = np.where(hand.known[:, None], hand.points, np.nan)
    box = float(np.max(np.nanmax(true, axis=0) - np.nanmin(true, axis=0)))
    starts = [crops.of_palm(palm) for palm in nets.palms(image)]
    found = [nets.landmarks(image, crops.of_landmarks(nets.landmarks(image, crop).points)) for crop in starts]
    off = [np.nanmedian(np.linalg.norm(one.points - true, axis=1)) / box for one in found]
    if found and min(off) < GROSS:
        return (found[int(np.argmin(off))].points - true) / box, True
    filled = np.where(hand.known[:, None], true, np.nanmean(true, axis=0))
    return (nets.landmarks(image, crops.of_landmarks(filled)).points - true) / box, False


def line(label: str, errors: Float[ndarray, "H 21 2"], detected: Bool[ndarray, "H"], joints: list[int]) -> list[str]:
    """Sum up some joints of hands: deviations along each axis, by the median, of hands that are not gross."""
    far = np.nanmedian(np.linalg.norm(errors, axis=2), axis=1)
    good = errors[far < GROSS]
    shift = np.nanmedian(good, axis=1, keepdims=True)
    whole, rest = _sizes(good[:, joints]), _sizes((good - shift)[:, joints])
    spread = deviation(rest)
    numbers = [detected.mean(), np.mean(far >= GROSS), deviation(whole), deviation(_sizes(shift)), spread]
    return [label, f"{len(errors)}", *(f"{100.0 * x:.1f}" for x in (*numbers, np.mean(rest > 3.0 * spread)))]


def deviation(sizes: Float[ndarray, "n"]) -> float:
    """Return the standard deviation along each axis of errors whose median length is that of these."""
    return float(np.median(sizes) / np.sqrt(2.0 * np.log(2.0)))


def _sizes(errors: Float[ndarray, "*n 2"]) -> Float[ndarray, "m"]:
    sizes = np.linalg.norm(errors, axis=-1).ravel()
    return np.asarray(sizes[np.isfinite(sizes)])


def main(checkout: Path) -> None:
    """Measure all hands, and write the table."""
    nets, every = load(), list(hands(checkout / "tests/data"))
    found = [errors_of(hand, nets) for hand in every]
    errors, detected = np.stack([error for error, _ in found]), np.array([seen for _, seen in found])
    of = np.array([hand.dataset for hand in every])
    rows = [line(name, errors[of == name], detected[of == name], [*range(21)]) for name in dict.fromkeys(of.tolist())]
    rows += [line(name, errors, detected, joints) for name, joints in ({"all": [*range(21)]} | GROUPS).items()]
    notes = (
        "error: standard deviation along each axis, by the median, without gross hands (median error above "
        f"{100 * GROSS:.0f} %); shift: of a hand's median error; rest: without it; beyond 3: share of joints whose "
        "rest is beyond three deviations; by the palm: hands that were detected without the annotation.",
    )
    table = store.of_cells("Errors of hand landmarks on real images, in % of the hand's box", HEADER, rows, notes)
    made = circumstances("python -m benchmarks.landmark_errors MMPOSE")
    print(store.write("landmark-errors", replace(table, made=made)).read_text(encoding="utf-8"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
